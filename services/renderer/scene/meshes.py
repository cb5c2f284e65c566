"""Triangle meshes as clean geometry with normals: what files hold, and simple shapes.

Normals are the file's where it has them. Elsewhere faces that meet at less than CREASE_RAD share a smooth normal and sharper edges stay
sharp, so that a bunny is round and a box has flat sides.
"""

from typing import Literal, NamedTuple

import numpy as np

from vemlight.renderer.scene.animation import RigidMotion

Shape = Literal["sphere", "plane", "box"]
MAX_SWEEP_TIMES = 64  # of an animation, keyframes and evenly spaced ones each, at which its reach is measured; any value above 16 does
SWEEP_MARGIN = 0.02  # half a turn in ten steps leaves its chords by 1 - cos(pi / 20), 1.2 % of the radius; any value in 0.013 .. 0.05 does
CREASE_RAD = np.radians(40.0)  # above the facets of a coarse round form (a 12-sided tube: 30 degrees), below a chamfer (45 degrees)
MAX_SIZE_M = 1e9  # of a mesh in its file's unit; any value in 1e7 .. 1e12 does
MIN_RELATIVE_AREA = 1e-14  # of a triangle, to its mesh's size squared; float64 rounds at 1e-16 of that. Any value in 1e-15 .. 1e-12 does
# Of a box whose vertices count in binary, x first: two triangles a side, wound outwards.
BOX_TRIANGLES = np.array([[1, 3, 0], [4, 1, 0], [0, 3, 2], [2, 4, 0], [1, 7, 3], [5, 1, 4], [5, 7, 1], [3, 7, 2], [6, 4, 2], [2, 7, 6]])
BOX_TRIANGLES = np.concatenate([BOX_TRIANGLES, [[6, 5, 4], [7, 5, 6]]])
SIMILARITY = 1e-5  # by which normals may be off in length: matrices of a file have float32's 1e-7; any value in 1e-6 .. 1e-3 does
MIN_NORMAL = 1e-6  # length; shorter ones have no direction. Any value in 1e-12 .. 1e-2 does


class NothingToDraw(ValueError):
    """A mesh without triangles, size or area."""


class Geometry(NamedTuple):
    """A triangle mesh.

    positions: (n, 3) float32, metres. normals: (n, 3) float32, unit. uvs: (n, 2) float32, v upwards. triangles: (m, 3) uint32.
    closed: the faces enclose volumes and are wound outwards. colours: (n, 4) float32, linear with alpha, times the material's; None: white.
    second_uvs: (n, 2) float32, the second set of texture coordinates; None where the mesh has none.
    """

    positions: np.ndarray
    normals: np.ndarray
    uvs: np.ndarray
    triangles: np.ndarray
    closed: bool
    colours: np.ndarray | None = None
    second_uvs: np.ndarray | None = None

    def moved(self, linear: np.ndarray, offset: np.ndarray) -> "Geometry":
        """The geometry under `linear` (3, 3), rotations and scales of a determinant above 0, then `offset` (3,)."""
        positions = self.positions @ linear.T.astype(np.float64) + offset
        if is_similarity(linear):
            normals = self.normals @ (linear / np.cbrt(np.linalg.det(linear))).T
        else:
            normals = self.normals @ np.linalg.inv(linear)
            normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        return self._replace(positions=positions.astype(np.float32), normals=normals.astype(np.float32))


def is_similarity(linear: np.ndarray) -> bool:
    """Whether a transform (3, 3) is a rotation with uniform scale."""
    with np.errstate(all="ignore"):
        scale = np.cbrt(np.linalg.det(linear))
        return bool(scale > 0 and np.allclose(linear @ linear.T, scale**2 * np.eye(3), rtol=0, atol=SIMILARITY * scale**2))


class VertexAttributes(NamedTuple):
    """What a file says of a mesh's vertices, (n, ...) each, as in Geometry; None where it says nothing."""

    positions: np.ndarray
    normals: np.ndarray | None = None
    uvs: np.ndarray | None = None
    colours: np.ndarray | None = None
    second_uvs: np.ndarray | None = None


