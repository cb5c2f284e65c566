"""How the number of lights changes over time: hysteresis, the renderer's budget, and lights that fade in and out."""

from typing import NamedTuple

import numpy as np

HOLD_S = 1.0  # the number falls only when the requirement has been well below it for so long, to the largest seen meanwhile
RETRY_BACKOFF_S = 60.0  # for so long a number that proved too small is not tried again: in a scene that stands still, one try a minute
WELL_BELOW = 0.8  # of the number in use: less saves nothing that is worth a change, and noise alone moves the requirement by a tenth
FADE_S = 0.2  # in which a light comes or goes: five frames at 25 fps


class LightCount(NamedTuple):
    """The number of lights in use, with hysteresis.

    peak: the largest requirement since `since_s`, when it fell well below the number; else 0. updated_s: time of the last frame.
    fell_s: when the number last fell. too_few, enough: the number that it then fell to and that at once proved too small, and to which it
    rose again; else 0.
    """

    count: int
    peak: int
    since_s: float
    updated_s: float
    fell_s: float
    too_few: int
    enough: int


def count_after(before: LightCount | None, required: int, time_s: float, slack: float = 1.0) -> LightCount:
    """Up at once when `required` is above `slack` times the number in use, down when it was WELL_BELOW for HOLD_S.

    A requirement that is estimated from the lights in use may look smaller than it proves to be: when a fall is taken back within HOLD_S,
    then for RETRY_BACKOFF_S the number falls below what was enough then only where WELL_BELOW what proved too small would do. Gaps over
    HOLD_S and time that goes back begin anew.
    """
    if before is None or not 0 <= time_s - before.updated_s <= HOLD_S:
        return LightCount(required, 0, time_s, time_s, -np.inf, 0, 0)
    after = before._replace(updated_s=time_s)
    if required > slack * before.count:
        if time_s - before.fell_s <= HOLD_S:
            after = after._replace(too_few=before.count, enough=required)
        return after._replace(count=required, peak=0)
    failed = before.too_few if time_s - before.fell_s <= RETRY_BACKOFF_S else 0
    if required > WELL_BELOW * failed:
        required = max(required, before.enough if failed else 0)
    if required > WELL_BELOW * before.count:
        return after._replace(peak=0)
    after = after._replace(peak=max(before.peak, required), since_s=before.since_s if before.peak else time_s)
    fall = time_s - after.since_s >= HOLD_S
    return after._replace(count=after.peak, peak=0, fell_s=time_s, too_few=0, enough=0) if fall else after


def budget_after(before: int, budget: int) -> int:
    """The light budget to keep to, 0 when there is no limit: a smaller one at once, a larger one only when `before` is WELL_BELOW of it,
    since what the renderer can draw fluctuates as its times do.
    """
    return before if 0 < WELL_BELOW * budget <= before <= budget else budget


def fade_weights_after(weights: np.ndarray, wanted: int, passed_s: float | None) -> np.ndarray:
    """The weight in [0, 1] of each light once `passed_s` went by (None: at once): the first `wanted` fade in, the others out."""
    if len(weights) == wanted and weights.min() == 1:  # nothing is to change, as nearly always
        return weights
    count = max(wanted, len(weights))
    goal = (np.arange(count) < wanted).astype(np.float64)
    if passed_s is None:
        return goal[:wanted]
    after = np.zeros(count)
    after[: len(weights)] = weights
    step = max(passed_s, 0.0) / FADE_S
    after += np.clip(goal - after, -step, step)
    return after[: max(int(np.flatnonzero(after)[-1]) + 1 if after.any() else 0, 1)]
