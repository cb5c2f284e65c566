"""Filters the power and the lights over time: by the frames' times, not their numbers, so that late and lost frames do no harm.

Weights w_k and the period T of the frames give sum_k w_k x(t - k T), where x is interpolated linearly between the captured frames; on
an even sequence that is the plain FIR. A recursive filter is two equal first-order low-passes in a row, exact for any interval. After a gap
longer than the filter (or than MAX_GAP_S) it starts anew from the frame that ended the gap: there is nothing left to smooth with.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel
from vemlight.light.colour import luminance_from_rgb
from vemlight.sampler.sampler_input import MAX_GAP_S
from vemlight.sampler.temporal.filters import filter_from_settings, weights_from_settings
from vemlight.settings import Sampler

RATE_FRAMES = 9  # frames whose 8 intervals have the period as their median, so that three lost frames do not change it
DARK_FRAME = 1e-3  # a frame with less than this of its neighbours' power does not steer the lights: it is a dropped or covered picture
HALF_POWER = np.sqrt(np.sqrt(2.0) - 1)  # angular frequency x time constant at which two low-passes in a row leave half the power


class FilterFrame(NamedTuple):
    """One frame's lights. power: (3,) RGB. lights: (n, 6), direction and tint of each light; all float64."""

    time_s: float
    power: np.ndarray
    lights: np.ndarray


class FilterMemory(NamedTuple):
    """What a filter remembers.

    frames: those it still needs, oldest first. debt: (3,), power owed because it may not be negative. stages: after the first and the
    second low-pass, or twice the last result of another filter, from which a recursive one then goes on.
    """

    frames: tuple[FilterFrame, ...]
    debt: np.ndarray
    stages: tuple[FilterFrame, FilterFrame] | None


EMPTY_MEMORY = FilterMemory((), np.zeros(3), None)


class FilterResult(NamedTuple):
    """memory: for the next call. frame: the result. delay_s: how far it lags behind. period_s: of the frames, 0 when unknown."""

    memory: FilterMemory
    frame: FilterFrame
    delay_s: float
    period_s: float


def filtered(settings: Sampler, memory: FilterMemory, frame: FilterFrame, lowest_z: float) -> FilterResult:
    """The filtered frame, its directions with z >= `lowest_z` (0 for a hemisphere, -1 for a sphere).

    Power stays >= 0 and no energy is lost: what a negative weight would take is owed and taken from the frames that follow.
    Directions never cancel out: a short mean is pulled to the light's own direction in the middle of the filter.
    """
    frames = memory.frames
    if frames and not 0 < frame.time_s - frames[-1].time_s <= max(_reach_s(settings, frames), MAX_GAP_S):
        memory, frames = EMPTY_MEMORY, ()
    if any(len(f.lights) != len(frame.lights) for f in frames):
        frames = tuple(f._replace(lights=_as_many(f.lights, frame.lights)) for f in frames)
    frames = (*frames, _steered(settings, frames, frame))
    period = _period(frames)
    if filter_from_settings(settings).recursive:
        stages, delay_s = _low_passed(settings, memory.stages, frames, period, lowest_z)
        return FilterResult(FilterMemory(frames[-RATE_FRAMES:], memory.debt, stages), stages[1], delay_s, period)
    weights = weights_from_settings(settings, 1 / period if period else 0.0)
    delay_s = (len(weights) - 1) / 2 * period
    frame_weights = _frame_weights(np.array([f.time_s for f in frames]), weights, period)
    owed = memory.debt + frame_weights @ np.array([f.power for f in frames])
    power = np.maximum(owed, 0.0)
    result = FilterFrame(frame.time_s, power, _mean_lights(frames, frame_weights, delay_s, lowest_z))
    memory = FilterMemory(_needed(frames, frame_weights, len(weights)), owed - power, (result, result))
    return FilterResult(memory, result, delay_s, period)


def _reach_s(settings: Sampler, frames: tuple[FilterFrame, ...]) -> float:
    period = _period(frames)
    return (len(weights_from_settings(settings, 1 / period)) - 1) * period if period else 0.0


