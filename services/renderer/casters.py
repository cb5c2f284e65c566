"""What casts shadows: the scene's meshes in as few triangles as a shadow map can show, and the box around them."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from services.renderer.geometry import Piece, Span, local_order, pieces
from services.renderer.meshes import Geometry, bounds, box_corners, is_closed, swept_bounds
from services.renderer.scene import Mesh, Scene

WORTH = 500  # triangles; fewer cost a shadow map less than a clear of its tile
PROBES = 2000  # points at which either surface is compared with the other; with 10 times as many to find what is near
NEAREST = 8  # of those points, in whose triangles the nearest is looked for


class Caster(NamedTuple):
    """One mesh in the buffers: its number in the scene, its runs of indices and of vertices, and the box around it, (8, 3) float64."""

    mesh: int
    indices: Span
    vertices: Span
    corners: np.ndarray


class Casters(NamedTuple):
    """positions: (n, 3) float32. indices: (3 m,) uint32, of them runs that are closed, open, and the floor; members: in the runs' order.

    Closed meshes cast with the faces towards the light alone. The floor, a flat mesh with the whole scene on one side, casts only for
    lights on the other; floor_normal (3,) points to the scene, zeros without a floor. box_centre, box_half: (2, 3) float32, the box
    around what stands on the floor, which is all that its own shadow can fall on too, and the box around everything. tolerance: metres by
    which a floor may be pierced.
    """

    positions: np.ndarray
    indices: np.ndarray
    closed: Span
    open: Span
    floor: Span
    members: tuple[Caster, ...]
    floor_normal: np.ndarray
    box_centre: np.ndarray
    box_half: np.ndarray
    tolerance: float


class Placed(NamedTuple):
    """Casters as they stand: what is drawn as closed, as open and as the floor, and the box around what shadows fall from and on, (3,)."""

    closed: tuple[Piece, ...]
    open: tuple[Piece, ...]
    floor: tuple[Piece, ...]
    floor_normal: np.ndarray
    box_centre: np.ndarray
    box_half: np.ndarray


def scene_casters(scene: Scene, tile_size: int) -> Casters:
    """The casters for maps of `tile_size` texels a side, the closed ones first: simplified by no more than a texel, the shader's bias."""
    tolerance = 1e-4 * float(np.linalg.norm(scene.half))  # a foot sunk by so little casts no shadow that a texel shows
    floor, normal = _floor(scene, tolerance)
    standing = {k: mesh.geometry for k, mesh in enumerate(scene.meshes) if k != floor}
    low, high = bounds(list(standing.values()))
    # Seen from any side the box is at least as large as its middle extent, so no map's texel is smaller than this.
    texel = float(np.sort(high - low)[1]) / tile_size
    standing = {k: local_order(simplified(geometry, texel)) for k, geometry in standing.items()}
    closed = [k for k, geometry in standing.items() if geometry.closed]
    open_ = [k for k, geometry in standing.items() if not geometry.closed]
    runs = [closed, open_, [floor] if floor >= 0 else []]
    parts = [scene.meshes[k].geometry if k == floor else standing[k] for run in runs for k in run]
    vertices = np.cumsum([0, *(len(geometry.positions) for geometry in parts)]).tolist()
    indices = np.cumsum([0, *(geometry.triangles.size for geometry in parts)]).tolist()
    members = [
        Caster(k, Span(indices[n], part.triangles.size), Span(vertices[n], len(part.positions)), box_corners(part))
        for n, (k, part) in enumerate(zip([k for run in runs for k in run], parts, strict=True))
    ]
    moving = [swept_bounds(mesh.geometry, mesh.motion) for mesh in scene.meshes if mesh.motion]
    everything = bounds([*parts, *(mesh.geometry for mesh in scene.meshes)])
    boxes = [_around([bounds(list(standing.values())), *moving]), _around([everything, *moving])]
    ends = (0, indices[len(closed)], indices[len(closed) + len(open_)], indices[-1])
    return Casters(
        np.concatenate([geometry.positions for geometry in parts]),
        np.concatenate([geometry.triangles.reshape(-1) + np.uint32(first) for geometry, first in zip(parts, vertices[:-1], strict=True)]),
        Span(ends[0], ends[1] - ends[0]),
        Span(ends[1], ends[2] - ends[1]),
        Span(ends[2], ends[3] - ends[2]),
        tuple(members),
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
    moved = [member for member in casters.members if not np.array_equal(matrices[member.mesh], np.eye(4))]
    floor = bool(casters.floor_normal.any()) and not any(_pierces(casters, member, matrices[member.mesh]) for member in moved)
    closed, open_, apart = [], [], []
    for member in casters.members:
        first = member.indices.first
        run = closed if first < casters.open.first else open_ if first < casters.floor.first or not floor else apart
        run.append(member)
    runs = {
        name: pieces([member.indices for member in run], [matrices[member.mesh] for member in run])
        for name, run in (("closed", closed), ("open", open_), ("floor", apart))
    }
    if before and bool(before.floor) == floor:
        centre, half = before.box_centre, before.box_half
    else:
        around = 0 if floor else 1
        centre, half = casters.box_centre[around], casters.box_half[around]
    for member in moved:
        centre, half = _grown(centre, half, _moved(member.corners, matrices[member.mesh]))
    return Placed(**runs, floor_normal=casters.floor_normal if floor else np.zeros(3), box_centre=centre, box_half=half)


def moved_by_m(casters: Casters, before: np.ndarray, after: np.ndarray) -> float:
    """How far any point of the casters moved at most between two states of the matrices (n, 4, 4), metres."""
    changed = [member for member in casters.members if not np.array_equal(before[member.mesh], after[member.mesh])]
    # The distance between two affine images of a point is convex in it: nowhere in a box is it larger than at a corner.
    steps = [_moved(member.corners, after[member.mesh]) - _moved(member.corners, before[member.mesh]) for member in changed]
    return max((float(np.linalg.norm(step, axis=-1).max()) for step in steps), default=0.0)


def _moved(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def _pierces(casters: Casters, member: Caster, matrix: np.ndarray) -> bool:
    """Whether a moved caster reaches below the floor, or is the floor."""
    if member.indices == casters.floor:
        return True
    span = member.vertices
    points = _moved(casters.positions[span.first : span.first + span.count].astype(np.float64), matrix)
    floor = casters.positions[casters.indices[casters.floor.first]].astype(np.float64)
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


def simplified(geometry: Geometry, tolerance: float) -> Geometry:
    """The mesh halved as often as it departs from `geometry` by at most `tolerance` metres either way.

    Edges collapse by their quadric error (Garland and Heckbert 1997) as fast-simplification does it; without that library the mesh stays
    as it is. Its normals and texture coordinates are zeros: a shadow needs none.
    """
    try:
        import fast_simplification
    except ImportError:
        return geometry
    places, same = np.unique(geometry.positions, axis=0, return_inverse=True)
    levels: list[tuple[np.ndarray, np.ndarray]] = [(places, same.reshape(-1)[geometry.triangles].astype(np.int32))]
    while len(levels[-1][1]) >= WORTH:
        points, triangles = fast_simplification.simplify(levels[-1][0], levels[-1][1], target_reduction=0.5)  # pyright: ignore
        if not 0 < len(triangles) < len(levels[-1][1]):
            break
        levels.append((np.ascontiguousarray(points, np.float32), triangles))
    old = geometry.positions[geometry.triangles].astype(np.float64)
    finest, coarsest = 0, len(levels) - 1  # the departure grows from level to level
    while finest < coarsest:
        middle = (finest + coarsest + 1) // 2
        if _departure(old, levels[middle][0][levels[middle][1]].astype(np.float64)) <= tolerance:
            finest = middle
        else:
            coarsest = middle - 1
    if finest == 0:
        return geometry
    points, triangles = levels[finest]
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
    """Index and normal of the largest flat mesh that stands still and has all the others on one side; (-1, zeros) when there is none."""
    best, index, normal = 0.0, -1, np.zeros(3)
    for k, mesh in enumerate(scene.meshes):
        others = [other.geometry.positions for j, other in enumerate(scene.meshes) if j != k]
        area, n, point = _plane(mesh, tolerance)
        if area <= best or not others or mesh.motion:
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
