"""Summed-area tables of a light field's images, and sampling an image inside the box that a point sees (Lu et al. 2015, sections 3 and 4).

A box is given in pixels of one image, x along s and y along t, clipped to it. The marginal along s is the marginal of the box, two
differences of the table, and not the whole image's cut to the box as equation 8 prints it: that one has another density than equation 10
unless the image is a product. A box within two columns and rows is sampled from its pixels, so that it may be as small as a point.

Tables are float64: under a pixel 10^5 times the mean a float32 table is off by 3 % in a box of one pixel. Importance is the luminance of
the channels' magnitudes, so that negative pixels, which the filter's lobes and noise make, are sampled as well and come with their sign.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import njit

from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.renderer.luminaire.bases import SUPPORT_CELLS
from vemlight.renderer.luminaire.lightfield import LightField


class Tables(NamedTuple):
    """sums: (n, height + 1, width + 1) float64, importance of all pixels below and left. pixels: (n, height, width, 3) float32 irradiance.

    importance: (n, height, width) float64. supports: (n, 4) float64 u_min, v_min, u_max, v_max. window: s_min, t_min and the pixel's size.
    cells: the support's width in spacings, 2 (bell) or 3 (b-spline), which names the basis to compiled code.
    """

    sums: np.ndarray
    pixels: np.ndarray
    importance: np.ndarray
    supports: np.ndarray
    window: np.ndarray
    distance: float
    spacing: float
    cells: int


def tables_of(field: LightField) -> Tables:
    """The tables of a light field; images in order of rows, then columns of basis functions."""
    rows, cols, height, width, _ = field.images.shape
    pixels = np.ascontiguousarray(field.images.reshape(rows * cols, height, width, 3), np.float32)
    importance, sums = np.empty((rows * cols, height, width)), np.zeros((rows * cols, height + 1, width + 1))
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # the compiled loop leaves Python's lock
        list(threads.map(lambda m: _sum(pixels[m], LUMINANCE_WEIGHTS, importance[m], sums[m]), range(rows * cols)))
    u, v = np.meshgrid(*field.centres_m)
    centres, half = np.stack([u.ravel(), v.ravel()], axis=-1), field.half_support_m
    supports = np.concatenate([centres - half, centres + half], axis=-1)
    window = np.array([*field.window_m[:2], *field.pixel_m])
    return Tables(sums, pixels, importance, supports, window, float(field.distance_m), float(field.spacing_m), SUPPORT_CELLS[field.kind])


@njit(cache=True, nogil=True)
def _sum(pixels, weights, importance, sums):
    """Fills an image's importance and its summed-area table in one pass over the pixels."""
    red, green, blue = weights[0], weights[1], weights[2]
    for j in range(importance.shape[0]):
        row = 0.0
        for i in range(importance.shape[1]):
            q = red * abs(pixels[j, i, 0]) + green * abs(pixels[j, i, 1]) + blue * abs(pixels[j, i, 2])
            importance[j, i] = q
            row += q
            sums[j + 1, i + 1] = sums[j, i + 1] + row


@njit(cache=True)
def axis_box(low, high, p, ratio, origin, pixel, count):
    """Along one axis: (x0, x1, u0, u1) of the part of support [low, high] that point p sees inside the image of `count` pixels.

    ratio = distance / z_p; equation 7 with its missing term: s = u + ratio (p - u). x0 <= x1 in pixels, u0 and u1 at them; between the
    planes the image is mirrored and u1 < u0. x1 < x0 when the image is missed.
    """
    a, b = (low + ratio * (p - low) - origin) / pixel, (high + ratio * (p - high) - origin) / pixel
    if b < a:
        a, b, low, high = b, a, high, low
    if b < 0 or a >= count or (b <= 0 and a < 0):
        return 1.0, 0.0, low, high
    x0, x1 = max(a, 0.0), min(b, float(count))
    if b > a:
        return x0, x1, low + (high - low) * ((x0 - a) / (b - a)), low + (high - low) * ((x1 - a) / (b - a))
    return x0, x1, low, high


@njit(cache=True)
def table_at(sums, y, x):
    """Importance below y and left of x, bilinear: exact for pixels that are even inside."""
    j, i = min(int(y), sums.shape[0] - 2), min(int(x), sums.shape[1] - 2)
    g, f = y - j, x - i
    return (1 - g) * ((1 - f) * sums[j, i] + f * sums[j, i + 1]) + g * ((1 - f) * sums[j + 1, i] + f * sums[j + 1, i + 1])


@njit(cache=True)
def pair(x0, x1, count):
    """(first, last, share): the columns at the ends of [x0, x1] and, for two neighbours, how much of it lies in the first."""
    first, last = min(int(x0), count - 1), min(int(x1), count - 1)
    return first, last, (first + 1 - x0) / (x1 - x0) if last > first else 1.0


@njit(cache=True)
def mean_importance(sums, importance, x0, x1, y0, y1):
    """Mean importance over the box."""
    height, width = importance.shape
    i0, i1, f = pair(x0, x1, width)
    j0, j1, g = pair(y0, y1, height)
    if i1 - i0 <= 1 and j1 - j0 <= 1:
        low, high = f * importance[j0, i0] + (1 - f) * importance[j0, i1], f * importance[j1, i0] + (1 - f) * importance[j1, i1]
        return g * low + (1 - g) * high
    if x1 <= x0 or y1 <= y0:
        return 0.0
    total = table_at(sums, y1, x1) - table_at(sums, y0, x1) - (table_at(sums, y1, x0) - table_at(sums, y0, x0))
    return max(total, 0.0) / ((x1 - x0) * (y1 - y0))


