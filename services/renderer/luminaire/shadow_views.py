"""Where a luminaire's shadow maps are drawn from: one reference position for each cell of the sampling plane (Lu et al. 2015, section 6.2).

A basis function covers n x n cells, n = 2 (bell) or 3 (b-spline), and W x H functions cover (W + n - 1)(H + n - 1) cells. 2015 draws a
cell's map from the mean, over the functions that cover it, of the median of their images on the measurement plane; 2003 draws from the
sampling plane, which is the default here because it errs less against traced rays (bench/luminaires.py).
"""

from typing import Literal, NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.colour import LUMINANCE_BLUE, LUMINANCE_GREEN, LUMINANCE_RED
from vemlight.renderer.gl.buffers import SHADOW_VIEW
from vemlight.renderer.gl.constants import CUBE_TANGENT
from vemlight.renderer.luminaire.bases import SUPPORT_CELLS
from vemlight.renderer.luminaire.lightfield import LightField

ReferencePlane = Literal["sampling", "measurement"]
MAX_TANGENT = 20.0  # of 87 degrees: a perspective map shadows nothing at flatter angles


class ShadowViews(NamedTuple):
    """views: (n,) SHADOW_VIEW. near_m, far_m: clipping distances of all of them."""

    views: np.ndarray
    near_m: float
    far_m: float


def cell_views(field: LightField, near_m: float, far_m: float, reference: ReferencePlane = "sampling") -> ShadowViews:
    """A view from each cell, rows of cells along v, towards +z, wide enough for every ray between the cell and the window."""
    n, h = SUPPORT_CELLS[field.basis_kind], field.spacing_m
    rows, cols = (count + n - 1 for count in field.images.shape[:2])
    low = np.array([field.first_m[axis] - n * h / 2 for axis in (0, 1)])
    j, i = np.indices((rows, cols)).reshape(2, -1)
    corner = low + h * np.stack([i, j], axis=-1)
    views = np.zeros(len(corner), SHADOW_VIEW.dtype)
    window = np.array(field.window_m).reshape(2, 2)
    if reference == "sampling":
        views["origin"][:, :2] = corner + h / 2
    else:
        views["origin"] = np.insert(_median_positions(field, rows, cols), 2, field.distance_m, axis=1)
    views["low"] = np.maximum((window[0] - corner - h) / field.distance_m, -MAX_TANGENT)
    views["high"] = np.minimum((window[1] - corner) / field.distance_m, MAX_TANGENT)
    return ShadowViews(views, near_m, far_m)


def _median_positions(field: LightField, rows: int, cols: int) -> np.ndarray:
    """Mean of the medians of the images that light each cell, (rows * cols, 2) on S; the window's middle for a cell without light."""
    n = SUPPORT_CELLS[field.basis_kind]
    sums, count = np.zeros((rows, cols, 2)), np.zeros((rows, cols, 1))
    for j, i in np.ndindex(field.images.shape[:2]):
        s, t, lit = median_pixel(field.images[j, i])
        if lit:
            sums[j : j + n, i : i + n] += np.array(field.window_m[:2]) + np.array([s, t]) * field.pixel_m
            count[j : j + n, i : i + n] += 1
    middle = np.array(field.window_m).reshape(2, 2).mean(axis=0)
    return np.where(count > 0, sums / np.maximum(count, 1), middle).reshape(-1, 2)


@kernel
def median_pixel(image):
    """(s, t, lit) in pixels: the median of an image (height, width, 3) along s, and along t in that column; lit is False where all is dark.

    Pixels count by the luminance of their channels' magnitudes.
    """
    height, width = image.shape[:2]
    columns, rows = np.zeros(width), np.zeros(height)
    for y in range(height):
        for x in range(width):
            columns[x] += _importance(image[y, x])
    s = median(columns)
    for y in range(height):
        rows[y] = _importance(image[y, min(int(s), width - 1)])
    return s, median(rows), columns.sum() > 0


@subroutine
def _importance(pixel):
    return LUMINANCE_RED * abs(pixel[0]) + LUMINANCE_GREEN * abs(pixel[1]) + LUMINANCE_BLUE * abs(pixel[2])


@kernel
def median(weights):
    """The position in [0, n] below which half the weight of n unit intervals lies."""
    rest, k = weights.sum() / 2, 0
    while k < len(weights) - 1 and rest >= weights[k]:
        rest -= weights[k]
        k += 1
    return k + (min(rest / weights[k], 1.0) if weights[k] > 0 else 0.0)


def cube_views(near_m: float, far_m: float) -> ShadowViews:
    """Six views from the luminaire's origin, one through each face of a cube."""
    views = np.zeros(6, SHADOW_VIEW.dtype)
    views["face"], views["low"], views["high"] = np.arange(6), -CUBE_TANGENT, CUBE_TANGENT
    return ShadowViews(views, near_m, far_m)
