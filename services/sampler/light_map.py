"""The polar map as the warps need it: without invalid values, with its integrals, and with an importance that is nowhere zero."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, read_only
from vemlight.light.colour import LUMINANCE_BLUE, LUMINANCE_GREEN, LUMINANCE_RED, LUMINANCE_WEIGHTS
from vemlight.light.sphere import Coverage, cell_solid_angles

# Fraction of the power that is spread evenly, so that the warps stay one to one in the dark. With 1e-3 and float64 tables a direction comes
# back within 1e-9 degrees even on a black half; of N samples N / 1000 lie there and carry the (little) light that they find.
FLOOR = 1e-3
MAX_RADIANCE = 1e30  # a larger value is invalid; the whole sphere at this radiance, 1.3e31, is still far from float32's 3.4e38
_MAX_RADIANCE = np.float32(MAX_RADIANCE)


class LightMap(NamedTuple):
    """A polar map made safe.

    radiance: (rows, cols, 3) float32, finite and >= 0. importance: (rows, cols) float64, > 0, luminance with the floor, in the map's unit.
    irradiance: (3,) float64, integral of the radiance over solid angle. power: its luminance. invalid_cells: in which a value was set to 0.
    """

    radiance: np.ndarray
    importance: np.ndarray
    irradiance: np.ndarray
    power: float
    invalid_cells: int
    coverage: Coverage


def light_map(radiance: np.ndarray, coverage: Coverage) -> LightMap:
    """The map (rows, cols, 3) with every value that is nan, infinite, negative or above MAX_RADIANCE set to 0, and what follows from it.

    A map without such values is not copied: the result's radiance is a view of it.
    """
    rows, cols, _ = radiance.shape
    clean, invalid_cells = np.ascontiguousarray(radiance, np.float32), 0
    importance, irradiance, solid_angles = np.empty((rows, cols)), np.empty(3), _solid_angles(rows, cols, coverage)
    clean = read_only(clean)
    if not _measure(clean, clean.reshape(rows, -1), solid_angles, importance, irradiance):
        valid = clean.copy()
        invalid_cells, clean = _clear_invalid(valid), read_only(valid)
        _measure(clean, clean.reshape(rows, -1), solid_angles, importance, irradiance)
    power = float(irradiance @ LUMINANCE_WEIGHTS)
    _raise_floor(importance, power / float(solid_angles.sum() * cols))
    return LightMap(clean, importance, irradiance, power, invalid_cells, coverage)


_solid_angles = lru_cache(maxsize=8)(cell_solid_angles)


@kernel
def _clear_invalid(radiance):
    """Sets invalid values to 0; returns the number of cells that had one."""
    invalid_cells = 0
    for i in range(radiance.shape[0]):
        for j in range(radiance.shape[1]):
            invalid = False
            for c in range(3):
                if not 0 <= radiance[i, j, c] <= _MAX_RADIANCE:
                    radiance[i, j, c], invalid = 0, True
            invalid_cells += invalid
    return invalid_cells


@kernel(fastmath={"reassoc"})  # sums may be reordered, so that several are formed at a time
def _measure(radiance, values, solid_angles, luminance, irradiance):
    """Fills the luminance (rows, cols) and the integral (3,) of the radiance; returns whether all values are in [0, MAX_RADIANCE].

    values: (rows, 3 cols), the same memory as radiance. Each row is read twice, the second time from the first-level cache.
    """
    irradiance[:] = 0.0
    invalid = 0
    for i in range(radiance.shape[0]):
        for k in range(values.shape[1]):
            invalid += 0 if (values[i, k] >= 0) & (values[i, k] <= _MAX_RADIANCE) else 1
        red = green = blue = 0.0
        for j in range(radiance.shape[1]):
            r, g, b = radiance[i, j, 0], radiance[i, j, 1], radiance[i, j, 2]
            luminance[i, j] = LUMINANCE_RED * r + LUMINANCE_GREEN * g + LUMINANCE_BLUE * b
            red, green, blue = red + r, green + g, blue + b
        irradiance[0] += red * solid_angles[i]
        irradiance[1] += green * solid_angles[i]
        irradiance[2] += blue * solid_angles[i]
    return invalid == 0


@kernel
def _raise_floor(luminance, mean):
    rows, cols = luminance.shape
    base = FLOOR * mean if mean > 0 else 1.0  # a black map is sampled evenly
    scale = 1 - FLOOR
    for i in range(rows):
        for j in range(cols):
            luminance[i, j] = scale * luminance[i, j] + base
