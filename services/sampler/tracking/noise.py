"""How noisy a sensor is, told from the map itself.

Of noise, one frame's step is undone by the next, so the covariance of two steps in a row is minus the noise's variance; light
that moves or changes does not step back. Where a scene moves too much to tell, no noise is found and nothing is to be smoothed.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from vemlight.light.colour import LUMINANCE_WEIGHTS

STRIDE = 4  # columns: one in so many tells the noise
MEMORY = 0.2  # of the way that the noise goes to this frame's: a memory of five frames
LARGEST_STEP = np.float32(0.3)  # relative; steps beyond it are the scene's
LONGEST_GAP_S = 1.0  # what was seen longer ago says nothing about now
_RED, _GREEN, _BLUE = (np.float32(weight) for weight in LUMINANCE_WEIGHTS)


class Noise(NamedTuple):
    """last, step: (rows, cols / STRIDE) float32, the last frame's luminance and relative step. variance: of a cell's noise, relative."""

    last: np.ndarray
    step: np.ndarray
    variance: float


NO_NOISE = Noise(np.zeros((0, 0), np.float32), np.zeros((0, 0), np.float32), 0.0)


def with_map(before: Noise, radiance: np.ndarray) -> Noise:
    """What is known of the noise once a map (rows, cols, 3) float32 is in; spoilt cells tell none."""
    rows, cols, _ = radiance.shape
    now, step = np.empty((2, rows, -(-cols // STRIDE)), np.float32)
    known = before.last.shape == now.shape
    covariance = _covariance(before.last if known else now, before.step if known else np.zeros_like(now), radiance, now, step)
    return Noise(now, step, before.variance + MEMORY * (max(-covariance, 0.0) - before.variance) if known else 0.0)


# Sums in any order, so that several are made at a time.
@njit(cache=True, error_model="numpy", fastmath={"reassoc"})
def _covariance(last, before, radiance, now, step):
    """Fills the luminance and the relative steps; returns their mean product with those before."""
    total, count, light = 0.0, 0, np.empty(radiance.shape[1], np.float32)
    for i in range(now.shape[0]):
        # Of the whole row: one column in so many would be fetched one by one, which takes longer.
        row = radiance[i].reshape(3 * light.size)
        for j in range(light.size):
            light[j] = _RED * row[3 * j] + _GREEN * row[3 * j + 1] + _BLUE * row[3 * j + 2]
        now[i] = light[::STRIDE]
        for j in range(now.shape[1]):
            both = last[i, j] + now[i, j]
            d = np.float32(2) * (now[i, j] - last[i, j]) / both if both > 0 else np.float32(0)
            step[i, j] = d
            told = (abs(d) < LARGEST_STEP) & (abs(before[i, j]) < LARGEST_STEP) & (last[i, j] > 0)
            total += d * before[i, j] if told else np.float32(0)
            count += told
    return total / count if count else 0.0