def _period(frames: tuple[FilterFrame, ...]) -> float:
    recent = frames[-RATE_FRAMES:]
    intervals = sorted(b.time_s - a.time_s for a, b in pairwise(recent))
    return (intervals[len(intervals) // 2] + intervals[(len(intervals) - 1) // 2]) / 2 if intervals else 0.0


def _as_many(lights: np.ndarray, like: np.ndarray) -> np.ndarray:
    """Older rows for as many lights as there are now: a light that is new has always been where it is."""
    return lights if len(lights) == len(like) else np.concatenate([lights[: len(like)], like[len(lights) :]])


def _steered(settings: Sampler, frames: tuple[FilterFrame, ...], frame: FilterFrame) -> FilterFrame:
    """The frame with the last frame's lights when it is black, or (under a filter) much darker than those in memory."""
    if not frames:
        return frame
    limit = 0.0 if settings.filter == "none" else DARK_FRAME * float(luminance_from_rgb(np.array([f.power for f in frames])).max())
    return frame._replace(lights=frames[-1].lights) if float(luminance_from_rgb(frame.power)) <= limit else frame


def _needed(frames: tuple[FilterFrame, ...], frame_weights: np.ndarray, count: int) -> tuple[FilterFrame, ...]:
    """Without the oldest frames, which have no weight and which neither the next call nor the estimate of the rate can use."""
    first = max(len(frames) - max(count + 1, RATE_FRAMES), 0)
    while first and frame_weights[first]:
        first -= 1
    return frames[first:]


@kernel
def _frame_weights(times, weights, period):
    """The weight of each frame when x(t - k period) is interpolated linearly between the frames, and constant before the first."""
    frame_weights = np.zeros(times.size)
    i = times.size - 1
    for k in range(weights.size):
        t = times[-1] - k * period
        while i > 0 and times[i] > t:
            i -= 1
        if t <= times[0] or i == times.size - 1:
            frame_weights[i] += weights[k]
        else:
            part = (t - times[i]) / (times[i + 1] - times[i])
            frame_weights[i] += (1 - part) * weights[k]
            frame_weights[i + 1] += part * weights[k]
    return frame_weights


def _mean_lights(frames: tuple[FilterFrame, ...], frame_weights: np.ndarray, delay_s: float, lowest_z: float) -> np.ndarray:
    lights = np.zeros_like(frames[-1].lights)
    for weight, frame in zip(frame_weights, frames, strict=True):
        if weight:
            _add(lights, weight, frame.lights)
    middle = min(frames, key=lambda f: abs(frames[-1].time_s - delay_s - f.time_s))
    _make_safe(lights, middle.lights, lowest_z)
    return lights


def _low_passed(
    settings: Sampler, stages: tuple[FilterFrame, FilterFrame] | None, frames: tuple[FilterFrame, ...], period: float, lowest_z: float
) -> tuple[tuple[FilterFrame, FilterFrame], float]:
    """Both stages after the newest frame, and the delay in s of slow changes."""
    frame = frames[-1]
    if stages is None:
        return (frame, frame), 0.0
    time_constant = HALF_POWER / (2 * np.pi * settings.pass_hz)
    decay = np.exp(-(frame.time_s - stages[1].time_s) / time_constant)
    first, source = stages[0], frame
    after = []
    for stage in (first, stages[1]):
        lights = decay * _as_many(stage.lights, frame.lights)
        _add(lights, 1 - decay, source.lights)
        source = FilterFrame(frame.time_s, decay * stage.power + (1 - decay) * source.power, lights)
        after.append(source)
    result = after[1].lights.copy()
    _make_safe(result, frame.lights, lowest_z)
    steady_decay = np.exp(-period / time_constant)
    return (after[0], after[1]._replace(lights=result)), float(2 * period * steady_decay / (1 - steady_decay)) if period else 0.0


@kernel
def _add(total, weight, lights):
    for n in range(lights.shape[0]):
        for c in range(lights.shape[1]):
            total[n, c] += weight * lights[n, c]


@kernel
def _make_safe(lights, centre, lowest_z):
    """Makes directions unit vectors (a mean shorter than 1/2 is first pulled to `centre`, to be above 0.24 long) and tints >= 0."""
    for n in range(lights.shape[0]):
        x, y, z = lights[n, 0], lights[n, 1], lights[n, 2]
        pull = 0.5 * min(max(1 - 2 * np.sqrt(x * x + y * y + z * z), 0.0), 1.0)
        x, y, z = x + pull * centre[n, 0], y + pull * centre[n, 1], z + pull * centre[n, 2]
        z = max(z, lowest_z)
        length = np.sqrt(x * x + y * y + z * z)
        if length > 1e-6:
            lights[n, 0], lights[n, 1], lights[n, 2] = x / length, y / length, z / length
        else:
            lights[n, 0], lights[n, 1], lights[n, 2] = centre[n, 0], centre[n, 1], centre[n, 2]
        for c in range(3, 6):
            lights[n, c] = max(lights[n, c], 0.0)
