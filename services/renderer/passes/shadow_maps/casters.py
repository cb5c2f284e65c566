"""What casts shadows: the scene's meshes in as few triangles as a shadow map shows, and the box around them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vemlight.renderer.passes.shadow_maps.simplification import simplified
from vemlight.renderer.scene.materials import alpha_test_of
from vemlight.renderer.scene.meshes import bounds, box_corners, swept_bounds
from vemlight.renderer.scene.scene import Mesh, Scene
from vemlight.renderer.scene.vertex_buffers import DrawRange, IndexRange, draw_ranges, local_order

GROWN = 1.001  # scale of a caster: below it is none, and rotations are off by rounding; any value in 1.0001 .. 1.1 does
SUNK = 1e-4  # of half the scene's diagonal, by which a receiver plane may be pierced: a foot so deep casts no shadow that a texel shows
MARGIN = 0.1  # of the grown box, towards what left the old one: what goes on moving outwards does not change the box each frame


class DetailRange(NamedTuple):
    """A caster in the index buffer at one level of detail, and whether it is closed there."""

    indices: IndexRange
    closed: bool


class Caster(NamedTuple):
    """One mesh: its number in the scene, its levels of detail from the finest on, the vertices of the finest, and the box around it.

    corners: (8, 3) float64.
    """

    mesh: int
    details: tuple[DetailRange, ...]
    vertices: IndexRange
    corners: np.ndarray


class Casters(NamedTuple):
    """positions: (n, 3) float32. indices: (3 m,) uint32. members: all meshes but the receiver plane.

    levels: for each resolution of map the level of detail that is drawn. Closed meshes cast with the faces towards the light alone;
    alpha-tested ones have no triangles here. The receiver plane, a flat mesh with the whole scene on one side, casts only for lights on
    the other; plane_normal (3,) points to the scene, zeros without one. box_centre, box_half: (2, 3) float32, the box around what stands
    on the receiver plane, which is all that its own shadow can fall on too, and the box around everything. tolerance_m: by which a
    receiver plane may be pierced.
    """

    positions: np.ndarray
    indices: np.ndarray
    members: tuple[Caster, ...]
    receiver_plane: Caster | None
    levels: tuple[int, ...]
    plane_normal: np.ndarray
    box_centre: np.ndarray
    box_half: np.ndarray
    tolerance_m: float

    @property
    def every(self) -> tuple[Caster, ...]:
        """The members and the receiver plane."""
        return (*self.members, self.receiver_plane) if self.receiver_plane else self.members


class DetailLevel(NamedTuple):
    """What is drawn at one level of detail: closed meshes and open ones."""

    closed: tuple[DrawRange, ...]
    open: tuple[DrawRange, ...]


class PlacedCasters(NamedTuple):
    """Casters as they stand: at each level of detail, the receiver plane, and the box around what shadows fall from and on, (3,).

    matrices: (n, 4, 4), world_from_rest of the scene's meshes.
    """

    levels: tuple[DetailLevel, ...]
    receiver_plane: tuple[DrawRange, ...]
    plane_normal: np.ndarray
    box_centre: np.ndarray
    box_half: np.ndarray
    matrices: np.ndarray


def scene_casters(scene: Scene, resolutions: Sequence[int], drawn_in_maps: bool = True) -> Casters:
    """The casters for maps of `resolutions` texels a side, the largest first: simplified by no more than a texel, the shaders' bias.

    drawn_in_maps: False where shadows are by rays: nothing is simplified then, which takes most of the time of a start.
    """
    tolerance_m = SUNK * float(np.linalg.norm(scene.half))
    plane, normal = _receiver_plane(scene, tolerance_m)
    members = {k: mesh.geometry for k, mesh in enumerate(scene.meshes) if k != plane}
    low, high = bounds(list(members.values()))
    # Seen from any side the box is at least as large as its middle extent, so no map's texel is smaller than this.
    texels_m = [float(np.sort(high - low)[1]) / resolution for resolution in resolutions]
    alpha_tested = {k for k in members if alpha_test_of(scene.meshes[k].material)}  # drawn by alpha_test.py; here they have a box alone
    whole = alpha_tested if drawn_in_maps else set(members)
    versions = {k: [mesh] * len(texels_m) if k in whole else simplified(mesh, texels_m) for k, mesh in members.items()}
    # Resolutions have a level in common where no mesh has another version.
    fresh = [n == 0 or any(made[n] is not made[n - 1] for made in versions.values()) for n in range(len(resolutions))]
    drawn = [{k: local_order(versions[k][n]) for k in members} for n in np.flatnonzero(fresh)]
    drawn = [{k: part._replace(triangles=part.triangles[: 0 if k in alpha_tested else None]) for k, part in own.items()} for own in drawn]
    # The buffers: level by level, closed meshes before open ones, the receiver plane last.
    ordered = [(k, part) for level in drawn for closed in (True, False) for k, part in level.items() if part.closed == closed]
    ordered += [(plane, scene.meshes[plane].geometry)] if plane >= 0 else []
    parts = [part for _, part in ordered]
    vertices = np.cumsum([0, *(len(part.positions) for part in parts)]).tolist()
    indices = np.cumsum([0, *(part.triangles.size for part in parts)]).tolist()
    details: dict[int, list[DetailRange]] = {k: [] for k, _ in ordered}
    finest: dict[int, IndexRange] = {}
    for n, (k, part) in enumerate(ordered):
        details[k].append(DetailRange(IndexRange(indices[n], part.triangles.size), part.closed))
        finest.setdefault(k, IndexRange(vertices[n], len(part.positions)))
    corners = {k: box_corners(scene.meshes[k].geometry if k == plane else drawn[0][k]) for k in details}
    casters = {k: Caster(k, tuple(details[k]), finest[k], corners[k]) for k in details}
    moving = [swept_bounds(mesh.geometry, mesh.motion) for mesh in scene.meshes if mesh.motion]
    standing = bounds([part for level in drawn for part in level.values()])
    everything = bounds([*parts, *(mesh.geometry for mesh in scene.meshes)])
    boxes = [_around([standing, *moving]), _around([everything, *moving])]
    return Casters(
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.triangles.reshape(-1) + np.uint32(first) for part, first in zip(parts, vertices[:-1], strict=True)]),
        tuple(caster for k, caster in casters.items() if k != plane),
        casters.get(plane),
        tuple((np.cumsum(fresh) - 1).tolist()),
        normal,
        np.array([(high + low) / 2 for low, high in boxes], np.float32),
        np.array([(high - low) / 2 for low, high in boxes], np.float32),
        tolerance_m,
    )


def _around(boxes: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)


def placed_casters(casters: Casters, matrices: np.ndarray, before: PlacedCasters | None = None) -> PlacedCasters:
    """The casters with world_from_rest (n, 4, 4) of the scene's meshes.

    The box stays that of `before` (of `casters` at first) while all casters are inside; else it grows. A receiver plane that moves, or
    that something moved pierces, casts like any open mesh until it no longer does.
    """
    moved = [caster for caster in casters.every if not np.array_equal(matrices[caster.mesh], np.eye(4))]
    plane = casters.receiver_plane
    if any(_pierces(casters, caster, matrices[caster.mesh]) for caster in moved):
        plane = None
    levels = tuple(_detail_level(casters, matrices, level, plane is None) for level in range(max(casters.levels) + 1))
    apart = draw_ranges([plane.details[0].indices], [np.eye(4)]) if plane else ()
    if before and bool(before.receiver_plane) == bool(plane):
        centre, half = before.box_centre, before.box_half
    else:
        around = 0 if plane else 1
        centre, half = casters.box_centre[around], casters.box_half[around]
    for caster in moved:
        centre, half = _grown(centre, half, _moved(caster.corners, matrices[caster.mesh]))
    return PlacedCasters(levels, apart, casters.plane_normal if plane else np.zeros(3), centre, half, matrices)


def _detail_level(casters: Casters, matrices: np.ndarray, level: int, with_plane: bool) -> DetailLevel:
    """The members at a level of detail, with the receiver plane where it casts like them."""
    # What is scaled up is drawn in its finest version: the others' errors would grow with it.
    grown = np.linalg.norm(matrices[:, :3, :3], axis=1).max(axis=1) > GROWN
    drawn = [(caster.details[0 if grown[caster.mesh] else level], caster.mesh) for caster in casters.members]
    if casters.receiver_plane and with_plane:
        drawn.append((casters.receiver_plane.details[0], casters.receiver_plane.mesh))
    drawn.sort(key=lambda own: own[0].indices.first)  # in the buffer's order, in which `draw_ranges` joins them
    closed, open_ = ([own for own in drawn if own[0].closed == closed] for closed in (True, False))
    return DetailLevel(*(draw_ranges([own.indices for own, _ in of], [matrices[mesh] for _, mesh in of]) for of in (closed, open_)))


def moved_by_m(casters: Casters, before: np.ndarray, after: np.ndarray) -> float:
    """How far any point of the casters moved at most between two states of the matrices (n, 4, 4), metres."""
    changed = [member for member in casters.every if not np.array_equal(before[member.mesh], after[member.mesh])]
    # The distance between two affine images of a point is convex in it: nowhere in a box is it larger than at a corner.
    steps = [_moved(member.corners, after[member.mesh]) - _moved(member.corners, before[member.mesh]) for member in changed]
    return max((float(np.linalg.norm(step, axis=-1).max()) for step in steps), default=0.0)


def _moved(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Points (..., 3) under a transform (4, 4)."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _pierces(casters: Casters, caster: Caster, matrix: np.ndarray) -> bool:
    """Whether a moved caster reaches below the receiver plane, or is it."""
    plane = casters.receiver_plane
    if plane is None or caster is plane:
        return plane is not None
    points = _moved(casters.positions[caster.vertices.first : caster.vertices.end].astype(np.float64), matrix)
    on_plane = casters.positions[plane.vertices.first].astype(np.float64)
    return bool(((points - on_plane) @ casters.plane_normal).min() < -casters.tolerance_m)


def _grown(centre: np.ndarray, half: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The box around itself and corners (8, 3), with a MARGIN towards those that lie outside."""
    low, high, lowest, highest = centre - half, centre + half, corners.min(axis=0), corners.max(axis=0)
    slack = 1e-5 * (high - low).max()  # float32 rounds by 1e-7 of the coordinates; any value in 1e-6 to 1e-3 does
    if np.all(lowest >= low - slack) and np.all(highest <= high + slack):
        return centre, half
    more = MARGIN * (np.maximum(high, highest) - np.minimum(low, lowest))
    low = np.where(lowest < low - slack, lowest - more, low)
    high = np.where(highest > high + slack, highest + more, high)
    return ((low + high) / 2).astype(np.float32), ((high - low) / 2).astype(np.float32)


