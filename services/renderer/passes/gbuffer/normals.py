"""Unit vectors as two numbers: the functions of normals.glsl.

The octahedron map (Meyer et al. 2010, On Floating-Point Normal Vectors) folds the sphere onto a square, whose coordinates are stored in 16
bits each: 3e-5 rad from code to code.
"""

import numpy as np

from vemlight.renderer.gl.constants import NORMAL_CODES


def octahedron_from_direction(d: np.ndarray) -> np.ndarray:
    """Coordinates (..., 2) in [-1, 1] of unit vectors (..., 3)."""
    p = d[..., :2] / np.abs(d).sum(axis=-1, keepdims=True)
    folded = (1 - np.abs(p[..., ::-1])) * np.where(p >= 0, 1.0, -1.0)
    return np.where(d[..., 2:] >= 0, p, folded)


def direction_from_octahedron(p: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) of coordinates (..., 2) in [-1, 1]."""
    z = 1 - np.abs(p).sum(axis=-1, keepdims=True)
    xy = p - np.copysign(np.maximum(-z, 0), p)
    d = np.concatenate([xy, z], axis=-1)
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def octahedron_from_code(code: np.ndarray) -> np.ndarray:
    """Coordinates of what a texture of 16 bits a number holds, 0 to 1, such that 0 is exactly a code."""
    return (np.rint(code * np.float32(2 * NORMAL_CODES + 1)) - (NORMAL_CODES + 1)) / NORMAL_CODES
