"""The map as it came, cleaned: invalid cells inpainted from the frame before, noise taken out over time."""

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.colour import LUMINANCE_BLUE, LUMINANCE_GREEN, LUMINANCE_RED
from vemlight.sampler.light_map import MAX_RADIANCE

INPAINT_FRAMES = 2  # for which a black cell shows what it showed: a lost picture is bridged, a switched lamp is dark 80 ms late at 25 fps
CLEAR_SIGMAS = 3.0  # a change of so many standard deviations of the noise goes through at once
MIN_GAIN = np.float32(0.12)  # noise is averaged over 2 / 0.12 - 1 = 16 frames at most


def cleaned(
    radiance: np.ndarray, previous: np.ndarray | None, black_frames: np.ndarray, variance: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """(clean map (rows, cols, 3) float32, black_frames (rows, cols) uint8, count of invalid cells) of a map as it came.

    Invalid values (nan, infinite, negative, above MAX_RADIANCE) become 0, or with a `previous` clean map, the whole cell becomes what it
    was there. So does a cell that turned black, for INPAINT_FRAMES: a lost line of the picture is bridged, a light that went out stays out.
    black_frames: for how many frames each cell has been inpainted because it was black. A cell whose change lies within noise of relative
    `variance` goes only part of the way.
    """
    clean = np.array(radiance, np.float32, order="C")
    ages = np.zeros(radiance.shape[:2], np.uint8) if black_frames.shape != radiance.shape[:2] else black_frames.copy()
    return clean, ages, _clean(clean, previous is not None, clean if previous is None else previous, variance, ages)


@kernel
def _clean(clean, inpainting, previous, variance, ages):
    """Cleans a map in place; returns how many cells were invalid."""
    rows, cols, _ = clean.shape
    invalid, gain = 0, np.empty(cols, np.float32)
    for i in range(rows):
        row, old = clean[i].reshape(3 * cols), previous[i].reshape(3 * cols)
        if _all_valid_and_lit(row):
            ages[i] = 0
        else:
            invalid += _inpaint(row, inpainting, old, ages[i])
        if inpainting and variance > 0:
            _smooth(row, old, np.float32(1 / (CLEAR_SIGMAS * CLEAR_SIGMAS * variance)), gain)
    return invalid


@subroutine
def _all_valid_and_lit(row):
    """Whether all cells of a row (3 cols,) are lit and none is invalid."""
    others = 0
    for j in range(row.size // 3):
        r, g, b = row[3 * j], row[3 * j + 1], row[3 * j + 2]
        whole = r + g + b
        others += not ((r >= 0) & (g >= 0) & (b >= 0) & (whole > 0) & (whole <= MAX_RADIANCE))  # false for nan
    return others == 0


@subroutine
def _inpaint(row, inpainting, old, ages):
    """Cleans or inpaints the cells of a row (3 cols,) that are invalid or black; returns how many are invalid."""
    invalid = 0
    for j in range(ages.size):
        cell, was = row[3 * j : 3 * j + 3], old[3 * j : 3 * j + 3]
        whole = cell[0] + cell[1] + cell[2]
        valid = cell[0] >= 0 and cell[1] >= 0 and cell[2] >= 0 and whole <= MAX_RADIANCE
        invalid += not valid
        if valid and whole > 0:
            ages[j] = 0
        elif inpainting and (not valid or ages[j] < INPAINT_FRAMES):
            ages[j] += valid
            cell[0], cell[1], cell[2] = was[0], was[1], was[2]
        else:
            for c in range(3):
                cell[c] = cell[c] if 0 <= cell[c] <= MAX_RADIANCE else 0
    return invalid


@subroutine
def _smooth(row, old, per_clear_change, gain):
    """Moves each cell of a row (3 cols,) only part of the way from the `old` row where its change may be noise.

    per_clear_change: 1 over the square of a relative change that goes through at once. gain: (cols,), scratch memory.
    """
    red, green, blue = np.float32(LUMINANCE_RED), np.float32(LUMINANCE_GREEN), np.float32(LUMINANCE_BLUE)
    for j in range(gain.size):
        level = red * old[3 * j] + green * old[3 * j + 1] + blue * old[3 * j + 2]
        change = (red * row[3 * j] + green * row[3 * j + 1] + blue * row[3 * j + 2] - level) / level
        part = change * change * per_clear_change
        gain[j] = (part * part if part * part > MIN_GAIN else MIN_GAIN) if part < 1 else np.float32(1)
    for j in range(gain.size):
        for c in range(3):
            row[3 * j + c] = old[3 * j + c] + gain[j] * (row[3 * j + c] - old[3 * j + c])