def _receiver_plane(scene: Scene, tolerance: float) -> tuple[int, np.ndarray]:
    """Number and normal of the largest flat opaque mesh that stands still with all others on one side; -1 and zeros for none."""
    best, index, normal = 0.0, -1, np.zeros(3)
    for k, mesh in enumerate(scene.meshes):
        others = [other.geometry.positions for j, other in enumerate(scene.meshes) if j != k]
        area, n, point = _plane(mesh, tolerance)
        if area <= best or not others or mesh.motion or alpha_test_of(mesh.material):
            continue
        low = min(float(((p - point) @ n).min()) for p in others)
        high = max(float(((p - point) @ n).max()) for p in others)
        if low >= -tolerance or high <= tolerance:
            best, index, normal = area, k, n if low >= -tolerance else -n
    return index, normal


def _plane(mesh: Mesh, tolerance: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Area in m^2, unit normal and a point of a flat mesh; area 0 when the mesh leaves its plane by more than `tolerance`."""
    points = mesh.geometry.positions.astype(np.float64)
    corners = points[mesh.geometry.triangles]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    n = facing[np.argmax(np.linalg.norm(facing, axis=-1))]
    n, point = n / np.linalg.norm(n), corners[0, 0]
    flat = np.abs((points - point) @ n).max() <= tolerance
    return float(np.linalg.norm(facing, axis=-1).sum() / 2) if flat else 0.0, n, point
