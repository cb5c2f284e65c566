"""Summed-area tables of a light field's images, and sampling an image inside the box that a point sees (Lu et al. 2015, sections 3 and 4).

A box is given in pixels of one image, x along s and y along t, clipped to it. Its marginal along s comes from two differences of the table.
It is not the whole image's marginal cut to the box, as equation 8 prints it: that has another density than equation 10 unless the image is
a product. A box within two columns and rows is sampled from its pixels, so that it may be as small as a point.

Tables are float64: under a pixel 10^5 times the mean a float32 table is off by 3 % in a box of one pixel. Importance is the luminance of
the channels' magnitudes, so that negative pixels, which the filter's lobes and noise make, are sampled as well and come with their sign.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.colour import LUMINANCE_BLUE, LUMINANCE_GREEN, LUMINANCE_RED
from vemlight.renderer.luminaire.bases import SUPPORT_CELLS
from vemlight.renderer.luminaire.lightfield import LightField


class SummedAreaTables(NamedTuple):
    """A light field as the estimators read it, its n images in order of rows, then columns of basis functions; metres, axes (u, v).

    sums: (n, height + 1, width + 1) float64, importance of all pixels below and left. pixels: (n, height, width, 3) float32 irradiance.
    importance: (n, height, width) float64. support_low, support_high: (n, 2) float64, ends of the supports. window_low, pixel: (2,), corner
    of the window on S and size of a pixel. cells: the support's width in spacings, 2 (bell) or 3 (b-spline), which names the basis.
    """

    sums: np.ndarray
    pixels: np.ndarray
    importance: np.ndarray
    support_low: np.ndarray
    support_high: np.ndarray
    window_low: np.ndarray
    pixel: np.ndarray
    distance: float
    spacing: float
    cells: int


class PixelAxis(NamedTuple):
    """The pixels of an image along one axis: where they begin and a pixel's size, in metres, and their count."""

    origin: float
    size: float
    count: int


class AxisBox(NamedTuple):
    """What a point sees of an image through a support, along one axis: pixels x0 <= x1, and u at them. x1 < x0: it misses the image."""

    x0: float
    x1: float
    u0: float
    u1: float


class PixelPair(NamedTuple):
    """The pixels at the ends of an interval and, for two neighbours, the fraction of the interval that lies in the first."""

    first: int
    last: int
    weight: float


class BoxSample(NamedTuple):
    """A point of a box, x and y from 0 to 1 across it (so that a box without extent has them too), and its pixel."""

    x: float
    y: float
    row: int
    column: int


def summed_area_tables(field: LightField) -> SummedAreaTables:
    """The tables of a light field."""
    rows, cols, height, width, _ = field.images.shape
    pixels = np.ascontiguousarray(field.images.reshape(rows * cols, height, width, 3), np.float32)
    importance, sums = np.empty((rows * cols, height, width)), np.zeros((rows * cols, height + 1, width + 1))
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # the compiled loop releases the GIL
        list(threads.map(lambda m: _sum(pixels[m], importance[m], sums[m]), range(rows * cols)))
    u, v = np.meshgrid(*field.centres_m)
    centres, half = np.stack([u.ravel(), v.ravel()], axis=-1), field.half_support_m
    return SummedAreaTables(sums, pixels, importance, centres - half, centres + half, np.array(field.window_m[:2]), np.array(field.pixel_m),
                            float(field.distance_m), float(field.spacing_m), SUPPORT_CELLS[field.basis_kind])


@kernel(nogil=True)
def _sum(pixels, importance, sums):
    """Fills an image's importance and its summed-area table in one pass over the pixels."""
    for j in range(importance.shape[0]):
        row = 0.0
        for i in range(importance.shape[1]):
            red, green, blue = abs(pixels[j, i, 0]), abs(pixels[j, i, 1]), abs(pixels[j, i, 2])
            q = LUMINANCE_RED * red + LUMINANCE_GREEN * green + LUMINANCE_BLUE * blue
            importance[j, i] = q
            row += q
            sums[j + 1, i + 1] = sums[j, i + 1] + row


@kernel
def axis_box(low, high, p, ratio, pixels):
    """The AxisBox of the support [low, high] that a point at p sees on a PixelAxis; ratio = distance / z_p.

    Equation 7 with its missing term: s = u + ratio (p - u). Between the planes the image is mirrored and u1 < u0.
    """
    a, b = (low + ratio * (p - low) - pixels.origin) / pixels.size, (high + ratio * (p - high) - pixels.origin) / pixels.size
    if b < a:
        a, b, low, high = b, a, high, low
    if b < 0 or a >= pixels.count or (b <= 0 and a < 0):
        return AxisBox(1.0, 0.0, low, high)
    x0, x1 = max(a, 0.0), min(b, float(pixels.count))
    if b > a:
        return AxisBox(x0, x1, low + (high - low) * ((x0 - a) / (b - a)), low + (high - low) * ((x1 - a) / (b - a)))
    return AxisBox(x0, x1, low, high)


@kernel
def table_at(sums, y, x):
    """Importance below y and left of x, bilinear: exact for pixels that are even inside."""
    j, i = min(int(y), sums.shape[0] - 2), min(int(x), sums.shape[1] - 2)
    g, f = y - j, x - i
    return (1 - g) * ((1 - f) * sums[j, i] + f * sums[j, i + 1]) + g * ((1 - f) * sums[j + 1, i] + f * sums[j + 1, i + 1])


