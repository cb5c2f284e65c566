"""Two ways of sampling a light field that Lu et al. 2015 compare theirs with: evenly over each support, and by one CDF of all images."""

import math

import numpy as np
from numba import njit

from vemlight.renderer.luminaire.estimator import basis_value, image_boxes, image_weight
from vemlight.renderer.luminaire.tables import SummedAreaTables


def uniform(tables: SummedAreaTables, points: np.ndarray, samples: int, numbers: np.ndarray) -> np.ndarray:
    """Irradiance (n, 3) on planes that face the lamp: as many samples for each image, even over the part of U that the point sees.

    numbers: (samples, 2) uniform numbers, used in turns.
    """
    out = np.zeros((len(points), 3))
    _uniform(tables, points, samples, numbers, out)
    return out


@njit(cache=True)
def _uniform(tables, points, samples, numbers, out):
    images = len(tables.sums)
    height, width = tables.importance.shape[1:]
    for n in range(len(points)):
        p = points[n]
        scale = (tables.distance / (p[2] * tables.spacing)) ** 2
        drawn = 0
        for m in range(images):
            count = (m + 1) * samples // images - m * samples // images
            u_box, v_box = image_boxes(tables, m, p)
            if image_weight(tables, m, u_box, v_box) <= 0:
                drawn += count
                continue
            low, high = tables.support_low[m], tables.support_high[m]
            area = abs((u_box.u1 - u_box.u0) * (v_box.u1 - v_box.u0))
            for _ in range(count):
                a, b = numbers[drawn % len(numbers)]
                drawn += 1
                u, v = u_box.u0 + a * (u_box.u1 - u_box.u0), v_box.u0 + b * (v_box.u1 - v_box.u0)
                column, row = int(u_box.x0 + a * (u_box.x1 - u_box.x0)), int(v_box.x0 + b * (v_box.x1 - v_box.x0))
                phi = basis_value(tables.cells, (u - (low[0] + high[0]) / 2) / tables.spacing)
                phi *= basis_value(tables.cells, (v - (low[1] + high[1]) / 2) / tables.spacing)
                # 1 / cos theta of the lamp and cos theta of the receiver cancel
                for c in range(3):
                    out[n, c] += scale * area / count * phi * tables.pixels[m, min(row, height - 1), min(column, width - 1), c]


def precomputed(tables: SummedAreaTables, points: np.ndarray, samples: int, numbers: np.ndarray) -> np.ndarray:
    """Irradiance (n, 3) on planes that face the lamp: `samples` pixels of all images, drawn once by importance, light all points alike.

    numbers: (samples, 3) uniform numbers: the pixel, and the place in it.
    """
    flat = tables.importance.reshape(-1)
    edges = np.cumsum(flat)
    chosen = np.minimum(np.searchsorted(edges, numbers[:samples, 0] * edges[-1], side="right"), len(flat) - 1)
    m, row, column = np.unravel_index(chosen, tables.importance.shape)
    s = tables.window_low + (np.stack([column, row], axis=-1) + numbers[:samples, 1:]) * tables.pixel
    area = tables.pixel[0] * tables.pixel[1]
    colour = tables.pixels[m, row, column] / flat[chosen, None] * (edges[-1] * area / samples)
    out = np.zeros((len(points), 3))
    _precomputed(tables, points, s, m, colour, out)
    return out


@njit(cache=True)
def _precomputed(tables, points, s, m, colour, out):
    for n in range(len(points)):
        p = points[n]
        beyond = p[2] - tables.distance
        for k in range(len(s)):
            low, high = tables.support_low[m[k]], tables.support_high[m[k]]
            u = s[k, 0] - tables.distance / beyond * (p[0] - s[k, 0])
            v = s[k, 1] - tables.distance / beyond * (p[1] - s[k, 1])
            phi = basis_value(tables.cells, (u - (low[0] + high[0]) / 2) / tables.spacing)
            if phi == 0:
                continue
            phi *= basis_value(tables.cells, (v - (low[1] + high[1]) / 2) / tables.spacing)
            r2 = (s[k, 0] - p[0]) ** 2 + (s[k, 1] - p[1]) ** 2 + beyond**2
            cos = abs(beyond) / math.sqrt(r2)
            value = (tables.distance / tables.spacing) ** 2 / cos**4 * phi * cos**2 / r2
            for c in range(3):
                out[n, c] += value * colour[k, c]
