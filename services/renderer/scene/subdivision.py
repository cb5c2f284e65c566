"""Long triangles cut where the camera is near them. Rasterisers of browsers interpolate a triangle's positions and texture coordinates to a
few 1e-5 of its size: on a ground of 16 km that is half a metre before the camera's feet. All of them clip it to 1e-7 of its size, a
millimetre: in shadow maps of lamps, whose near planes are centimetres away, that is a tenth of a depth.
"""

from collections.abc import Iterable

import numpy as np

from vemlight.renderer.scene.camera_table import ViewCamera
from vemlight.renderer.scene.meshes import Geometry

MAX_ROUNDS = 40  # of cutting all edges that are too long in half: from 1e9 to 1e-3 m


def seen_short(meshes: Iterable[Geometry], camera: ViewCamera) -> list[Geometry]:
    """The meshes with short edges about what a camera looks at, which it sees from the radius."""
    at = np.array(camera.at, np.float64)
    radius = float(np.linalg.norm(at - camera.position))
    return [with_short_edges(mesh, at, radius) for mesh in meshes]


def with_short_edges(mesh: Geometry, centre: np.ndarray, short: float, about: float | None = None) -> Geometry:
    """The same surface, in which no edge is longer than `short` and than its middle's distance from `centre` (3,) too; with `about`, than
    `short` and its distance from a ball of that radius together. All in metres.

    Whether an edge is cut depends on the edge alone, so that neighbours stay neighbours.
    """
    for _ in range(MAX_ROUNDS):
        edges, of_triangle = _edges(mesh.triangles)
        a, b = mesh.positions[edges[:, 0]].astype(np.float64), mesh.positions[edges[:, 1]].astype(np.float64)
        away = np.linalg.norm((a + b) / 2 - centre, axis=1)
        limits = np.maximum(away, short) if about is None else short + np.maximum(away - about, 0)
        cut = np.linalg.norm(a - b, axis=1) > limits
        if not cut.any():
            break
        numbers = np.where(cut, len(mesh.positions) + np.cumsum(cut) - 1, -1)[of_triangle]
        mesh = _with_middles(mesh, edges[cut])._replace(triangles=_cut_triangles(mesh.triangles, numbers))
    return mesh


def _edges(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges (n, 2) and which of them each triangle has: (m, 3), opposite to its corners 2, 0 and 1."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, of_side = np.unique(sides, axis=0, return_inverse=True)
    return edges, of_side.reshape(-1, 3)


def _with_middles(mesh: Geometry, edges: np.ndarray) -> Geometry:
    """The mesh with a vertex more in the middle of each edge."""

    def more(rows: np.ndarray | None) -> np.ndarray | None:
        return None if rows is None else np.concatenate([rows, (rows[edges[:, 0]] + rows[edges[:, 1]]) / 2]).astype(rows.dtype)

    names = ("positions", "normals", "uvs", "colours", "second_uvs")
    return mesh._replace(**{name: more(getattr(mesh, name)) for name in names})


def _cut_triangles(triangles: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """The triangles, each in as many parts as it has middles, and one more. middles: (m, 3), of its sides; -1: none."""
    parts = []
    for turn in range(3):  # so that each pattern of cut sides is one of four
        a, b, c = np.roll(triangles, -turn, axis=1).T
        ab, bc, ca = np.roll(middles, -turn, axis=1).T
        one = (ab >= 0) & (bc < 0) & (ca < 0)
        two = (ab >= 0) & (bc >= 0) & (ca < 0)
        parts += [np.stack(corners, 1)[one] for corners in ((a, ab, c), (ab, b, c))]
        parts += [np.stack(corners, 1)[two] for corners in ((ab, b, bc), (a, ab, bc), (a, bc, c))]
    a, b, c = triangles.T
    ab, bc, ca = middles.T
    none, all_three = (middles < 0).all(axis=1), (middles >= 0).all(axis=1)
    parts += [np.stack(corners, 1)[all_three] for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate([triangles[none], *parts]).astype(triangles.dtype)