def bounds(geometries: list[Geometry]) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and highest corner, (3,) float64 each, of the box around geometries."""
    low = np.min([g.positions.min(axis=0) for g in geometries], axis=0)
    high = np.max([g.positions.max(axis=0) for g in geometries], axis=0)
    return low.astype(np.float64), high.astype(np.float64)


def box_corners(geometry: Geometry) -> np.ndarray:
    """The corners (8, 3) float64 of the box around a geometry."""
    low, high = bounds([geometry])
    return np.where(np.indices((2, 2, 2)).reshape(3, 8).T, high, low)


def swept_bounds(geometry: Geometry, motion: RigidMotion | None) -> tuple[np.ndarray, np.ndarray]:
    """As `bounds`, of the box around a geometry's box wherever a motion brings it."""
    if motion is None:
        return bounds([geometry])
    matrices = motion.matrices(motion.sample_times_s(MAX_SWEEP_TIMES))
    swept = np.einsum("tij,cj->tci", matrices[:, :3, :3], box_corners(geometry)) + matrices[:, None, :3, 3]
    low, high = swept.min(axis=(0, 1)), swept.max(axis=(0, 1))
    margin = SWEEP_MARGIN * (high - low)
    return low - margin, high + margin


def shape_geometry(shape: Shape) -> Geometry:
    """A sphere of radius 1, a plane of 2 x 2 in z = 0 that faces +Z, or a box of side 2, each centred."""
    if shape == "sphere":
        return _sphere(48, 96)
    if shape == "plane":
        positions = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float64)
        return clean_geometry(VertexAttributes(positions), np.array([[0, 1, 2], [0, 2, 3]]))
    return clean_geometry(VertexAttributes(np.indices((2, 2, 2)).reshape(3, 8).T * 2.0 - 1.0), BOX_TRIANGLES)


def _sphere(rows: int, cols: int) -> Geometry:
    """A sphere of radius 1 in rings. At 48 x 96 its facets span 3.75 degrees and lie within 1 mm of a sphere of 1 m."""
    theta, phi = np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, cols, endpoint=False)
    ring = np.stack([np.cos(phi), np.sin(phi)], axis=-1)
    inner = theta[1:-1, None, None]
    body = np.concatenate([np.sin(inner) * ring, np.broadcast_to(np.cos(inner), (rows - 1, cols, 1))], axis=-1)
    positions = np.concatenate([[[0, 0, 1]], body.reshape(-1, 3), [[0, 0, -1]]])
    j, k = np.arange(cols), (np.arange(cols) + 1) % cols
    last = len(positions) - 1
    faces = [np.stack([np.zeros_like(j), 1 + j, 1 + k], axis=-1)]
    for i in range(rows - 2):
        a, b, c, d = 1 + i * cols + j, 1 + i * cols + k, 1 + (i + 1) * cols + j, 1 + (i + 1) * cols + k
        faces += [np.stack([a, c, b], axis=-1), np.stack([b, c, d], axis=-1)]
    faces.append(np.stack([1 + (rows - 2) * cols + j, np.full_like(j, last), 1 + (rows - 2) * cols + k], axis=-1))
    return clean_geometry(VertexAttributes(positions, positions), np.concatenate(faces))


def clean_geometry(vertices: VertexAttributes, triangles: np.ndarray) -> Geometry:
    """Geometry of vertices and triangles (m, 3), without those of no area.

    Normals are replaced by our own where one of them is missing or has no length. Raises ValueError that says what is wrong: nan or inf
    vertices, indices out of range; NothingToDraw for no triangles, no size and no area.
    """
    positions, normals, uvs, colours, second_uvs = vertices
    if len(triangles) == 0 or len(positions) == 0:
        raise NothingToDraw("is empty")
    if triangles.min() < 0 or triangles.max() >= len(positions):
        raise ValueError("has triangles with vertices that it does not have")
    used = np.unique(triangles)
    if not np.all(np.isfinite(positions[used])):
        raise ValueError("has vertices that are nan or inf")
    size = np.ptp(positions[used], axis=0).max()
    if size <= 0:
        raise NothingToDraw("has no size")
    if not size < MAX_SIZE_M:
        raise ValueError(f"is larger than {MAX_SIZE_M:.0e} m")
    corners = positions[triangles].astype(np.float64)
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(facing, axis=-1)
    good = area > MIN_RELATIVE_AREA * size**2
    if not good.any():
        raise NothingToDraw("has no area")
    triangles, facing = triangles[good], facing[good] / area[good, None]
    welded = _welded(positions, triangles)
    if normals is None or normals.shape != positions.shape or not np.all(np.linalg.norm(normals[used], axis=-1) > MIN_NORMAL):
        seams = any(rows is not None for rows in (uvs, colours, second_uvs))
        vertex, triangles, normals = _smoothed(positions, triangles, welded, facing, seams)
        uvs, colours, second_uvs = (None if rows is None else rows[vertex] for rows in (uvs, colours, second_uvs))
        positions = positions[vertex]
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = np.divide(normals, length, out=np.tile([0.0, 0.0, 1.0], (len(normals), 1)), where=length > MIN_NORMAL)
    return Geometry(
        np.ascontiguousarray(positions, np.float32),
        np.ascontiguousarray(normals, np.float32),
        np.zeros((len(positions), 2), np.float32) if uvs is None else np.ascontiguousarray(uvs, np.float32),
        np.ascontiguousarray(triangles, np.uint32),
        is_closed(welded, corners[good]),
        colours,
        second_uvs,
    )


