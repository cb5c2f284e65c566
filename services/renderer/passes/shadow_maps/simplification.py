"""Meshes in fewer triangles, for shadow maps: no farther from the true surface than a tolerance."""

from collections.abc import Sequence

import numpy as np

from vemlight.renderer.scene.meshes import Geometry, is_closed

MIN_TRIANGLES = 500  # fewer cost a shadow map less than a clear of its tile
PROBES = 2000  # points at which either surface is compared with the other; any value in 1000 to 10000 does, at its cost
CANDIDATES = 10 * PROBES  # points of the other surface; any value in 5 to 20 times PROBES does
NEAREST = 8  # candidates in whose triangles the nearest point is looked for; any value in 4 to 16 does
QUANTILE = 0.999  # of the distances: one point in 1000, some hundred texels of a map, may lie farther off


def simplified(geometry: Geometry, tolerances: Sequence[float]) -> list[Geometry]:
    """For each of rising tolerances, in metres, the mesh with its triangles halved as often as it stays so near to `geometry`.

    Edges collapse by their quadric error (Garland and Heckbert 1997) as fast-simplification does it; without that library the mesh stays
    as it is. Normals and texture coordinates become zeros: a shadow needs none. Tolerances that give the same mesh give one object.
    """
    try:
        import fast_simplification
    except ImportError:
        return [geometry] * len(tolerances)
    places, same = np.unique(geometry.positions, axis=0, return_inverse=True)
    levels: list[tuple[np.ndarray, np.ndarray]] = [(places, same.reshape(-1)[geometry.triangles].astype(np.int32))]
    while len(levels[-1][1]) >= MIN_TRIANGLES:
        points, triangles = fast_simplification.simplify(levels[-1][0], levels[-1][1], target_reduction=0.5)  # pyright: ignore
        if not 0 < len(triangles) < len(levels[-1][1]):
            break
        levels.append((np.ascontiguousarray(points, np.float32), triangles))
    old = geometry.positions[geometry.triangles].astype(np.float64)
    departures = {0: 0.0}  # by level, as far as measured: they grow from level to level
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
    made = {level: _for_shadows(geometry, *levels[level]) if level else geometry for level in set(chosen)}
    return [made[level] for level in chosen]


def _for_shadows(geometry: Geometry, points: np.ndarray, triangles: np.ndarray) -> Geometry:
    """A simplified surface in place of a geometry's."""
    empty = np.zeros((len(points), 3), np.float32)
    closed = geometry.closed and is_closed(triangles, points[triangles].astype(np.float64))
    return Geometry(points, empty, empty[:, :2], triangles.astype(np.uint32), closed)


def _departure(old: np.ndarray, new: np.ndarray) -> float:
    """The larger of the distances in metres from PROBES points of either surface (m, 3, 3) to the other, at QUANTILE."""
    rng = np.random.default_rng(0)
    (old_points, old_face), (new_points, new_face) = (_points_on(corners, rng) for corners in (old, new))
    area = np.linalg.norm(np.cross(old[:, 1] - old[:, 0], old[:, 2] - old[:, 0]), axis=-1).sum() / 2
    gap = 3 * np.sqrt(area / CANDIDATES)  # three times the points' spacing: hardly a hole among random points is wider
    there = _distances(old_points[:PROBES], new_points, new[new_face], gap)
    back = _distances(new_points[:PROBES], old_points, old[old_face], gap)
    return float(max(np.quantile(there, QUANTILE), np.quantile(back, QUANTILE)))


def _points_on(corners: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """10 PROBES points spread evenly over triangles (m, 3, 3), and the triangle of each."""
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    face = np.searchsorted(np.cumsum(area), rng.uniform(0, area.sum(), CANDIDATES)).clip(0, len(area) - 1)
    return np.einsum("kc,kcx->kx", rng.dirichlet([1, 1, 1], len(face)), corners[face]), face


def _distances(probes: np.ndarray, points: np.ndarray, triangles: np.ndarray, gap: float) -> np.ndarray:
    """Distances (n,) from probes (n, 3) to the nearest of the triangles (k, 3, 3) in which their NEAREST points (k, 3) lie.

    Beside that triangle, up to `gap` metres along its plane, the surface goes on: such a probe counts by its height.
    """
    from scipy.spatial import KDTree  # here, since it takes a third of a second to load

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
