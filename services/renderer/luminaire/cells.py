"""Where a luminaire's shadow maps are drawn from: one reference position a cell of the sampling plane (Lu et al. 2015, section 6.2).

A basis function covers n x n cells, n = 2 (bell) or 3 (b-spline), and W x H functions (W + n - 1)(H + n - 1) cells. 2015 draws a cell's
map from the mean, over the functions that cover it, of the brightest region's middle on the measurement plane; 2003 draws from the sampling
plane, and so do we by default: against traced rays that errs less (bench/luminaires.py).
"""

from typing import Literal, NamedTuple

import numpy as np
from numba import njit

from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.renderer.luminaire.bases import SUPPORT_CELLS
from vemlight.renderer.luminaire.lightfield import LightField

Reference = Literal["sampling", "measurement"]
NEAR = 1e-3  # of the farthest caster: 1 / z in 24 bits is then exact to 6e-5 of the distance
WIDEST = 20.0  # tangent of 87 degrees: what is flatter than that is not shadowed by a perspective map


class MapViews(NamedTuple):
    """rows: (n, 8) float32: reference position in the luminaire's frame and cube face, window of tangents (low x, y, high x, y)."""

    rows: np.ndarray
    near_m: float
    far_m: float


def cell_views(field: LightField, far_m: float, reference: Reference = "sampling") -> MapViews:
    """A view from each cell, rows of cells along v, towards +z, wide enough for every ray between the cell and the window."""
    n, h = SUPPORT_CELLS[field.kind], field.spacing_m
    rows, cols = (count + n - 1 for count in field.images.shape[:2])
    low = np.array([field.first_m[axis] - n * h / 2 for axis in (0, 1)])
    j, i = np.indices((rows, cols)).reshape(2, -1)
    corner = low + h * np.stack([i, j], axis=-1)
    views = np.zeros((len(corner), 8), np.float32)
    window = np.array(field.window_m).reshape(2, 2)
    if reference == "sampling":
        views[:, :2] = corner + h / 2
    else:
        views[:, :2], views[:, 2] = _brightest_of_cells(field, rows, cols), field.distance_m
    views[:, 4:6] = np.maximum((window[0] - corner - h) / field.distance_m, -WIDEST)
    views[:, 6:8] = np.minimum((window[1] - corner) / field.distance_m, WIDEST)
    return MapViews(views, NEAR * far_m, far_m)


def _brightest_of_cells(field: LightField, rows: int, cols: int) -> np.ndarray:
    """Mean of the medians of the images that light each cell, (rows * cols, 2) on S; the window's middle for a cell without light."""
    n = SUPPORT_CELLS[field.kind]
    sums, count = np.zeros((rows, cols, 2)), np.zeros((rows, cols, 1))
    for j, i in np.ndindex(field.images.shape[:2]):
        s, t, lit = median_pixel(field.images[j, i], LUMINANCE_WEIGHTS)
        if lit:
            sums[j : j + n, i : i + n] += np.array(field.window_m[:2]) + np.array([s, t]) * field.pixel_m
            count[j : j + n, i : i + n] += 1
    middle = np.array(field.window_m).reshape(2, 2).mean(axis=0)
    return np.where(count > 0, sums / np.maximum(count, 1), middle).reshape(-1, 2)


@njit(cache=True)
def median_pixel(image, weights):
    """(s, t, lit) in pixels: where the marginal along s of an image (height, width, 3) and, in that column, the conditional along t reach
    one half; lit is False where all is dark. Weighed by the magnitudes of the channels."""
    height, width = image.shape[:2]
    columns, rows = np.zeros(width), np.zeros(height)
    red, green, blue = weights[0], weights[1], weights[2]
    for y in range(height):
        for x in range(width):
            columns[x] += red * abs(image[y, x, 0]) + green * abs(image[y, x, 1]) + blue * abs(image[y, x, 2])
    s = half_way(columns)
    for y in range(height):
        for c in range(3):
            rows[y] += weights[c] * abs(image[y, min(int(s), width - 1), c])
    return s, half_way(rows), columns.sum() > 0


@njit(cache=True)
def half_way(weights):
    """Where half the weight of unit intervals lies below, as a position in [0, n]."""
    rest, k = weights.sum() / 2, 0
    while k < len(weights) - 1 and rest >= weights[k]:
        rest -= weights[k]
        k += 1
    return k + (min(rest / weights[k], 1.0) if weights[k] > 0 else 0.0)


def cube_views(far_m: float) -> MapViews:
    """Six views from the luminaire's origin, one for each face of a cube, a little wider so that lookups filter across edges."""
    views = np.zeros((6, 8), np.float32)
    views[:, 3], views[:, 4:6], views[:, 6:8] = np.arange(6), -1.05, 1.05
    return MapViews(views, NEAR * far_m, far_m)