@kernel
def column_at(sums, i, y):
    """Importance of column i below y."""
    j = min(int(y), sums.shape[0] - 2)
    return (1 - (y - j)) * (sums[j, i + 1] - sums[j, i]) + (y - j) * (sums[j + 1, i + 1] - sums[j + 1, i])


@subroutine
def pixel_pair(box, count):
    """The PixelPair of an AxisBox in an image of `count` pixels along the axis."""
    first, last = min(int(box.x0), count - 1), min(int(box.x1), count - 1)
    return PixelPair(first, last, (first + 1 - box.x0) / (box.x1 - box.x0) if last > first else 1.0)


@kernel
def mean_importance(sums, importance, u, v):
    """Mean importance over the box of AxisBoxes u (columns) and v (rows)."""
    height, width = importance.shape
    i, j = pixel_pair(u, width), pixel_pair(v, height)
    if i.last - i.first <= 1 and j.last - j.first <= 1:
        low = i.weight * importance[j.first, i.first] + (1 - i.weight) * importance[j.first, i.last]
        high = i.weight * importance[j.last, i.first] + (1 - i.weight) * importance[j.last, i.last]
        return j.weight * low + (1 - j.weight) * high
    if u.x1 <= u.x0 or v.x1 <= v.x0:
        return 0.0
    total = table_at(sums, v.x1, u.x1) - table_at(sums, v.x0, u.x1) - (table_at(sums, v.x1, u.x0) - table_at(sums, v.x0, u.x0))
    return max(total, 0.0) / ((u.x1 - u.x0) * (v.x1 - v.x0))


@kernel
def sample_box(sums, importance, u, v, a, b):
    """The BoxSample that uniform numbers a and b choose, with density in proportion to importance."""
    height, width = importance.shape
    i, j = pixel_pair(u, width), pixel_pair(v, height)
    if i.last - i.first <= 1 and j.last - j.first <= 1:
        return _sample_four_pixels(importance, i, j, a, b)
    column, x = _sample_column(sums, i, u, v, a)
    row, y = _sample_row(sums, j, column, v, b)
    return BoxSample((x - u.x0) / (u.x1 - u.x0), (y - v.x0) / (v.x1 - v.x0), row, column)


@subroutine
def _sample_four_pixels(importance, i, j, a, b):
    """The BoxSample of a box within two columns i and two rows j."""
    left = i.weight * (j.weight * importance[j.first, i.first] + (1 - j.weight) * importance[j.last, i.first])
    right = (1 - i.weight) * (j.weight * importance[j.first, i.last] + (1 - j.weight) * importance[j.last, i.last])
    target = a * (left + right)
    if target < left or right <= 0:
        column, x = i.first, i.weight * target / left
    else:
        column, x = i.last, i.weight + (1 - i.weight) * min((target - left) / right, 1.0)
    low, high = j.weight * importance[j.first, column], (1 - j.weight) * importance[j.last, column]
    target = b * (low + high)
    if target < low or high <= 0:
        return BoxSample(x, j.weight * target / low, j.first, column)
    return BoxSample(x, j.weight + (1 - j.weight) * min((target - low) / high, 1.0), j.last, column)


@subroutine
def _sample_column(sums, i, u, v, a):
    """(column, x): the box's marginal along s, four sums at a whole column, searched for uniform number a."""
    height = sums.shape[0] - 1
    r0, r1 = min(int(v.x0), height - 1), min(int(v.x1), height - 1)
    g0, g1 = v.x0 - r0, v.x1 - r1
    at_left = table_at(sums, v.x1, u.x0) - table_at(sums, v.x0, u.x0)
    at_right = table_at(sums, v.x1, u.x1) - table_at(sums, v.x0, u.x1)
    target = at_left + a * (at_right - at_left)
    column, end = i.first, i.last + 1
    while end - column > 1:
        middle = (column + end) // 2
        marginal = (1 - g1) * sums[r1, middle] + g1 * sums[r1 + 1, middle] - (1 - g0) * sums[r0, middle] - g0 * sums[r0 + 1, middle]
        if marginal <= target:
            column, at_left = middle, marginal
        else:
            end, at_right = middle, marginal
    left, right = max(float(column), u.x0), min(float(column + 1), u.x1)
    fraction = min(max((target - at_left) / (at_right - at_left), 0.0), 1.0) if at_right > at_left else 0.5
    return column, left + (right - left) * fraction


@subroutine
def _sample_row(sums, j, column, v, b):
    """(row, y): the conditional along t in a column, searched for uniform number b."""
    below, above = column_at(sums, column, v.x0), column_at(sums, column, v.x1)
    target = below + b * (above - below)
    row, end = j.first, j.last + 1
    while end - row > 1:
        middle = (row + end) // 2
        conditional = sums[middle, column + 1] - sums[middle, column]
        if conditional <= target:
            row, below = middle, conditional
        else:
            end, above = middle, conditional
    bottom, top = max(float(row), v.x0), min(float(row + 1), v.x1)
    return row, bottom + (top - bottom) * (min(max((target - below) / (above - below), 0.0), 1.0) if above > below else 0.5)
