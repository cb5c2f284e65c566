"""A bounding volume hierarchy of triangles, for the traced shadows that shadow maps are compared with."""

from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine

MAX_LEAF_TRIANGLES = 4  # any value in 1..16 does: it changes speed alone
STACK_DEPTH = 64  # boxes still to be visited; halving 2^32 triangles needs 32


class TriangleHierarchy(NamedTuple):
    """corners: (n, 3, 3) float64 in the order of the leaves. boxes: (m, 6) float64, low and high corner. No triangles: m = 0.

    nodes: (m, 2) int32: a leaf's first triangle and its count, or an inner node's second child and 0 (the first child follows its parent).
    """

    corners: np.ndarray
    boxes: np.ndarray
    nodes: np.ndarray


class Ray(NamedTuple):
    """Origin and direction in the frame of the triangles; the direction may have any length."""

    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float


def hierarchy_from_triangles(corners: np.ndarray) -> TriangleHierarchy:
    """The hierarchy over triangles (n, 3, 3): split into halves of equal count along the longest side of their centres' box."""
    corners = np.ascontiguousarray(corners, np.float64)
    centres = corners.mean(axis=1)
    order, boxes, nodes = np.arange(len(corners)), [], []

    def add(first: int, last: int) -> None:
        members = order[first:last]
        boxes.append([*corners[members].min(axis=(0, 1)), *corners[members].max(axis=(0, 1))])
        node = len(nodes)
        nodes.append([first, last - first])
        if last - first > MAX_LEAF_TRIANGLES:
            axis = int(np.argmax(np.ptp(centres[members], axis=0)))
            middle = (first + last) // 2
            order[first:last] = members[np.argpartition(centres[members, axis], middle - first)]
            add(first, middle)
            nodes[node] = [len(nodes), 0]
            add(middle, last)

    if len(corners):
        add(0, len(corners))
    return TriangleHierarchy(corners[order], np.array(boxes, np.float64).reshape(-1, 6), np.array(nodes, np.int32).reshape(-1, 2))


@kernel
def occluded(hierarchy, ray, near, far):
    """True when a triangle lies between the parameters near and far of a `Ray`."""
    if len(hierarchy.nodes) == 0:
        return False
    ix, iy, iz = 1 / ray.dx if ray.dx != 0 else 1e300, 1 / ray.dy if ray.dy != 0 else 1e300, 1 / ray.dz if ray.dz != 0 else 1e300
    stack = np.empty(STACK_DEPTH, np.int32)
    stack[0], size = 0, 1
    while size:
        size -= 1
        k = stack[size]
        # the part of the ray inside the node's three slabs
        box = hierarchy.boxes[k]
        t0, t1 = near, far
        a, b = (box[0] - ray.x) * ix, (box[3] - ray.x) * ix
        t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        a, b = (box[1] - ray.y) * iy, (box[4] - ray.y) * iy
        t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        a, b = (box[2] - ray.z) * iz, (box[5] - ray.z) * iz
        t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        if t0 > t1 * (1 + 1e-12) + 1e-12:
            continue
        first, count = hierarchy.nodes[k, 0], hierarchy.nodes[k, 1]
        if count == 0:
            stack[size], stack[size + 1] = first, k + 1
            size += 2
            continue
        for n in range(first, first + count):
            if near < triangle_distance(hierarchy.corners[n], ray) < far:
                return True
    return False


@subroutine
def triangle_distance(c, ray):
    """The ray's parameter where it meets the triangle with corners c (3, 3), inf where it misses (Moeller and Trumbore 1997)."""
    e1x, e1y, e1z = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
    e2x, e2y, e2z = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
    px, py, pz = ray.dy * e2z - ray.dz * e2y, ray.dz * e2x - ray.dx * e2z, ray.dx * e2y - ray.dy * e2x
    det = e1x * px + e1y * py + e1z * pz
    if det == 0:
        return np.inf
    sx, sy, sz = ray.x - c[0, 0], ray.y - c[0, 1], ray.z - c[0, 2]
    u = (sx * px + sy * py + sz * pz) / det
    if u < 0 or u > 1:
        return np.inf
    qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
    v = (ray.dx * qx + ray.dy * qy + ray.dz * qz) / det
    if v < 0 or u + v > 1:
        return np.inf
    return (e2x * qx + e2y * qy + e2z * qz) / det
