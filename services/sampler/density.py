"""The polar map as the sampler needs it: cleaned of spoilt values, its integrals, and an importance that is nowhere zero."""

from typing import NamedTuple

import numpy as np
from numba import njit

from services.sphere import LUMINANCE, Coverage, cell_solid_angles

# Share of the power spread evenly, so that the warps stay one to one in the dark. With 1e-3 and float64 tables a direction comes back
# within 1e-9 degrees even on a black half; of N samples N / 1000 lie there and carry the (little) light that they find.
FLOOR = 1e-3
LARGEST = 1e30  # a brighter value is spoilt; the whole sphere at this radiance, 1.3e31, is still far from float32's 3.4e38
_RED, _GREEN, _BLUE = (float(weight) for weight in LUMINANCE)


class LightMap(NamedTuple):
    """A polar map made safe.

    radiance: (rows, cols, 3) float32, finite and >= 0. importance: (rows, cols) float64, > 0, luminance with the floor, in the map's unit.
    irradiance: (3,) float64, integral of the radiance over solid angle. power: its luminance. spoilt: pixels in which a value was set to 0.
    """

    radiance: np.ndarray
    importance: np.ndarray
    irradiance: np.ndarray
    power: float
    spoilt: int
    coverage: Coverage


def light_map(radiance: np.ndarray, coverage: Coverage) -> LightMap:
    """The map (rows, cols, 3) with every value that is nan, infinite, negative or above LARGEST set to 0, and what follows from it."""
    rows, cols, _ = radiance.shape
    clean = np.empty((rows, cols, 3), np.float32)
    importance = np.empty((rows, cols))
    irradiance = np.empty(3)
    solid_angles = cell_solid_angles(rows, cols, coverage)
    spoilt = _clean(np.ascontiguousarray(radiance, np.float32), solid_angles, clean, importance, irradiance)
    power = float(irradiance @ LUMINANCE)
    _raise_floor(importance, power / float(solid_angles.sum() * cols))
    return LightMap(clean, importance, irradiance, power, spoilt, coverage)


@njit(cache=True)
def _clean(radiance, solid_angles, clean, luminance, irradiance):
    rows, cols, _ = radiance.shape
    irradiance[:] = 0.0
    spoilt = 0
    for i in range(rows):
        red = green = blue = 0.0
        for j in range(cols):
            r, g, b = radiance[i, j, 0], radiance[i, j, 1], radiance[i, j, 2]
            if not (min(r, g, b) >= 0 and r + g + b <= LARGEST):  # rare; each comparison is false for nan
                bad_r, bad_g, bad_b = not 0 <= r <= LARGEST, not 0 <= g <= LARGEST, not 0 <= b <= LARGEST
                r, g, b = np.float32(0) if bad_r else r, np.float32(0) if bad_g else g, np.float32(0) if bad_b else b
                spoilt += bad_r or bad_g or bad_b
            clean[i, j, 0], clean[i, j, 1], clean[i, j, 2] = r, g, b
            luminance[i, j] = _RED * r + _GREEN * g + _BLUE * b
            red, green, blue = red + r, green + g, blue + b
        irradiance[0] += red * solid_angles[i]
        irradiance[1] += green * solid_angles[i]
        irradiance[2] += blue * solid_angles[i]
    return spoilt


@njit(cache=True)
def _raise_floor(luminance, mean):
    rows, cols = luminance.shape
    base = FLOOR * mean if mean > 0 else 1.0  # a black map is sampled evenly
    scale = 1 - FLOOR
    for i in range(rows):
        for j in range(cols):
            luminance[i, j] = scale * luminance[i, j] + base
