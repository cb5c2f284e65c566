"""The scene's triangles as one vertex and one index buffer, in an order that vertex caches and rasterisers like."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from vemlight.renderer.gl.buffers import SCENE_VERTEX
from vemlight.renderer.scene.meshes import Geometry
from vemlight.renderer.scene.scene import Scene

MORTON_BITS = 10  # an axis: 1024 cells along the longest side; any value in 6 .. 20 does


class IndexRange(NamedTuple):
    """A range of the index buffer."""

    first: int
    count: int

    @property
    def end(self) -> int:
        return self.first + self.count


class DrawRange(NamedTuple):
    """A range of the index buffer under one transform, world_from_rest (4, 4)."""

    indices: IndexRange
    world_from_rest: np.ndarray


class VertexBuffers(NamedTuple):
    """vertices: (n,) SCENE_VERTEX. indices: (3 m,) uint32. mesh_ranges: one a mesh. second_uvs: (n, 2) float32, 0 where a mesh has none.

    vertex_ranges: of each mesh, without those that no triangle has.
    """

    vertices: np.ndarray
    indices: np.ndarray
    mesh_ranges: tuple[IndexRange, ...]
    second_uvs: np.ndarray
    vertex_ranges: tuple[IndexRange, ...]


def vertex_buffers(scene: Scene) -> VertexBuffers:
    """The buffers of all meshes, one after the other."""
    vertices, indices, mesh_ranges, second_uvs, vertex_ranges = [], [], [], [], []
    first_vertex = first_index = 0
    for mesh in scene.meshes:
        geometry = local_order(mesh.geometry)
        rows = np.empty(len(geometry.positions), SCENE_VERTEX.dtype)
        rows["position"], rows["normal"], rows["uv"] = geometry.positions, geometry.normals, geometry.uvs
        rows["vertex_colour"] = 1.0 if geometry.colours is None else geometry.colours
        vertices.append(rows)
        second_uvs.append(np.zeros_like(geometry.uvs) if geometry.second_uvs is None else geometry.second_uvs)
        indices.append(geometry.triangles.reshape(-1) + np.uint32(first_vertex))
        vertex_ranges.append(IndexRange(first_vertex, len(rows)))
        mesh_ranges.append(IndexRange(first_index, geometry.triangles.size))
        first_vertex, first_index = first_vertex + len(rows), mesh_ranges[-1].end
    joined = np.concatenate(vertices), np.concatenate(indices)
    return VertexBuffers(*joined, tuple(mesh_ranges), np.concatenate(second_uvs), tuple(vertex_ranges))


def draw_ranges(ranges: Iterable[IndexRange], matrices: Iterable[np.ndarray]) -> tuple[DrawRange, ...]:
    """Ranges in the buffer's order with world_from_rest (4, 4) of each, those that touch and move alike joined into one."""
    joined: list[DrawRange] = []
    for indices, matrix in zip(ranges, matrices, strict=True):
        last = joined[-1] if joined else None
        if last and last.indices.end == indices.first and np.array_equal(last.world_from_rest, matrix):
            joined[-1] = DrawRange(IndexRange(last.indices.first, last.indices.count + indices.count), matrix)
        else:
            joined.append(DrawRange(indices, matrix))
    return tuple(joined)


def local_order(mesh: Geometry) -> Geometry:
    """The same mesh with neighbours near in memory: triangles along a Morton curve, vertices by first use.

    A software rasteriser, whose cache holds few vertices, then transforms a vertex about once.
    """
    centres = mesh.positions[mesh.triangles].mean(axis=1)
    low = centres.min(axis=0)
    longest = max(float(np.ptp(centres, axis=0).max()), 1e-30)
    cells = ((centres - low) * ((2**MORTON_BITS - 1) / longest)).astype(np.uint64)
    code = np.zeros(len(cells), np.uint64)
    for bit in range(MORTON_BITS):
        for axis in range(3):
            code |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    triangles = mesh.triangles[np.argsort(code, kind="stable")]
    used, first = np.unique(triangles.reshape(-1), return_index=True)
    used = used[np.argsort(first)]
    renumbered = np.empty(len(mesh.positions), np.uint32)
    renumbered[used] = np.arange(len(used), dtype=np.uint32)
    colours, second_uvs = (None if rows is None else rows[used] for rows in (mesh.colours, mesh.second_uvs))
    return Geometry(mesh.positions[used], mesh.normals[used], mesh.uvs[used], renumbered[triangles], mesh.closed, colours, second_uvs)
