"""Estimates the sensor's noise from the maps themselves, from frame-to-frame changes of their cells.

What noise adds to one change it takes from the next, so the covariance of two consecutive changes is minus the noise's variance; light
that moves does not step back. Where a scene moves too much for an estimate the variance is 0, and nothing is smoothed.
"""

from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, read_only
from vemlight.light.colour import LUMINANCE_WEIGHTS

STRIDE = 4  # one column in so many is looked at: 8,100 cells of 90 x 360 give the variance to 2 % a frame
MEAN_GAIN = 0.2  # of the running mean of the variance: an average over about five frames
MAX_CHANGE = np.float32(0.3)  # relative; larger changes are the scene's, seven standard deviations of noise of 3 %
_RED, _GREEN, _BLUE = (np.float32(weight) for weight in LUMINANCE_WEIGHTS)


class Noise(NamedTuple):
    """last, change: (rows, cols / STRIDE) float32, the last luminance and its relative change. variance: of a cell's noise, relative."""

    last: np.ndarray
    change: np.ndarray
    variance: float


NO_NOISE = Noise(np.zeros((0, 0), np.float32), np.zeros((0, 0), np.float32), 0.0)


def noise_after(before: Noise, radiance: np.ndarray) -> Noise:
    """The estimate after one more map (rows, cols, 3) float32. Invalid cells are left out."""
    rows, cols, _ = radiance.shape
    luminance, change = np.empty((2, rows, -(-cols // STRIDE)), np.float32)
    comparable = before.last.shape == luminance.shape
    last, last_change = (before.last, before.change) if comparable else (luminance, np.zeros_like(luminance))
    covariance = _covariance(last, last_change, read_only(radiance), luminance, change)
    return Noise(luminance, change, before.variance + MEAN_GAIN * (max(-covariance, 0.0) - before.variance) if comparable else 0.0)


# Sums may be reordered, so that several are formed at a time.
@kernel(fastmath={"reassoc"})
def _covariance(last, last_change, radiance, luminance, change):
    """Fills luminance and relative change (rows, cols / STRIDE); returns the mean product of this change and the last."""
    total, count, light = 0.0, 0, np.empty(radiance.shape[1], np.float32)
    for i in range(luminance.shape[0]):
        # The whole row: a loop over one column in so many is not vectorised and takes longer.
        row = radiance[i].reshape(3 * light.size)
        for j in range(light.size):
            light[j] = _RED * row[3 * j] + _GREEN * row[3 * j + 1] + _BLUE * row[3 * j + 2]
        for j in range(luminance.shape[1]):
            luminance[i, j] = light[STRIDE * j]
            both = last[i, j] + luminance[i, j]
            d = np.float32(2) * (luminance[i, j] - last[i, j]) / both if both > 0 else np.float32(0)
            change[i, j] = d
            usable = (abs(d) < MAX_CHANGE) & (abs(last_change[i, j]) < MAX_CHANGE) & (last[i, j] > 0)
            total += d * last_change[i, j] if usable else np.float32(0)
            count += usable
    return total / count if count else 0.0
