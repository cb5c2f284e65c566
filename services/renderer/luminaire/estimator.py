"""Position-dependent importance sampling of a luminaire (Lu et al. 2015), one estimator before, on and between the planes.

With Delta / |s - p|^3 ds = z_p / |u - p|^3 du equations 5 and 9 are one integral over U,

    I_m(p) = (delta / (z_p spacing))^2 integral C_m(s(u)) phi_m(u) / cos theta du,

so a sample is drawn in the box on S and weighed on U, and nothing special happens where p lies on S or the box is smaller than a pixel.
Samples are shared out by systematic rounding, which drops no image (equation 12's nearest integer loses up to 16 % of the light), and
divided by the number expected. K_max caps an image's share; what is capped is divided by the number used. All images of a point draw from
one Halton sequence, each where the one before it stopped: with a prefix of its own for each, all would err alike (21 % against 8 % at 200
samples of 25 images).
"""

import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numba import njit

from vemlight.renderer.luminaire.occlusion import Hierarchy, blocked, hierarchy_of
from vemlight.renderer.luminaire.tables import Tables, axis_box, mean_importance, sample_box

EMPTY = hierarchy_of(np.zeros((0, 3, 3)))
CHUNK = 512  # points a thread takes at a time: far longer than handing them out takes
SHADOW_START = 1e-4  # of the way to the lamp: a ray leaves its own surface


class Surfaces(NamedTuple):
    """What is lit, (n, ...) float64 in the luminaire's frame: positions, shading and flat normals on the viewer's side, the mirrored view,
    diffuse and specular (n, 3), shape (n,), the Phong exponent or GGX' alpha, and kind (n,): 2 for GGX, below for Lambert and Phong."""

    positions: np.ndarray
    normals: np.ndarray
    flat_normals: np.ndarray
    mirrored: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    shape: np.ndarray
    kind: np.ndarray


def receivers(positions: np.ndarray, normals: np.ndarray) -> Surfaces:
    """Surfaces whose reflected radiance is the irradiance itself: diffuse = pi."""
    n = len(positions)
    return Surfaces(positions, normals, normals, normals, np.full((n, 3), np.pi), np.zeros((n, 3)), np.zeros(n), np.zeros(n))


def halton(count: int) -> np.ndarray:
    """Points 1 to `count` of the Halton sequence in bases 2 and 3, (count, 2) float64."""
    points = np.zeros((count, 2))
    for axis, base in enumerate((2, 3)):
        rest, scale = np.arange(1, count + 1), 1.0
        while rest.any():
            scale /= base
            points[:, axis] += (rest % base) * scale
            rest = rest // base
    return points


def interleaving(rows: np.ndarray, columns: np.ndarray, side: int) -> np.ndarray:
    """Shifts (n, 3) of the sequence and of the rounding at pixels: side^2 different ones in tiles; side 1: the same for all.

    Additive recurrence of the golden ratio's kin in three dimensions (Roberts 2018), centred so that side 1 rounds to nearest.
    """
    k = (rows % side) * side + columns % side
    ratio = 1.2207440846057596  # x^4 = x + 1
    shift = (k[:, None] * ratio ** -np.arange(1.0, 4.0)) % 1.0
    shift[:, 2] = (shift[:, 2] + 0.5) % 1.0
    return shift


def shade(tables: Tables, surfaces: Surfaces, shifts: np.ndarray, samples: int, most: int = 0, scene: Hierarchy = EMPTY,
          world_from_local: np.ndarray | None = None) -> np.ndarray:
    """Reflected radiance (n, 3) float64 of surfaces under a luminaire, about `samples` samples each.

    shifts: (n, 3) from `interleaving`. most: K_max, samples of one image at a point (0: no cap). scene: what casts shadows, in the world,
    with world_from_local (4, 4); the ray-traced truth that shadow maps are judged by.
    """
    out = np.zeros((len(surfaces.positions), 3))
    matrix = np.eye(4) if world_from_local is None else np.ascontiguousarray(world_from_local, np.float64)
    arrays = Surfaces(*(np.ascontiguousarray(a, np.float64) for a in surfaces))
    points, shifts = halton(samples + 1), np.ascontiguousarray(shifts, np.float64)
    cuts = range(0, len(out), CHUNK)

    def work(first: int) -> None:
        part = slice(first, first + CHUNK)
        _shade(tables, Surfaces(*(a[part] for a in arrays)), shifts[part], points, samples, most or samples + 1, scene, matrix, out[part])

    with ThreadPoolExecutor(os.cpu_count()) as threads:  # the compiled loop leaves Python's lock
        list(threads.map(work, cuts))
    return out


@njit(cache=True)
def basis_value(cells, x):
    """phi of bases.basis: cells names it."""
    a = abs(x)
    if cells == 2:
        return 1 - 2 * a * a if a <= 0.5 else (2 * (1 - a) * (1 - a) if a < 1 else 0.0)
    return 0.75 - a * a if a <= 0.5 else (0.5 * (1.5 - a) * (1.5 - a) if a < 1.5 else 0.0)


@njit(cache=True)
def image_box(tables, m, p, box):
    """Fills box with x0, x1, u0, u1, y0, y1, v0, v1; returns the integral of importance over its part of U, 0 where nothing is seen."""
    ratio = tables.distance / p[2]
    support, window = tables.supports[m], tables.window
    height, width = tables.importance.shape[1:]
    box[0], box[1], box[2], box[3] = axis_box(support[0], support[2], p[0], ratio, window[0], window[2], width)
    box[4], box[5], box[6], box[7] = axis_box(support[1], support[3], p[1], ratio, window[1], window[3], height)
    if box[1] < box[0] or box[5] < box[4]:
        return 0.0
    mean = mean_importance(tables.sums[m], tables.importance[m], box[0], box[1], box[4], box[5])
    return mean * abs((box[3] - box[2]) * (box[7] - box[6]))


