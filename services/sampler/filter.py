"""Filters over time for the power and the lights: by the frames' times, not their numbers, so that late and lost frames do no harm.

A filter of taps w_k and period T gives sum_k w_k x(t - k T), x being drawn through the captured frames with straight lines; on
an even sequence that is the plain FIR. After a gap longer than the filter it starts anew from the frame that ended the gap: there is
nothing left to smooth with.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

# Havran et al. 2005, section 3.3, given there as a design for 21 Hz, 7 Hz pass, 9 Hz stop; in truth they are the equiripple
# design for 25 Hz, 7 Hz, 9.6 Hz, with a gain of 1.09245 at rest, which is divided out here.
PAPER_TAPS = (0.06216, 0.01296, -0.13816, 0.28315, 0.65223, 0.28315, -0.13816, 0.01296, 0.06216)
LONGEST_PERIOD_S = 1.0  # slower sequences are stills: each starts anew
RATE_FRAMES = 9  # the period is the median of the last 8 intervals, so that four lost frames do not change it


class Frame(NamedTuple):
    """One frame before filtering. power: (3,) RGB. lights: (n, 6), direction and tint of each light; all float64."""

    time_s: float
    power: np.ndarray
    lights: np.ndarray


class Memory(NamedTuple):
    """What a filter keeps: the frames it still needs, oldest first, and the power owed because it may not be negative, (3,)."""

    frames: tuple[Frame, ...]
    debt: np.ndarray


EMPTY = Memory((), np.zeros(3))


def taps(name: str) -> np.ndarray:
    """The weights of a filter, newest first, their sum 1."""
    weights = np.array(PAPER_TAPS if name == "fir2005" else (1.0,))
    return weights / weights.sum()


def filtered(weights: np.ndarray, memory: Memory, frame: Frame) -> tuple[Memory, Frame, float]:
    """The memory with `frame` in it, the filtered frame, and the delay in s.

    Power stays >= 0 and no energy is lost: what a negative lobe would take is owed and taken from the frames that follow.
    Directions never cancel out: a short mean is pulled to the light's own direction in the middle of the filter.
    """
    frames = memory.frames
    if frames and not 0 < frame.time_s - frames[-1].time_s <= _reach(frames, len(weights)):
        frames = ()
    frames = (*(f._replace(lights=_as_many(f.lights, frame.lights)) for f in frames), frame)
    period = _period(frames)
    order = len(weights) - 1
    shares = _shares(np.array([f.time_s for f in frames]), weights, period)
    frames, shares = _needed(frames, shares, order)
    owed = sum(share * f.power for share, f in zip(shares, frames, strict=True)) + memory.debt
    power = np.maximum(owed, 0.0)
    lights = _mean_lights(frames, shares, order * period / 2)
    return Memory(frames, owed - power), Frame(frame.time_s, power, lights), order * period / 2


def _period(frames: tuple[Frame, ...]) -> float:
    intervals = np.diff([f.time_s for f in frames[-RATE_FRAMES:]])
    return float(np.median(intervals)) if intervals.size else 0.0


def _reach(frames: tuple[Frame, ...], taps: int) -> float:
    return max((taps - 1) * _period(frames), LONGEST_PERIOD_S)


def _as_many(lights: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Older rows for as many lights as there are now: a light that is new has always been where it is."""
    return lights if len(lights) == len(like) else np.concatenate([lights[: len(like)], like[len(lights) :]])


def _needed(frames: tuple[Frame, ...], shares: np.ndarray, order: int) -> tuple[tuple[Frame, ...], np.ndarray]:
    """Without the oldest frames that no later call can use: those beyond the taps' reach and beyond the estimate of the rate."""
    keep = max(order + 2, RATE_FRAMES)
    first = max(len(frames) - keep, 0)
    while first and shares[:first].any():
        first -= 1
    return frames[first:], shares[first:]


@njit(cache=True)
def _shares(times, weights, period):
    """The weight of each frame when x(t - k period) is drawn through the frames with straight lines and held before the first."""
    shares = np.zeros(times.size)
    i = times.size - 1
    for k in range(weights.size):
        t = times[-1] - k * period
        while i > 0 and times[i] > t:
            i -= 1
        if t <= times[0] or i == times.size - 1:
            shares[i] += weights[k]
        else:
            part = (t - times[i]) / (times[i + 1] - times[i])
            shares[i] += (1 - part) * weights[k]
            shares[i + 1] += part * weights[k]
    return shares


def _mean_lights(frames: tuple[Frame, ...], shares: np.ndarray, delay_s: float) -> np.ndarray:
    lights = np.zeros_like(frames[-1].lights)
    for share, frame in zip(shares, frames, strict=True):
        if share:
            _add(lights, share, frame.lights)
    times = np.array([f.time_s for f in frames])
    _make_safe(lights, frames[int(np.abs(times - (times[-1] - delay_s)).argmin())].lights)
    return lights


@njit(cache=True)
def _add(total, share, lights):
    for n in range(lights.shape[0]):
        for c in range(lights.shape[1]):
            total[n, c] += share * lights[n, c]


@njit(cache=True)
def _make_safe(lights, centre):
    """Unit directions (a mean shorter than 1/2 is pulled to `centre`, which keeps it above 0.24 long) and tints >= 0."""
    for n in range(lights.shape[0]):
        x, y, z = lights[n, 0], lights[n, 1], lights[n, 2]
        pull = 0.5 * min(max(1 - 2 * np.sqrt(x * x + y * y + z * z), 0.0), 1.0)
        x, y, z = x + pull * centre[n, 0], y + pull * centre[n, 1], z + pull * centre[n, 2]
        if centre[n, 2] >= 0:
            z = max(z, 0.0)
        length = np.sqrt(x * x + y * y + z * z)
        if length > 0:
            lights[n, 0], lights[n, 1], lights[n, 2] = x / length, y / length, z / length
        else:
            lights[n, 0], lights[n, 1], lights[n, 2] = centre[n, 0], centre[n, 1], centre[n, 2]
        for c in range(3, 6):
            lights[n, c] = max(lights[n, c], 0.0)
