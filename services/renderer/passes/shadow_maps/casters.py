"""What casts shadows: the scene's meshes in as few triangles as a shadow map can show, and the box around them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from vemlight.renderer.scene.materials import alpha_test_of
from vemlight.renderer.scene.meshes import Geometry, bounds, box_corners, is_closed, swept_bounds
from vemlight.renderer.scene.scene import Mesh, Scene
from vemlight.renderer.scene.vertex_buffers import DrawRange, IndexRange, draw_ranges, local_order

WORTH = 500  # triangles; fewer cost a shadow map less than a clear of its tile
PROBES = 2000  # points at which either surface is compared with the other; with 10 times as many to find what is near
NEAREST = 8  # of those points, in whose triangles the nearest is looked for


class Run(NamedTuple):
    """A caster in the buffers, simplified for maps of one size: its indices, and whether it is closed."""

    indices: IndexRange
    closed: bool


class Caster(NamedTuple):
    """One mesh: its number in the scene, its runs from the finest to the coarsest, the vertices of the finest, and the box around it.

    corners: (8, 3) float64.
    """

    mesh: int
    runs: tuple[Run, ...]
    vertices: IndexRange
    corners: np.ndarray


class Casters(NamedTuple):
    """positions: (n, 3) float32. indices: (3 m,) uint32. members: the meshes that stand on the floor or anywhere else; floor: that mesh.

    levels: for each size of map, which run of the members is drawn. Closed meshes cast with the faces towards the light alone; those with
    holes have no triangles here. The floor, a flat mesh with the whole scene on one side, casts only for lights on the other; floor_normal
    (3,) points to the scene, zeros without a floor. box_centre, box_half: (2, 3) float32, the box around what stands on the floor, which
    is all that its own shadow can fall on too, and the box around everything. tolerance: metres by which a floor may be pierced.
    """

    positions: np.ndarray
    indices: np.ndarray
    members: tuple[Caster, ...]
    floor: Caster | None
    levels: tuple[int, ...]
    floor_normal: np.ndarray
    box_centre: np.ndarray
    box_half: np.ndarray
    tolerance: float

    @property
    def every(self) -> tuple[Caster, ...]:
        """The members and the floor."""
        return (*self.members, self.floor) if self.floor else self.members


class Level(NamedTuple):
    """What is drawn into maps of one size: closed meshes and open ones."""

    closed: tuple[DrawRange, ...]
    open: tuple[DrawRange, ...]


class Placed(NamedTuple):
    """Casters as they stand: each level, the floor, and the box around what shadows fall from and on, (3,).

    matrices: (n, 4, 4), world_from_rest of the scene's meshes.
    """

    levels: tuple[Level, ...]
    floor: tuple[DrawRange, ...]
    floor_normal: np.ndarray
    box_centre: np.ndarray
    box_half: np.ndarray
    matrices: np.ndarray


def scene_casters(scene: Scene, sizes: Sequence[int]) -> Casters:
    """The casters for maps of `sizes` texels a side, the largest first: simplified by no more than a texel, the shader's bias."""
    tolerance = 1e-4 * float(np.linalg.norm(scene.half))  # a foot sunk by so little casts no shadow that a texel shows
    floor, normal = _floor(scene, tolerance)
    standing = {k: mesh.geometry for k, mesh in enumerate(scene.meshes) if k != floor}
    low, high = bounds(list(standing.values()))
    # GBufferTextures from any side the box is at least as large as its middle extent, so no map's texel is smaller than this.
    texels = [float(np.sort(high - low)[1]) / size for size in sizes]
    cut = {k for k in standing if alpha_test_of(scene.meshes[k].material)}  # cut.py draws them; here they have their room alone
    versions = {k: [geometry] * len(texels) if k in cut else simplified(geometry, texels) for k, geometry in standing.items()}
    # Sizes share a level where no mesh has another version.
    fresh = [n == 0 or any(made[n] is not made[n - 1] for made in versions.values()) for n in range(len(sizes))]
    levels = (np.cumsum(fresh) - 1).tolist()
    drawn = [{k: local_order(versions[k][n]) for k in standing} for n in np.flatnonzero(fresh)]
    drawn = [{k: part._replace(triangles=part.triangles[: 0 if k in cut else None]) for k, part in level.items()} for level in drawn]
    ordered = [(k, part) for level in drawn for closed in (True, False) for k, part in level.items() if part.closed == closed]
    ordered += [(floor, scene.meshes[floor].geometry)] if floor >= 0 else []
    parts = [part for _, part in ordered]
    vertices = np.cumsum([0, *(len(part.positions) for part in parts)]).tolist()
    indices = np.cumsum([0, *(part.triangles.size for part in parts)]).tolist()
    runs: dict[int, list[Run]] = {k: [] for k, _ in ordered}
    first: dict[int, IndexRange] = {}
    for n, (k, part) in enumerate(ordered):
        runs[k].append(Run(IndexRange(indices[n], part.triangles.size), part.closed))
        first.setdefault(k, IndexRange(vertices[n], len(part.positions)))
    made = {k: Caster(k, tuple(runs[k]), first[k], box_corners(scene.meshes[k].geometry if k == floor else drawn[0][k])) for k in runs}
    moving = [swept_bounds(mesh.geometry, mesh.motion) for mesh in scene.meshes if mesh.motion]
    on_floor = [part for level in drawn for part in level.values()]
    everything = bounds([*parts, *(mesh.geometry for mesh in scene.meshes)])
    boxes = [_around([bounds(on_floor), *moving]), _around([everything, *moving])]
    return Casters(
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.triangles.reshape(-1) + np.uint32(first) for part, first in zip(parts, vertices[:-1], strict=True)]),
        tuple(caster for k, caster in made.items() if k != floor),
        made.get(floor),
        tuple(levels),
        normal,
        np.array([(high + low) / 2 for low, high in boxes], np.float32),
        np.array([(high - low) / 2 for low, high in boxes], np.float32),
        tolerance,
    )


