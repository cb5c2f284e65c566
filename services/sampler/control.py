"""How many lights: what the scene needs, what the renderer can, and how lights come and go without a step.

Need: the smallest number of lights, counted from the first, whose irradiance stays within an error of the map's own over a fixed set
of probes. The error is relative to what each probe itself receives (and to 5 % of the mean, in the dark): in the shadow of a strong
sun the few lights left for the sky must do, which is why a sunlit yard needs more lights than an overcast sky.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from vemlight.light.colour import LUMINANCE_BLUE, LUMINANCE_GREEN, LUMINANCE_RED, LUMINANCE_WEIGHTS
from vemlight.light.sphere import Coverage, cell_directions, cell_solid_angles
from vemlight.sampler.density import LightMap
from vemlight.sampler.probes import probes, seen

PROBES = 96  # the error's own uncertainty is 1 / sqrt(2 x 96) = 7 %, about a third of a step of the ladder
ROWS, COLS = 30, 120  # the map is judged in blocks of 3 degrees, but for its HOT cells
HOT = 1 / 512  # of the power: cells above it are judged where they are, since a sun's shadow is sharper than a block
DARKEST = 0.05  # of the mean irradiance
MARGIN = 0.85  # of the error that is aimed at, so that the number chosen lasts while the scene changes a little
HOLD_S = 1.0  # the need falls only when it has been well below the number in use for so long, to the largest seen meanwhile
LESSON_S = 60.0  # for so long a number that proved too small is remembered: in a scene that stands still, one try a minute
WELL_BELOW = 0.8  # of the number in use: less saves nothing that is worth a change, and noise alone moves the need by a tenth
FADE_S = 0.2  # in which a light comes or goes: five frames at 25 fps


class Need(NamedTuple):
    """count: lights in use. peak: the largest need since `since_s`, when it fell well below that; else 0. seen_s: time of the last frame.

    fell_s: when the number last fell. too_few: the number that it then fell to and that at once proved too small; else 0.
    """

    count: int
    peak: int
    since_s: float
    seen_s: float
    fell_s: float
    too_few: int


def ladder(most: int) -> np.ndarray:
    """The numbers of lights that are tried: steps of a fourth of an octave (19 %) from 4, and `most` itself."""
    steps = 4 * 2 ** (np.arange(64) / 4)
    return np.append(np.unique(np.rint(steps[steps < most - 0.5]).astype(np.int64)), most)


def need(light: LightMap, directions: np.ndarray, tint: np.ndarray, error: float, before: int = 0) -> int:
    """The number of lights that keeps within `error` (0.1: ten per cent): the smallest on the ladder that has MARGIN to it, or all.

    directions, tint: (n, 3), the lights of this map before filtering, in their order. before: the number in use, which is kept instead of
    a larger one as long as it is within the error itself. Each number counts as bad as the worst of those above it.
    """
    if light.power <= 0:
        return 1
    sizes, errors = ladder(len(directions)), prefix_errors(light, directions, tint)
    errors = np.maximum.accumulate(errors[::-1])[::-1]
    good = errors <= MARGIN * error
    count = int(sizes[good.argmax()] if good.any() else sizes[-1])
    keeps = 0 < before < count and errors[np.searchsorted(sizes, before, side="right") - 1] <= error
    return before if keeps else count


def prefix_errors(light: LightMap, directions: np.ndarray, tint: np.ndarray) -> np.ndarray:
    """Relative error of the irradiance at the probes for each number of lights on the ladder, RMS over the probes."""
    rows, cols = light.importance.shape
    responses, directions_of_cells, solid_angles, block_row, block_col = _responses(rows, cols, light.coverage)
    at = probes(PROBES, light.coverage)
    truth = np.zeros(PROBES)
    blocks = np.zeros(responses.shape[0])
    _gather_map(light.radiance, solid_angles, HOT * light.power, block_row, block_col, directions_of_cells, *at, blocks, truth)
    truth += blocks @ responses
    power = tint * light.irradiance @ LUMINANCE_WEIGHTS
    return _prefix_errors(directions, power, light.power, *at, truth, ladder(len(directions)))


@lru_cache(maxsize=2)
def _responses(rows: int, cols: int, coverage: Coverage) -> tuple[np.ndarray, ...]:
    """Mean response (blocks, PROBES) of the probes to each block of cells, and the geometry that goes with it."""
    block_row = np.arange(rows) * min(ROWS, rows) // rows
    block_col = np.arange(cols) * min(COLS, cols) // cols
    directions, solid_angles = cell_directions(rows, cols, coverage), cell_solid_angles(rows, cols, coverage)
    count = min(ROWS, rows) * min(COLS, cols)
    total, area = np.zeros((count, PROBES)), np.zeros(count)
    _fill_responses(directions, solid_angles, block_row, block_col, *probes(PROBES, coverage), total, area)
    return total / area[:, None], directions, solid_angles, block_row, block_col


@njit(cache=True)
def _fill_responses(directions, solid_angles, block_row, block_col, normals, occluders, total, area):
    across = block_col[-1] + 1
    for i in range(directions.shape[0]):
        for j in range(directions.shape[1]):
            block = block_row[i] * across + block_col[j]
            area[block] += solid_angles[i]
            for k in range(normals.shape[0]):
                total[block, k] += solid_angles[i] * seen(normals[k], occluders[k], directions[i, j])


@njit(cache=True)
def _gather_map(radiance, solid_angles, hot, block_row, block_col, directions, normals, occluders, blocks, truth):
    """Adds each cell's power to its block, or when hot its light to the probes."""
    across = block_col[-1] + 1
    for i in range(radiance.shape[0]):
        for j in range(radiance.shape[1]):
            luminance = LUMINANCE_RED * radiance[i, j, 0] + LUMINANCE_GREEN * radiance[i, j, 1] + LUMINANCE_BLUE * radiance[i, j, 2]
            power = luminance * solid_angles[i]
            if power <= hot:
                blocks[block_row[i] * across + block_col[j]] += power
            else:
                for k in range(normals.shape[0]):
                    truth[k] += power * seen(normals[k], occluders[k], directions[i, j])


