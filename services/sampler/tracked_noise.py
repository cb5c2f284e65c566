"""How noisy a sensor is, told from the map itself.

Of noise, one frame's step is undone by the next, so the covariance of two steps in a row is minus the noise's variance; light
that moves or changes does not step back. Where a scene moves too much to tell, no noise is found and nothing is to be smoothed.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

STRIDE = 4  # columns: one in so many tells the noise
MEMORY = 0.2  # of the way that the noise goes to this frame's: a memory of five frames
LARGEST_STEP = 0.3  # relative; steps beyond it are the scene's
LONGEST_GAP_S = 1.0  # what was seen longer ago says nothing about now


class Noise(NamedTuple):
    """last, step: (rows, cols / STRIDE), the last frame's luminance and its step. variance: of a cell's noise, relative."""

    last: np.ndarray
    step: np.ndarray
    variance: float


NO_NOISE = Noise(np.zeros((0, 0)), np.zeros((0, 0)), 0.0)


def with_map(before: Noise, luminance: np.ndarray) -> Noise:
    """What is known of the noise once a map's luminance, one column in STRIDE, is in."""
    if before.last.shape != luminance.shape:
        return Noise(luminance, np.zeros(luminance.shape), 0.0)
    step = np.empty(luminance.shape)
    covariance = _covariance(before.last, luminance, before.step, step)
    return Noise(luminance, step, before.variance + MEMORY * (max(-covariance, 0.0) - before.variance))


@njit(cache=True)
def _covariance(last, now, before, step):
    """Fills the relative steps and returns their mean product with those before."""
    total, count = 0.0, 0
    for i in range(now.shape[0]):
        for j in range(now.shape[1]):
            a, b = last[i, j], now[i, j]
            d = 2 * (b - a) / (a + b) if a + b > 0 else 0.0
            step[i, j] = d
            if abs(d) < LARGEST_STEP and abs(before[i, j]) < LARGEST_STEP and a > 0:
                total += d * before[i, j]
                count += 1
    return total / count if count else 0.0