def _around(boxes: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)


def placed_casters(casters: Casters, matrices: np.ndarray, before: Placed | None = None) -> Placed:
    """The casters with world_from_rest (n, 4, 4) of the scene's meshes.

    Runs that nothing moved are drawn as one. The box stays that of `before` (of `casters` at first) while all casters are inside; else
    it grows. A floor that moves or that something moved pierces casts like any open mesh, until it no longer does.
    """
    moved = [member for member in casters.every if not np.array_equal(matrices[member.mesh], np.eye(4))]
    floor = casters.floor is not None and not any(_pierces(casters, member, matrices[member.mesh]) for member in moved)
    levels = tuple(_level(casters, matrices, level, floor) for level in range(max(casters.levels) + 1))
    apart = draw_ranges([casters.floor.runs[0].indices], [np.eye(4)]) if casters.floor and floor else ()
    if before and bool(before.floor) == floor:
        centre, half = before.box_centre, before.box_half
    else:
        around = 0 if floor else 1
        centre, half = casters.box_centre[around], casters.box_half[around]
    for member in moved:
        centre, half = _grown(centre, half, _moved(member.corners, matrices[member.mesh]))
    return Placed(levels, apart, casters.floor_normal if floor else np.zeros(3), centre, half, matrices)


def _level(casters: Casters, matrices: np.ndarray, level: int, floor: bool) -> Level:
    """The members' runs of a level, and the floor's where it is not drawn apart."""
    runs = [(member.runs[level], member.mesh) for member in casters.members]
    if casters.floor and not floor:
        runs.append((casters.floor.runs[0], casters.floor.mesh))
    runs.sort(key=lambda run: run[0].indices.first)  # in the buffer's order, in which `draw_ranges` joins them
    closed, open_ = ([run for run in runs if run[0].closed == closed] for closed in (True, False))
    return Level(*(draw_ranges([run.indices for run, _ in of], [matrices[mesh] for _, mesh in of]) for of in (closed, open_)))


def moved_by_m(casters: Casters, before: np.ndarray, after: np.ndarray) -> float:
    """How far any point of the casters moved at most between two states of the matrices (n, 4, 4), metres."""
    changed = [member for member in casters.every if not np.array_equal(before[member.mesh], after[member.mesh])]
    # The distance between two affine images of a point is convex in it: nowhere in a box is it larger than at a corner.
    steps = [_moved(member.corners, after[member.mesh]) - _moved(member.corners, before[member.mesh]) for member in changed]
    return max((float(np.linalg.norm(step, axis=-1).max()) for step in steps), default=0.0)