def _welded(positions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The triangles (m, 3) with vertices at equal float32 positions merged: files split them at seams of texture or normal."""
    places = np.ascontiguousarray(positions, np.float32) + np.float32(0)  # -0 becomes 0
    return np.unique(places, axis=0, return_inverse=True)[1].reshape(-1)[triangles]


def is_closed(welded: np.ndarray, corners: np.ndarray) -> bool:
    """Whether each edge of welded triangles (m, 3) is used once in either direction and each connected part has positive volume.

    corners: the positions of their vertices, (m, 3, 3) float64.
    """
    edges = np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]]).astype(np.int64)
    n = int(welded.max()) + 1
    forward, backward = np.sort(edges[:, 0] * n + edges[:, 1]), np.sort(edges[:, 1] * n + edges[:, 0])
    if not np.array_equal(forward, backward) or np.any(forward[1:] == forward[:-1]):
        return False
    part = _connected(edges[:, 0], edges[:, 1], n)[1][welded[:, 0]]
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return bool(np.all(np.bincount(part, volumes)[np.unique(part)] > 0))


def _connected(left: np.ndarray, right: np.ndarray, count: int) -> tuple[int, np.ndarray]:
    """How many connected parts `count` nodes with links between `left` and `right` have, and the part of each node."""
    part = np.arange(count)  # the lowest node that each is known to be connected with
    while len(left):
        a, b = part[left], part[right]
        np.minimum.at(part, np.maximum(a, b), np.minimum(a, b))
        while not np.array_equal(part, lower := part[part]):
            part = lower
        apart = part[left] != part[right]
        left, right = left[apart], right[apart]
    first, part = np.unique(part, return_inverse=True)
    return len(first), part


def _smoothed(
    positions: np.ndarray, triangles: np.ndarray, welded: np.ndarray, facing: np.ndarray, seams: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices with smooth normals, one for each group of corners that smooth edges join: old vertex numbers (n,), triangles, normals.

    A smooth edge joins exactly two faces whose normals differ by less than CREASE_RAD. A group's normal is the mean of its faces' normals,
    weighted with the corners' angles (Thuermer and Wuethrich 1998). seams: corners of one group that were different vertices, having other
    texture coordinates or colours, stay so.
    """
    count = len(triangles)
    edges = np.sort(np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]]), axis=-1).astype(np.int64)
    key = edges[:, 0] * (welded.max() + 1) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    key = key[order]
    starts = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    pairs = starts[np.diff(np.append(starts, len(key))) == 2]
    first, second = order[pairs], order[pairs + 1]  # half-edge h is side h // count of triangle h % count
    smooth = np.einsum("ij,ij->i", facing[first % count], facing[second % count]) > np.cos(CREASE_RAD)
    first, second = first[smooth], second[smooth]

    # Corner k of triangle t has number 3 t + k. A half-edge of side s runs from corner s to corner s + 1, its twin the other way.
    def corner(half_edge: np.ndarray, end: int) -> np.ndarray:
        return 3 * (half_edge % count) + (half_edge // count + end) % 3

    flipped = (welded.reshape(-1)[corner(first, 0)] == welded.reshape(-1)[corner(second, 0)]).astype(int)  # twins wound alike
    a, b = corner(second, 0), corner(second, 1)
    left = np.concatenate([corner(first, 0), corner(first, 1)])
    right = np.concatenate([np.where(flipped, a, b), np.where(flipped, b, a)])
    groups, group = _connected(left, right, 3 * count)
    points = positions[triangles].astype(np.float64)
    angles = np.stack([_corner_angle(points[:, k], points[:, (k + 1) % 3], points[:, (k + 2) % 3]) for k in range(3)], axis=-1)
    weighted = (facing[:, None, :] * angles[..., None]).reshape(-1, 3)
    normals = np.stack([np.bincount(group, weighted[:, axis], groups) for axis in range(3)], axis=-1)
    old = triangles.reshape(-1).astype(np.int64)
    key = group.astype(np.int64) * len(positions) + old if seams else group.astype(np.int64)
    _, first, vertex = np.unique(key, return_index=True, return_inverse=True)
    return old[first], vertex.reshape(-1, 3), normals[group[first]]


def _corner_angle(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Angle in rad at points a (m, 3) between the directions to b and to c."""
    u, v = b - a, c - a
    return np.arctan2(np.linalg.norm(np.cross(u, v), axis=-1), np.einsum("ij,ij->i", u, v))
