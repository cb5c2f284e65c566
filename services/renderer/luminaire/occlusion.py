"""Whether a segment meets a triangle: a hierarchy of boxes, traversed in compiled code, to judge shadow maps by."""

from typing import NamedTuple

import numpy as np
from numba import njit

LEAF = 4  # triangles of a leaf
STACK = 64  # boxes that wait; halving 2^32 triangles needs 32


class Hierarchy(NamedTuple):
    """corners: (n, 3, 3) float64 in the order of the leaves. boxes: (m, 6) low and high. nodes: (m, 2) int32: first triangle and count of a
    leaf, or the second child and 0 (the first child follows its parent). No triangles: m = 0."""

    corners: np.ndarray
    boxes: np.ndarray
    nodes: np.ndarray


def hierarchy_of(corners: np.ndarray) -> Hierarchy:
    """The hierarchy over triangles (n, 3, 3): halves of equal count along the longest side of the centres' box."""
    corners = np.ascontiguousarray(corners, np.float64)
    centres = corners.mean(axis=1)
    order, boxes, nodes = np.arange(len(corners)), [], []

    def add(first: int, last: int) -> None:
        part = order[first:last]
        boxes.append([*corners[part].min(axis=(0, 1)), *corners[part].max(axis=(0, 1))])
        me = len(nodes)
        nodes.append([first, last - first])
        if last - first > LEAF:
            axis = int(np.argmax(np.ptp(centres[part], axis=0)))
            middle = (first + last) // 2
            order[first:last] = part[np.argpartition(centres[part, axis], middle - first)]
            add(first, middle)
            nodes[me] = [len(nodes), 0]
            add(middle, last)

    if len(corners):
        add(0, len(corners))
    return Hierarchy(corners[order], np.array(boxes, np.float64).reshape(-1, 6), np.array(nodes, np.int32).reshape(-1, 2))


@njit(cache=True)
def blocked(scene, ox, oy, oz, dx, dy, dz, near, far):
    """True when a triangle lies between parameters near and far of the ray o + t d."""
    if len(scene.nodes) == 0:
        return False
    ix, iy, iz = 1 / dx if dx != 0 else 1e300, 1 / dy if dy != 0 else 1e300, 1 / dz if dz != 0 else 1e300
    stack = np.empty(STACK, np.int32)
    stack[0], waiting = 0, 1
    while waiting:
        waiting -= 1
        k = stack[waiting]
        box = scene.boxes[k]
        t0, t1 = near, far
        a, b = (box[0] - ox) * ix, (box[3] - ox) * ix
        t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        a, b = (box[1] - oy) * iy, (box[4] - oy) * iy
        t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        a, b = (box[2] - oz) * iz, (box[5] - oz) * iz
        t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        if t0 > t1 * (1 + 1e-12) + 1e-12:
            continue
        if scene.nodes[k, 1] == 0:
            stack[waiting], stack[waiting + 1] = scene.nodes[k, 0], k + 1
            waiting += 2
            continue
        for n in range(scene.nodes[k, 0], scene.nodes[k, 0] + scene.nodes[k, 1]):
            c = scene.corners[n]
            # Moeller and Trumbore 1997
            e1x, e1y, e1z = c[1, 0] - c[0, 0], c[1, 1] - c[0, 1], c[1, 2] - c[0, 2]
            e2x, e2y, e2z = c[2, 0] - c[0, 0], c[2, 1] - c[0, 1], c[2, 2] - c[0, 2]
            px, py, pz = dy * e2z - dz * e2y, dz * e2x - dx * e2z, dx * e2y - dy * e2x
            det = e1x * px + e1y * py + e1z * pz
            if det == 0:
                continue
            sx, sy, sz = ox - c[0, 0], oy - c[0, 1], oz - c[0, 2]
            u = (sx * px + sy * py + sz * pz) / det
            if u < 0 or u > 1:
                continue
            qx, qy, qz = sy * e1z - sz * e1y, sz * e1x - sx * e1z, sx * e1y - sy * e1x
            v = (dx * qx + dy * qy + dz * qz) / det
            if v < 0 or u + v > 1:
                continue
            t = (e2x * qx + e2y * qy + e2z * qz) / det
            if near < t < far:
                return True
    return False
