"""The scene's triangles as the GPU reads them: one vertex and one index buffer, ordered so that shadow maps draw few and near vertices."""

from typing import NamedTuple

import numpy as np

from services.renderer.meshes import Geometry, bounds
from services.renderer.scene import Mesh, Scene

VERTEX = np.dtype([("position", np.float32, 3), ("normal", np.float32, 3), ("uv", np.float32, 2)])


class Span(NamedTuple):
    """A run of the index buffer."""

    first: int
    count: int


class Drawable(NamedTuple):
    """vertices: (n,) VERTEX. indices: (3 m,) uint32. spans: of scene.meshes, in their order.

    closed, open, floor: what casts shadows. Closed meshes cast with the faces towards the light alone. The floor, a flat mesh with the
    whole scene on one side, casts only for lights on the other; floor_normal (3,) points to the scene, zeros without a floor.
    box_centre, box_half: (2, 3) float32, the box around the casters of lights above the floor, and of lights below.
    """

    vertices: np.ndarray
    indices: np.ndarray
    spans: tuple[Span, ...]
    closed: Span
    open: Span
    floor: Span
    floor_normal: np.ndarray
    box_centre: np.ndarray
    box_half: np.ndarray


def drawable_scene(scene: Scene) -> Drawable:
    """The scene's buffers, its floor found, closed meshes first."""
    floor, normal = _floor(scene)
    order = sorted(range(len(scene.meshes)), key=lambda k: 2 if k == floor else 0 if scene.meshes[k].geometry.closed else 1)
    vertices, indices, spans, counts = [], [], {}, [0, 0, 0]
    first_vertex = first_index = 0
    for k in order:
        mesh = _local_order(scene.meshes[k].geometry)
        rows = np.empty(len(mesh.positions), VERTEX)
        rows["position"], rows["normal"], rows["uv"] = mesh.positions, mesh.normals, mesh.uvs
        vertices.append(rows)
        indices.append(mesh.triangles.reshape(-1) + np.uint32(first_vertex))
        spans[k] = Span(first_index, mesh.triangles.size)
        counts[2 if k == floor else 0 if mesh.closed else 1] += mesh.triangles.size
        first_vertex, first_index = first_vertex + len(rows), first_index + mesh.triangles.size
    without_floor = [mesh for k, mesh in enumerate(scene.meshes) if k != floor]
    boxes = [bounds([mesh.geometry for mesh in meshes]) for meshes in (without_floor, scene.meshes)]
    return Drawable(
        np.concatenate(vertices),
        np.concatenate(indices),
        tuple(spans[k] for k in range(len(scene.meshes))),
        Span(0, counts[0]),
        Span(counts[0], counts[1]),
        Span(counts[0] + counts[1], counts[2]),
        normal,
        np.array([(high + low) / 2 for low, high in boxes], np.float32),
        np.array([(high - low) / 2 for low, high in boxes], np.float32),
    )


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


def _local_order(mesh: Geometry) -> Geometry:
    """The same mesh with neighbouring triangles and vertices near in memory: triangles along a Morton curve, vertices by first use.

    A vertex is then transformed about once in a software rasteriser, whose cache holds few vertices.
    """
    centres = mesh.positions[mesh.triangles].mean(axis=1)
    low = centres.min(axis=0)
    cells = ((centres - low) * (1023 / max(float(np.ptp(centres, axis=0).max()), 1e-30))).astype(np.uint64)
    code = np.zeros(len(cells), np.uint64)
    for bit in range(10):  # 10 bits an axis: 1024 cells along the longest side
        for axis in range(3):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    triangles = mesh.triangles[np.argsort(code, kind="stable")]
    used, first = np.unique(triangles.reshape(-1), return_index=True)
    used = used[np.argsort(first)]
    renumbered = np.empty(len(mesh.positions), np.uint32)
    renumbered[used] = np.arange(len(used), dtype=np.uint32)
    return Geometry(mesh.positions[used], mesh.normals[used], mesh.uvs[used], renumbered[triangles], mesh.closed)
