"""The scene's triangles as the GPU reads them: one vertex and one index buffer, neighbours near in memory."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from vemlight.renderer.scene.meshes import Geometry
from vemlight.renderer.scene.scene import Scene

VERTEX = np.dtype([("position", np.float32, 3), ("normal", np.float32, 3), ("uv", np.float32, 2), ("colour", np.float16, 4)])


class IndexRange(NamedTuple):
    """A run of the index buffer."""

    first: int
    count: int


class DrawRange(NamedTuple):
    """A run of the index buffer that moves as one: world_from_rest (4, 4)."""

    indices: IndexRange
    world_from_rest: np.ndarray


class VertexBuffers(NamedTuple):
    """vertices: (n,) VERTEX. indices: (3 m,) uint32. mesh_ranges: one a mesh. second_uvs: (n, 2) float32, 0 where a mesh has none."""

    vertices: np.ndarray
    indices: np.ndarray
    mesh_ranges: tuple[IndexRange, ...]
    second_uvs: np.ndarray


def vertex_buffers(scene: Scene) -> VertexBuffers:
    """The scene's buffers."""
    vertices, indices, mesh_ranges, second_uvs = [], [], [], []
    first_vertex = first_index = 0
    for mesh in scene.meshes:
        near = local_order(mesh.geometry)
        rows = np.empty(len(near.positions), VERTEX)
        rows["position"], rows["normal"], rows["uv"] = near.positions, near.normals, near.uvs
        rows["colour"] = 1.0 if near.colours is None else near.colours
        vertices.append(rows)
        second_uvs.append(np.zeros_like(near.uvs) if near.second_uvs is None else near.second_uvs)
        indices.append(near.triangles.reshape(-1) + np.uint32(first_vertex))
        mesh_ranges.append(IndexRange(first_index, near.triangles.size))
        first_vertex, first_index = first_vertex + len(rows), first_index + near.triangles.size
    return VertexBuffers(np.concatenate(vertices), np.concatenate(indices), tuple(mesh_ranges), np.concatenate(second_uvs))


def draw_ranges(mesh_ranges: Iterable[IndexRange], matrices: Iterable[np.ndarray]) -> tuple[DrawRange, ...]:
    """Runs of meshes in the buffer's order, joined where they touch and stand alike."""
    found: list[DrawRange] = []
    for span, matrix in zip(mesh_ranges, matrices, strict=True):
        last = found[-1] if found else None
        if last and sum(last.indices) == span.first and np.array_equal(last.world_from_rest, matrix):
            found[-1] = DrawRange(IndexRange(last.indices.first, last.indices.count + span.count), matrix)
        else:
            found.append(DrawRange(span, matrix))
    return tuple(found)


def local_order(mesh: Geometry) -> Geometry:
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
    colours, second = (None if rows is None else rows[used] for rows in (mesh.colours, mesh.second_uvs))
    return Geometry(mesh.positions[used], mesh.normals[used], mesh.uvs[used], renumbered[triangles], mesh.closed, colours, second)