@njit(cache=True, nogil=True)
def _shade(tables, surfaces, shifts, points, samples, most, scene, matrix, out):
    boxes, share = np.empty((len(tables.sums), 8)), np.empty(len(tables.sums))
    for n in range(len(out)):
        p = surfaces.positions[n]
        if not p[2] > 0:
            continue
        total = 0.0
        for m in range(len(share)):
            share[m] = image_box(tables, m, p, boxes[m])
            total += share[m]
        if total <= 0:
            continue
        scale = (tables.distance / (p[2] * tables.spacing)) ** 2
        passed, drawn = 0.0, 0
        for m in range(len(share)):
            expected = samples * (share[m] / total)
            count = math.floor(passed + expected + shifts[n, 2]) - math.floor(passed + shifts[n, 2])
            passed += expected
            divisor = expected
            if expected > most:
                count, divisor = most, float(most)
            if count > 0:
                weight = scale * share[m] / divisor
                _add_image(tables, m, surfaces, n, boxes[m], shifts[n], points[drawn : drawn + count], weight, scene, matrix, out)
                drawn += count


@njit(cache=True)
def _add_image(tables, m, surfaces, n, box, shift, points, weight, scene, matrix, out):
    """Adds one sample for each of `points`, drawn in image m."""
    p, normal, flat, mirrored = surfaces.positions[n], surfaces.normals[n], surfaces.flat_normals[n], surfaces.mirrored[n]
    centre_u, centre_v = (tables.supports[m, 0] + tables.supports[m, 2]) / 2, (tables.supports[m, 1] + tables.supports[m, 3]) / 2
    sums, importance, pixels, scene_is_empty = tables.sums[m], tables.importance[m], tables.pixels[m], len(scene.nodes) == 0
    shape, mirrors = surfaces.shape[n], surfaces.kind[n] >= 2 or surfaces.specular[n].max() > 0
    for k in range(len(points)):
        a, b = points[k, 0] + shift[0], points[k, 1] + shift[1]
        x, y, row, column = sample_box(sums, importance, box[0], box[1], box[4], box[5], a - math.floor(a), b - math.floor(b))
        q = importance[row, column]
        if q <= 0:
            continue
        u, v = box[2] + x * (box[3] - box[2]), box[6] + y * (box[7] - box[6])
        phi = basis_value(tables.cells, (u - centre_u) / tables.spacing) * basis_value(tables.cells, (v - centre_v) / tables.spacing)
        dx, dy, dz = u - p[0], v - p[1], -p[2]
        r = math.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx / r, dy / r, dz / r
        cosine = normal[0] * dx + normal[1] * dy + normal[2] * dz
        if cosine <= 0 or flat[0] * dx + flat[1] * dy + flat[2] * dz <= 0:
            continue
        if not scene_is_empty:
            ox = matrix[0, 0] * p[0] + matrix[0, 1] * p[1] + matrix[0, 2] * p[2] + matrix[0, 3]
            oy = matrix[1, 0] * p[0] + matrix[1, 1] * p[1] + matrix[1, 2] * p[2] + matrix[1, 3]
            oz = matrix[2, 0] * p[0] + matrix[2, 1] * p[1] + matrix[2, 2] * p[2] + matrix[2, 3]
            wx = matrix[0, 0] * dx + matrix[0, 1] * dy + matrix[0, 2] * dz
            wy = matrix[1, 0] * dx + matrix[1, 1] * dy + matrix[1, 2] * dz
            wz = matrix[2, 0] * dx + matrix[2, 1] * dy + matrix[2, 2] * dz
            if blocked(scene, ox, oy, oz, wx, wy, wz, SHADOW_START * r, r):
                continue
        value = weight * phi * (r / p[2]) * cosine / q
        lobe, grazing = 0.0, 0.0
        if mirrors:
            reflected = mirrored[0] * dx + mirrored[1] * dy + mirrored[2] * dz
            if surfaces.kind[n] >= 2:
                over = normal[0] * mirrored[0] + normal[1] * mirrored[1] + normal[2] * mirrored[2]  # cosine of the view, as of its mirror
                lobe, grazing = ggx_lobe(cosine, max(over, 1e-4), 2 * over * cosine - reflected, shape)
            else:
                lobe = (shape + 2) / (2 * math.pi) * max(reflected, 1e-6) ** shape
        for c in range(3):
            fresnel = surfaces.specular[n, c] + (1 - surfaces.specular[n, c]) * grazing
            kept = 1 - fresnel if surfaces.kind[n] >= 2 else 1.0
            out[n, c] += value * pixels[row, column, c] * (surfaces.diffuse[n, c] / math.pi * kept + fresnel * lobe)


@njit(cache=True)
def ggx_lobe(cosine, over, towards, alpha):
    """(distribution x visibility, Schlick's (1 - v.h)^5) of glTF 2.0, appendix B.3, from the cosines of light and view and between them."""
    length = math.sqrt(max(2 + 2 * towards, 1e-12))
    n = min((cosine + over) / length, 1.0)
    a2 = alpha * alpha
    t = n * n * (a2 - 1) + 1
    smith = cosine * math.sqrt(over * over * (1 - a2) + a2) + over * math.sqrt(cosine * cosine * (1 - a2) + a2)
    return a2 / (math.pi * t * t) * 0.5 / smith, (1 - min((1 + towards) / length, 1.0)) ** 5
