"""What is taken out of the light in time: the sensor's noise, cell by cell of the map, and the flicker of lamps, light by light.

Of noise, one frame's step is undone by the next, so the covariance of two steps in a row is minus the noise's variance; light
that moves or changes does not step back. Where a scene moves too much to tell, no noise is found and nothing is smoothed.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

STRIDE = 4  # columns: one in so many tells the noise
MEMORY = 0.2  # of the way that the noise goes to this frame's: a memory of five frames
LARGEST_STEP = 0.3  # relative; steps beyond it are the scene's
FRAMES = 48  # kept for lamps' flicker, two seconds at 25 fps
FEWEST = 16  # to find it in: four unknowns
LONGEST_GAP_S = 1.0  # what was seen longer ago says nothing about now


class Noise(NamedTuple):
    """last, step: (rows, cols / STRIDE), the last frame's luminance and its step. variance: of a cell's noise, relative."""

    last: np.ndarray
    step: np.ndarray
    variance: float


class Flicker(NamedTuple):
    """ids: (n,) int64. times_s: (m,). powers: (m, n), of the lights in the last frames."""

    ids: np.ndarray
    times_s: np.ndarray
    powers: np.ndarray


NO_NOISE = Noise(np.zeros((0, 0)), np.zeros((0, 0)), 0.0)
NO_FLICKER = Flicker(np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 0)))


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


def with_lights(before: Flicker, ids: np.ndarray, power: np.ndarray, time_s: float, changed: set[int]) -> Flicker:
    """The lights' powers of one more frame. A light without a past, or whose cell was split or merged (`changed`), takes that
    of all light.
    """
    if len(before.times_s) and not 0 < time_s - before.times_s[-1] < LONGEST_GAP_S:
        before = NO_FLICKER
    order = {int(i): k for k, i in enumerate(before.ids) if int(i) not in changed}
    column = np.array([order.get(int(i), -1) for i in ids], np.int64)
    known, total = column >= 0, before.powers.sum(axis=1)
    past = total[:, None] * (power / power.sum())
    past[:, known] = before.powers[:, column[known]]
    return Flicker(ids, np.append(before.times_s, time_s)[-FRAMES:], np.concatenate([past, power[None]])[-FRAMES:])


def ripple(flicker: Flicker, lamp_hz: float) -> np.ndarray:
    """Each light's power now over its power without flicker, (n,): least squares of a line and a sine of `lamp_hz` at the
    frames' times.
    """
    since, powers = flicker.times_s - flicker.times_s[-1], flicker.powers
    if not lamp_hz or len(since) < FEWEST:
        return np.ones(powers.shape[1])
    angle = 2 * np.pi * lamp_hz * since
    columns = np.stack([np.ones_like(since), since, np.cos(angle), np.sin(angle)], axis=-1)
    weights = np.linalg.solve(columns.T @ columns + 1e-6 * len(since) * np.eye(4), columns.T @ powers)  # a beat of 0 Hz stays solvable
    sine = columns[:, 2:] @ weights[2:]
    # As much of the sine as its amplitude stands above its own uncertainty: 2 of m residuals' variances, twice.
    residual = ((powers - columns @ weights) ** 2).mean(axis=0)
    amplitude = (weights[2:] ** 2).sum(axis=0)
    sure = np.clip(1 - 4 * residual / len(since) / np.where(amplitude > 0, amplitude, 1.0), 0.0, 1.0)
    base = powers[-1] - sure * (sine[-1] - sine.mean(axis=0))
    return np.where(base > 0.2 * powers[-1], powers[-1] / np.where(base > 0, base, 1.0), 1.0)
