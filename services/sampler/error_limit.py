"""How many lights keep the error within a limit, and what the error is.

The error is that of `hard_probes`, and a standard error more: where few probes decide it, others may find twice as much. Numbers of
lights are chosen from one ladder, and lights must do with LIMIT of the error asked for: on eleven real maps the error at other probes was
then kept for every limit of 3 to 40 %.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage
from vemlight.sampler.hard_probes import HARD_PROBES, SLICES, hard_probes, relative_squares, slice_of_probes
from vemlight.sampler.tracking.tiles import Tiles

LIMIT = 0.84  # of the error asked for: 0.8 but for the standard error, a twentieth where all probes matter alike
LADDER_START, LADDER_STEPS = 4, 4  # the smallest number of lights that is tried, and numbers an octave
ERROR_ORDER = 0.7  # the error falls with about this power of the number of lights, of points and of soft ones
# Probes by which lights are first chosen and become more: in the shadow of a few strong lamps one probe in 400 may have most of the error,
# behind the edge of a sun one in 4000. More are asked, 4 and 10 ms, where the fewer do not tell whether the limit is kept.
DECIDING_PROBES = (4 * HARD_PROBES, 16 * HARD_PROBES)
SURE = 2.0  # standard errors, by which a limit is surely exceeded
MAX_RISE = 2.0  # by which the number is multiplied at once: too few lights for the lamps there are say how bad it is, not how many it takes
TILE_LIGHTS = 300  # that tiles are made for where the lights need none: 1700 to 2000, each in error by less than 1 %
ALARM = 1.1  # times a slice's error when it was last looked at, above which all probes are,
MAX_CHANGE = 0.03  # as where power, or power x direction, has changed by so much of the power since they were: light turned by 2 degrees


class ErrorEstimate(NamedTuple):
    """squares: (SLICES,), mean squared error of each slice of the probes when it was last looked at. part: the next one.

    When all were last looked at: count, of the lights, 0 before the first estimate, and moment (4,), of the map's power and power x
    direction.
    """

    squares: np.ndarray
    part: int
    count: int
    moment: np.ndarray

    @property
    def error(self) -> float:
        """Relative error, RMS over all probes, no larger unless by more than the standard error of its square."""
        return float(np.sqrt(self.squares.mean() + self._standard_error))

    @property
    def _standard_error(self) -> float:
        """Of the mean square."""
        return float(self.squares.std() / np.sqrt(SLICES - 1))

    def keeps(self, error: float) -> bool:
        """Whether it is within LIMIT of `error`."""
        return self.error <= LIMIT * error

    def surely_exceeds(self, error: float) -> bool:
        """Whether more probes would say, too, that it is not."""
        return self.squares.mean() - SURE * self._standard_error > (LIMIT * error) ** 2


NO_ESTIMATE = ErrorEstimate(np.zeros(SLICES), 0, 0, np.zeros(4))


def estimate_of(tiles: Tiles, lights: LightSet, coverage: Coverage, count: int = HARD_PROBES) -> ErrorEstimate:
    """By all probes, or so many of their sequence."""
    squares = relative_squares(hard_probes(coverage, end=count), tiles, lights)
    return ErrorEstimate(squares.reshape(-1, SLICES).mean(axis=0, dtype=np.float64), 0, len(lights.ids), _moment(tiles))


def deciding_estimate(tiles: Tiles, lights: LightSet, coverage: Coverage, error: float) -> ErrorEstimate:
    """By as many of DECIDING_PROBES as tell whether the lights keep within LIMIT of `error`."""
    few, many = DECIDING_PROBES
    estimate = estimate_of(tiles, lights, coverage, few)
    decided = estimate.keeps(error) or estimate.surely_exceeds(error)
    return estimate if decided else estimate_of(tiles, lights, coverage, many)


def _moment(tiles: Tiles) -> np.ndarray:
    return np.append(tiles.power.sum(), tiles.direction @ tiles.power)


def estimate_after(before: ErrorEstimate, tiles: Tiles, lights: LightSet, coverage: Coverage, error: float) -> ErrorEstimate:
    """By one slice more, or by all probes where the number of lights is another, light has changed, or LIMIT of `error` is exceeded."""
    moment = _moment(tiles)
    if before.count != len(lights.ids) or np.abs(moment - before.moment).max() > MAX_CHANGE * moment[0]:
        return estimate_of(tiles, lights, coverage)
    square = float(relative_squares(slice_of_probes(coverage, before.part), tiles, lights).mean())
    squares = before.squares.copy()
    squares[before.part] = square
    after = before._replace(squares=squares, part=(before.part + 1) % SLICES)
    changed = square > ALARM**2 * before.squares[before.part]
    return estimate_of(tiles, lights, coverage) if changed or not after.keeps(error) else after


def ladder(max_count: int) -> np.ndarray:
    """The numbers of lights that are tried: steps of a fourth of an octave (19 %) from 4, and `max_count` itself."""
    steps = LADDER_START * 2 ** (np.arange(64) / LADDER_STEPS)
    return np.append(np.unique(np.rint(steps[steps < max_count - 0.5]).astype(np.int64)), max_count)


def smallest_within(error: float, max_count: int, error_of: Callable[[int], float]) -> int:
    """The smallest number that keeps within LIMIT of `error`, as do all numbers up to its double; `max_count` where none does.

    error_of: the error of a number of lights, asked for in rising order. A larger `error` never takes more lights.
    """
    sizes, first = ladder(max_count), 0
    for k, size in enumerate(sizes):
        if error_of(int(size)) > LIMIT * error:
            first = k + 1
        elif k - first == LADDER_STEPS:
            break
    return int(sizes[min(first, len(sizes) - 1)])


def extrapolated(count: int, present: float, error: float, max_count: int) -> int:
    """The number on the ladder that would keep within LIMIT of `error`, when `count` lights have the error `present`."""
    wanted = count * min((present / (LIMIT * error)) ** (1 / ERROR_ORDER), MAX_RISE)
    sizes = ladder(max_count)
    return int(sizes[min(np.searchsorted(sizes, wanted), len(sizes) - 1)])


def is_capped(error_percent: float, limit_percent: float) -> bool:
    """Whether lights do not keep an error limit surely, as where their number has a maximum. limit_percent: 0 without a limit."""
    return 0 < LIMIT * limit_percent < error_percent


def capped_text(count: int, error_percent: float, limit_percent: float) -> str:
    """The line that says so."""
    return (
        f"error limit {limit_percent:g} %: {count} lights have an estimated error of {error_percent:.3g} %, "
        f"where {LIMIT * limit_percent:.3g} % or less surely keeps the limit; where their number is limited, allow more, or a larger error"
    )
