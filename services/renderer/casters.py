"""What casts shadows: the scene's meshes in as few triangles as a shadow map can show, and the box around them."""

from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from services.renderer.geometry import Span, local_order
from services.renderer.meshes import Geometry, bounds, is_closed
from services.renderer.scene import Mesh, Scene

WORTH = 500  # triangles; fewer cost a shadow map less than a clear of its tile
PROBES = 2000  # points at which either surface is compared with the other; with 10 times as many to find what is near
NEAREST = 8  # of those points, in whose triangles the nearest is looked for


class Casters(NamedTuple):
    """positions: (n, 3) float32. indices: (3 m,) uint32, of them runs that are closed, open, and the floor.

    Closed meshes cast with the faces towards the light alone. The floor, a flat mesh with the whole scene on one side, casts only for
    lights on the other; floor_normal (3,) points to the scene, zeros without a floor. box_centre, box_half: (2, 3) float32, the box around
    the casters of lights above the floor, and of lights below.
    """

    positions: np.ndarray
    indices: np.ndarray
    closed: Span
    open: Span
    floor: Span
    floor_normal: np.ndarray
    box_centre: np.ndarray
    box_half: np.ndarray


def scene_casters(scene: Scene, tile_size: int) -> Casters:
    """The casters for maps of `tile_size` texels a side, the closed ones first: simplified by no more than a texel, the shader's bias."""
    floor, normal = _floor(scene)
    standing = [mesh.geometry for k, mesh in enumerate(scene.meshes) if k != floor]
    low, high = bounds(standing)
    # Seen from any side the box is at least as large as its middle extent, so no map's texel is smaller than this.
    texel = float(np.sort(high - low)[1]) / tile_size
    standing = [local_order(simplified(geometry, texel)) for geometry in standing]
    runs = [[g for g in standing if g.closed], [g for g in standing if not g.closed], [scene.meshes[floor].geometry] if floor >= 0 else []]
    parts = [geometry for run in runs for geometry in run]
    counts = [sum(geometry.triangles.size for geometry in run) for run in runs]
    offsets = np.cumsum([0, *(len(geometry.positions) for geometry in parts)])
    boxes = [bounds([*runs[0], *runs[1]]), bounds([*parts, *(mesh.geometry for mesh in scene.meshes)])]
    return Casters(
        np.concatenate([geometry.positions for geometry in parts]),
        np.concatenate([geometry.triangles.reshape(-1) + np.uint32(first) for geometry, first in zip(parts, offsets[:-1], strict=True)]),
        Span(0, counts[0]),
        Span(counts[0], counts[1]),
        Span(counts[0] + counts[1], counts[2]),
        normal,
        np.array([(high + low) / 2 for low, high in boxes], np.float32),
        np.array([(high - low) / 2 for low, high in boxes], np.float32),
    )


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


def _floor(scene: Scene) -> tuple[int, np.ndarray]:
    """Index and normal of the largest flat mesh that has all the others on one side; (-1, zeros) when there is none."""
    tolerance = 1e-4 * float(np.linalg.norm(scene.half))  # a foot sunk by so little casts no shadow that a texel shows
    best, index, normal = 0.0, -1, np.zeros(3)
    for k, mesh in enumerate(scene.meshes):
        others = [other.geometry.positions for j, other in enumerate(scene.meshes) if j != k]
        area, n, point = _plane(mesh, tolerance)
        if area <= best or not others:
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