@njit(cache=True)
def _prefix_errors(directions, power, total, normals, occluders, truth, sizes):
    got, spent, last = np.zeros(truth.size), 0.0, 0
    errors, dark = np.empty(sizes.size), DARKEST * truth.mean()
    for s in range(sizes.size):
        for n in range(last, sizes[s]):
            spent += power[n]
            for k in range(truth.size):
                got[k] += power[n] * seen(normals[k], occluders[k], directions[n])
        last = sizes[s]
        squares = 0.0
        for k in range(truth.size):
            squares += ((got[k] * (total / spent if spent > 0 else 0.0) - truth[k]) / (truth[k] + dark)) ** 2
        errors[s] = np.sqrt(squares / truth.size)
    return errors


def held(before: Need | None, count: int, time_s: float, slack: float = 1.0) -> Need:
    """The need with hysteresis: up at once when it is above `slack` times the number in use, down when it was WELL_BELOW for HOLD_S.

    A need that is estimated at the number in use may look smaller than it proves to be: a fall that is taken back within HOLD_S is a lesson
    for LESSON_S, in which the number falls only WELL_BELOW what proved too small. A gap over HOLD_S and time that goes back begin anew.
    """
    if before is None or not 0 <= time_s - before.seen_s <= HOLD_S:
        return Need(count, 0, time_s, time_s, -np.inf, 0)
    now = before._replace(seen_s=time_s)
    if count > slack * before.count:
        regret = time_s - before.fell_s <= HOLD_S
        return now._replace(count=count, peak=0, too_few=before.count if regret else before.too_few)
    lesson = before.too_few if time_s - before.fell_s <= LESSON_S else 0
    if count > WELL_BELOW * (lesson or before.count):
        return now._replace(peak=0)
    now = now._replace(peak=max(before.peak, count), since_s=before.since_s if before.peak else time_s)
    fall = time_s - now.since_s >= HOLD_S
    return now._replace(count=now.peak, peak=0, fell_s=time_s, too_few=0) if fall else now


def affordable(before: int, told: int) -> int:
    """How many lights the renderer can draw in its time, 0 when that is no limit: fewer as soon as it says so, more only when `before` is
    WELL_BELOW of what it says, since what it says wavers as its times do.
    """
    return before if 0 < WELL_BELOW * told <= before <= told else told


def faded(presence: np.ndarray, wanted: int, passed_s: float | None) -> np.ndarray:
    """How present each light is, in [0, 1], once `passed_s` went by (None: at once): the first `wanted` come, the others go."""
    if len(presence) == wanted and presence.min() == 1:  # nothing is to change, as nearly always
        return presence
    count = max(wanted, len(presence))
    goal = (np.arange(count) < wanted).astype(np.float64)
    if passed_s is None:
        return goal[:wanted]
    now = np.zeros(count)
    now[: len(presence)] = presence
    step = max(passed_s, 0.0) / FADE_S
    now += np.clip(goal - now, -step, step)
    return now[: max(int(np.flatnonzero(now)[-1]) + 1 if now.any() else 0, 1)]
