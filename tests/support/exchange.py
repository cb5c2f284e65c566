"""Reads back what other programs are given, by the formulas of their formats."""

import numpy as np


def turned(rotations: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A vector (3,) or (1, 3) turned by unit quaternions (n, 4) x, y, z, w: v + 2 q x (q x v + w v)."""
    axis, w = rotations[:, :3], rotations[:, 3:]
    return vector + 2 * np.cross(axis, np.cross(axis, vector) + w * vector)