@njit(cache=True)
def sample_box(sums, importance, x0, x1, y0, y1, a, b):
    """(x share, y share, row, column) of the point of the box that uniform numbers a and b choose with density ~ importance.

    Shares run from 0 to 1 across the box, so that a box without extent has them too.
    """
    height, width = importance.shape
    i0, i1, f = pair(x0, x1, width)
    j0, j1, g = pair(y0, y1, height)
    if i1 - i0 <= 1 and j1 - j0 <= 1:
        left = f * (g * importance[j0, i0] + (1 - g) * importance[j1, i0])
        right = (1 - f) * (g * importance[j0, i1] + (1 - g) * importance[j1, i1])
        target = a * (left + right)
        if target < left or right <= 0:
            i, x = i0, f * target / left
        else:
            i, x = i1, f + (1 - f) * min((target - left) / right, 1.0)
        low, high = g * importance[j0, i], (1 - g) * importance[j1, i]
        target = b * (low + high)
        if target < low or high <= 0:
            return x, g * target / low, j0, i
        return x, g + (1 - g) * min((target - low) / high, 1.0), j1, i
    # the marginal of the box at whole columns is four sums; the search keeps those at its ends
    r0, r1 = min(int(y0), height - 1), min(int(y1), height - 1)
    g0, g1 = y0 - r0, y1 - r1
    at_left, at_right = table_at(sums, y1, x0) - table_at(sums, y0, x0), table_at(sums, y1, x1) - table_at(sums, y0, x1)
    target = at_left + a * (at_right - at_left)
    i, end = i0, i1 + 1
    while end - i > 1:
        middle = (i + end) // 2
        here = (1 - g1) * sums[r1, middle] + g1 * sums[r1 + 1, middle] - (1 - g0) * sums[r0, middle] - g0 * sums[r0 + 1, middle]
        if here <= target:
            i, at_left = middle, here
        else:
            end, at_right = middle, here
    left, right = max(float(i), x0), min(float(i + 1), x1)
    x = left + (right - left) * (min(max((target - at_left) / (at_right - at_left), 0.0), 1.0) if at_right > at_left else 0.5)
    below, above = column_at(sums, i, y0), column_at(sums, i, y1)
    target = below + b * (above - below)
    j, end = j0, j1 + 1
    while end - j > 1:
        middle = (j + end) // 2
        here = sums[middle, i + 1] - sums[middle, i]
        if here <= target:
            j, below = middle, here
        else:
            end, above = middle, here
    bottom, top = max(float(j), y0), min(float(j + 1), y1)
    y = bottom + (top - bottom) * (min(max((target - below) / (above - below), 0.0), 1.0) if above > below else 0.5)
    return (x - x0) / (x1 - x0), (y - y0) / (y1 - y0), j, i


@njit(cache=True)
def column_at(sums, i, y):
    """Importance of column i below y."""
    j = min(int(y), sums.shape[0] - 2)
    return (1 - (y - j)) * (sums[j, i + 1] - sums[j, i]) + (y - j) * (sums[j + 1, i + 1] - sums[j + 1, i])


@njit(cache=True)
def box_density(sums, importance, x0, x1, y0, y1, row, column):
    """Density of `sample_box` in shares of the box at a pixel: its importance over the box's mean."""
    mean = mean_importance(sums, importance, x0, x1, y0, y1)
    return importance[row, column] / mean if mean > 0 else 0.0


@njit(cache=True)
def invert_box(sums, x0, x1, y0, y1, x, y):
    """The uniform numbers (a, b) that make `sample_box` choose the shares x and y of a box with extent."""
    x, y = x0 + x * (x1 - x0), y0 + y * (y1 - y0)
    base = table_at(sums, y1, x0) - table_at(sums, y0, x0)
    a = (table_at(sums, y1, x) - table_at(sums, y0, x) - base) / (table_at(sums, y1, x1) - table_at(sums, y0, x1) - base)
    i = min(int(x), sums.shape[1] - 2)
    base = column_at(sums, i, y0)
    return a, (column_at(sums, i, y) - base) / (column_at(sums, i, y1) - base)


def box_on_measurement_plane(field: LightField, centre: np.ndarray, point: np.ndarray) -> tuple[float, float, float, float]:
    """(x0, x1, y0, y1) in pixels of the support round `centre` (2,) as `point` (3,) sees it on S, not clipped, x0 <= x1, y0 <= y1."""
    ends = []
    for axis in (0, 1):
        edge = centre[axis] + np.array([-1, 1]) * field.half_support_m
        s = edge + field.distance_m / point[2] * (point[axis] - edge)
        ends += sorted(((s - field.window_m[axis]) / field.pixel_m[axis]).tolist())
    return ends[0], ends[1], ends[2], ends[3]


def mean_over_box(image: np.ndarray, box: tuple[float, float, float, float]) -> np.ndarray:
    """Mean (3,) of an image (height, width, 3) over a box in pixels, dark outside the image: the plain sum, without tables."""
    weights = []
    for low, high, n in ((box[2], box[3], image.shape[0]), (box[0], box[1], image.shape[1])):
        i = np.arange(n)
        inside = np.clip(np.minimum(high, i + 1) - np.maximum(low, i), 0, None) / (high - low) if high > low else (i == np.floor(low)) * 1.0
        weights.append(inside)
    return np.einsum("y,x,yxc->c", *weights, image.astype(np.float64))
