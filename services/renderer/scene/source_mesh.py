"""A mesh as its file has it, and how corners that name position, texture coordinates and normal apart become vertices."""

from typing import NamedTuple

import numpy as np

from vemlight.renderer.scene.animation import RigidMotion
from vemlight.renderer.scene.materials import Material
from vemlight.renderer.scene.meshes import VertexAttributes


class SourceMesh(NamedTuple):
    """A mesh as its file has it. triangles: (m, 3). file_from_mesh: (4, 4)."""

    vertices: VertexAttributes
    triangles: np.ndarray
    file_from_mesh: np.ndarray
    material: Material | None
    motion: RigidMotion | None = None


class FileMeshes(NamedTuple):
    """What a file holds. left_out: a line for each thing that is not drawn."""

    meshes: list[SourceMesh]
    left_out: list[str]


class Corners(NamedTuple):
    """The corners of faces, one after the other.

    vertex: (k,) int64, numbers of positions. uv, normal: (k,) int64, numbers of texture coordinates and normals; None: there are none.
    """

    vertex: np.ndarray
    uv: np.ndarray | None = None
    normal: np.ndarray | None = None


def used_vertices(vertices: VertexAttributes, triangles: np.ndarray) -> tuple[VertexAttributes, np.ndarray]:
    """The vertices that triangles use, where many others are in the same arrays: exporters share them among primitives."""
    count = len(vertices.positions)
    if count <= triangles.size or triangles.size == 0 or triangles.min() < 0 or triangles.max() >= count:
        return vertices, triangles
    used, numbers = np.unique(triangles, return_inverse=True)
    others = (None if rows is None else rows[used] for rows in vertices[1:])
    return VertexAttributes(vertices.positions[used], *others), numbers.reshape(triangles.shape)


def indexed(
    corners: Corners, triangles: np.ndarray, positions: np.ndarray, uvs: np.ndarray, normals: np.ndarray, colours: np.ndarray | None
) -> tuple[VertexAttributes, np.ndarray]:
    """Vertices, and triangles (m, 3) of them, of triangles (m, 3) of corners.

    positions: (n, 3). uvs, normals: as the corners number them. colours: (n, 4) or None. Corners with the same numbers become one vertex.
    """
    if corners.uv is None and corners.normal is None:
        return used_vertices(VertexAttributes(positions, colours=colours), corners.vertex[triangles])
    taken = triangles.reshape(-1)
    uv, normal = (None if numbers is None else numbers[taken] for numbers in (corners.uv, corners.normal))
    # numbers of the pairs first: the product of all three might exceed 64 bits
    pair = np.zeros(len(taken), np.int64) if uv is None else uv
    if normal is not None:
        pair = np.unique(pair * (len(normals) + 1) + normal, return_inverse=True)[1]
    vertex = corners.vertex[taken]
    _, first, numbers = np.unique(vertex * (int(pair.max(initial=0)) + 1) + pair, return_index=True, return_inverse=True)
    found = VertexAttributes(
        positions[vertex[first]],
        None if normal is None else normals[normal[first]],
        None if uv is None else uvs[uv[first]],
        None if colours is None else colours[vertex[first]],
    )
    return found, numbers.reshape(-1, 3)