def _moved(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _pierces(casters: Casters, member: Caster, matrix: np.ndarray) -> bool:
    """Whether a moved caster reaches below the floor, or is the floor."""
    if casters.floor is None or member is casters.floor:
        return casters.floor is not None
    span = member.vertices
    points = _moved(casters.positions[span.first : span.first + span.count].astype(np.float64), matrix)
    floor = casters.positions[casters.floor.vertices.first].astype(np.float64)
    return bool(((points - floor) @ casters.floor_normal).min() < -casters.tolerance)


def _grown(centre: np.ndarray, half: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The box, a tenth larger than needed towards points that lie outside: the next ones may lie farther out."""
    low, high, lowest, highest = centre - half, centre + half, corners.min(axis=0), corners.max(axis=0)
    slack = 1e-5 * (high - low).max()  # float32
    if np.all(lowest >= low - slack) and np.all(highest <= high + slack):
        return centre, half
    more = 0.1 * (np.maximum(high, highest) - np.minimum(low, lowest))
    low = np.where(lowest < low - slack, lowest - more, low)
    high = np.where(highest > high + slack, highest + more, high)
    return ((low + high) / 2).astype(np.float32), ((high - low) / 2).astype(np.float32)


def simplified(geometry: Geometry, tolerances: Sequence[float]) -> list[Geometry]:
    """For each of rising tolerances, in metres, the mesh halved as often as it departs from `geometry` by at most that either way.

    Edges collapse by their quadric error (Garland and Heckbert 1997) as fast-simplification does it; without that library the mesh stays
    as it is. Its normals and texture coordinates are zeros: a shadow needs none. Like tolerances that give the same give one object.
    """
    try:
        import fast_simplification
    except ImportError:
        return [geometry] * len(tolerances)
    places, same = np.unique(geometry.positions, axis=0, return_inverse=True)
    levels: list[tuple[np.ndarray, np.ndarray]] = [(places, same.reshape(-1)[geometry.triangles].astype(np.int32))]
    while len(levels[-1][1]) >= WORTH:
        points, triangles = fast_simplification.simplify(levels[-1][0], levels[-1][1], target_reduction=0.5)  # pyright: ignore
        if not 0 < len(triangles) < len(levels[-1][1]):
            break
        levels.append((np.ascontiguousarray(points, np.float32), triangles))
    old = geometry.positions[geometry.triangles].astype(np.float64)
    departures = {0: 0.0}  # of levels, as far as they are known: it grows from level to level
    chosen = []
    for tolerance in tolerances:
        finest, coarsest = chosen[-1] if chosen else 0, len(levels) - 1
        while finest < coarsest:
            middle = (finest + coarsest + 1) // 2
            if middle not in departures:
                departures[middle] = _departure(old, levels[middle][0][levels[middle][1]].astype(np.float64))
            if departures[middle] <= tolerance:
                finest = middle
            else:
                coarsest = middle - 1
        chosen.append(finest)
    made = {level: _cast(geometry, *levels[level]) if level else geometry for level in set(chosen)}
    return [made[level] for level in chosen]


def _cast(geometry: Geometry, points: np.ndarray, triangles: np.ndarray) -> Geometry:
    """A simpler surface in place of a geometry's, for shadows alone."""
    empty = np.zeros((len(points), 3), np.float32)
    closed = geometry.closed and is_closed(triangles, points[triangles].astype(np.float64))
    return Geometry(points, empty, empty[:, :2], triangles.astype(np.uint32), closed)


def _departure(old: np.ndarray, new: np.ndarray) -> float:
    """The larger of the distances from PROBES points of either surface (m, 3, 3) to the other, m, but for one in 1000."""
    rng = np.random.default_rng(0)
    (old_points, old_face), (new_points, new_face) = (_spread(corners, rng) for corners in (old, new))
    area = np.linalg.norm(np.cross(old[:, 1] - old[:, 0], old[:, 2] - old[:, 0]), axis=-1).sum() / 2
    gap = 3 * np.sqrt(area / (10 * PROBES))  # three times the points' spacing: hardly a hole among random points is wider
    there = _distances(old_points[:PROBES], new_points, new[new_face], gap)
    back = _distances(new_points[:PROBES], old_points, old[old_face], gap)
    return float(max(np.quantile(there, 0.999), np.quantile(back, 0.999)))


def _spread(corners: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """10 PROBES points spread evenly over triangles (m, 3, 3), and the triangle of each."""
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    face = np.searchsorted(np.cumsum(area), rng.uniform(0, area.sum(), 10 * PROBES)).clip(0, len(area) - 1)
    return np.einsum("kc,kcx->kx", rng.dirichlet([1, 1, 1], len(face)), corners[face]), face


def _distances(probes: np.ndarray, points: np.ndarray, triangles: np.ndarray, gap: float) -> np.ndarray:
    """Distances (n,) from probes (n, 3) to the nearest of the triangles (k, 3, 3) in which their NEAREST points (k, 3) lie.

    Beside that triangle, up to `gap` metres along its plane, the surface goes on: such a probe counts by its height.
    """
    near = triangles[KDTree(points).query(probes, NEAREST)[1]]
    p = probes[:, None]
    a, b, c = near[:, :, 0], near[:, :, 1], near[:, :, 2]
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    inside = np.ones(near.shape[:2], bool)
    distance = np.full(near.shape[:2], np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge, off = end - start, p - start
        inside &= np.einsum("ijk,ijk->ij", np.cross(edge, off), normal) >= 0
        along = np.einsum("ijk,ijk->ij", off, edge) / np.maximum(np.einsum("ijk,ijk->ij", edge, edge), 1e-300)
        distance = np.minimum(distance, np.linalg.norm(off - np.clip(along, 0, 1)[..., None] * edge, axis=-1))
    height = np.abs(np.einsum("ijk,ijk->ij", p - a, normal))
    best = np.argmin(np.where(inside, height, distance), axis=1)[:, None]
    height, distance = (np.take_along_axis(rows, best, axis=1)[:, 0] for rows in (height, np.where(inside, height, distance)))
    return np.where(distance**2 - height**2 < gap**2, height, distance)


def _floor(scene: Scene, tolerance: float) -> tuple[int, np.ndarray]:
    """Index and normal of the largest flat mesh that stands still, has no holes and all others on one side; (-1, zeros) for none."""
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
