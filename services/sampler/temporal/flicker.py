"""Mains flicker, as the camera sees it through the beat with its frame rate: detected in the total power, reported, removed on request.

Lamps flicker at twice the mains frequency, 100 or 120 Hz, far above half any frame rate here, so 21 frames a second see 100 Hz as
5 Hz. A filter of the lights cannot distinguish this 5 Hz from the scene's; the time stamps can: sines of 100 and 120 Hz are fitted
to the power at the frames' own times. A rate that divides the frequency (25 or 50 frames a second under 100 Hz) sees no flicker.
It is removed from each block of the map by itself: tubes near a window must not make the window flicker the other way.
"""

import math
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.colour import LUMINANCE_BLUE, LUMINANCE_GREEN, LUMINANCE_RED
from vemlight.light.sphere import cell_solid_angles
from vemlight.sampler.light_map import LightMap
from vemlight.sampler.warps.square import cosine_and_sine

LAMPS_HZ = (100.0, 120.0)
FIT_FRAMES = 64  # in the fit: 2.6 s at 25 frames a second, which resolves frequencies to 0.4 Hz
MIN_FIT_FRAMES = 24  # seven unknowns, and enough left over to distinguish flicker from chance
DRIFT_HZ = 0.4  # mains +-0.2 Hz and as much for clocks of cameras, searched in steps of DRIFT_STEP_HZ
DRIFT_STEP_HZ = 0.1  # a fourth of what the fit resolves
DRIFT_STEPS = 9  # 2 DRIFT_HZ / DRIFT_STEP_HZ + 1
SLOWEST_BEAT_HZ = 1.0  # slower beats look like clouds
MIN_BEATS = 2.0  # that must fit in the time seen
MIN_APART = 1.0  # beats more than another lamp's in the time seen, by which two lamps are told apart
SHORT_INTERVAL = 0.25  # quantile of the intervals between frames that no lost frame has lengthened
DETECTED, LOST = 0.75, 0.5  # fraction of the variance that sines must explain to count as flicker, and to go on: 0.6 sees it in tremor
BLACK_FRAME = 1e-3  # of the mean: no lamp dims so far, and the logarithm of such a frame would dominate the fit; up to 1e-2 does
MIN_DEPTH = 3e-3  # below which flicker is not worth a report: half of the 0.5 % that eyes can see (Weber)
CORRECT_FULLY, CORRECT_NOT = 0.6, 0.3  # fraction of a block's variance that the sines explain when it is corrected in full, and not at all
MOST_OF_MEAN = 3.0  # a lamp that goes out, as the square of a sine, has 2; the fit of its logarithm overshoots; 2.5 to 4 would do
BLOCKS = (6, 24)  # rows and columns: 15 degrees on the hemisphere, about the distance of lamps in a room


class Flicker(NamedTuple):
    """The flicker of the last frames.

    times_s: (n,) of the last frames. powers: (n, blocks), luminance of each block of the map. lamps_hz: (k,), at which lamps flicker, the
    deepest first. beat_hz, depth: of that one, as the camera sees it, and its amplitude over mean; 0 when there is none. excess:
    (blocks,), power now over power without flicker.
    """

    times_s: np.ndarray
    powers: np.ndarray
    lamps_hz: np.ndarray
    beat_hz: float
    depth: float
    excess: np.ndarray

    @property
    def lamp_hz(self) -> float:
        """Of the deepest, 0 when there is none."""
        return float(self.lamps_hz[0]) if len(self.lamps_hz) else 0.0


NO_LAMPS = np.zeros(0)
NO_FLICKER = Flicker(np.zeros(0), np.zeros((0, 1)), NO_LAMPS, 0.0, 0.0, np.ones(1))


def flicker_after(before: Flicker, time_s: float, powers: np.ndarray) -> Flicker:
    """The estimate after one more frame, at `time_s` with the powers (blocks,) of its blocks.

    Starts anew when time goes back or stops for over a beat, and when the number of blocks changes.
    """
    since = time_s - before.times_s[-1] if before.times_s.size else 0.0
    if not 0 < since <= 1 / SLOWEST_BEAT_HZ or before.powers.shape[1] != len(powers):
        before = NO_FLICKER._replace(powers=np.zeros((0, len(powers))))
    times = np.append(before.times_s[1 - FIT_FRAMES :], time_s)
    history = np.concatenate([before.powers[1 - FIT_FRAMES :], powers[None]])
    steady = Flicker(times, history, NO_LAMPS, 0.0, 0.0, np.ones(len(powers)))
    totals = history.sum(axis=1)
    if len(times) < MIN_FIT_FRAMES or totals.min() <= BLACK_FRAME * totals.mean():
        return steady
    ages, rate = times - times[-1], _frame_rate(times)
    found = sorted(_lamps(ages, np.log(totals), rate, before.lamps_hz), reverse=True)
    if not found:
        return steady
    lamps = np.array([frequency for _, frequency in found])
    columns = np.concatenate([_trend(ages), *(_waves(ages, frequency, rate) for frequency in lamps)])
    return steady._replace(lamps_hz=lamps, beat_hz=_beat(lamps[0], rate), depth=found[0][0], excess=_excess(columns, history))


def _frame_rate(times: np.ndarray) -> float:
    """Frames a second of a camera of whose frames up to two thirds may be lost: all intervals are multiples of the shortest ones."""
    intervals = np.diff(times)
    period = np.quantile(intervals, SHORT_INTERVAL)
    return float(np.maximum(np.rint(intervals / period), 1).sum() / intervals.sum())


def _lamps(ages: np.ndarray, target: np.ndarray, rate: float, known: np.ndarray) -> list[tuple[float, float]]:
    """(depth, frequency) of each lamp beyond doubt in target (n,), the logarithm of the power. known: (k,), frequencies found before."""
    slowest = max(SLOWEST_BEAT_HZ, MIN_BEATS / -ages[0])
    visible = [nominal for nominal in LAMPS_HZ if _beat(nominal, rate) >= slowest]
    found = []
    for nominal in visible:
        # What other lamps may do is no doubt about this one, where the two can be told apart.
        others = [other for other in visible if other != nominal and abs(_beat(other, rate) - _beat(nominal, rate)) * -ages[0] >= MIN_APART]
        beside = np.concatenate([_trend(ages), *(_waves(ages, other, rate) for other in others)])
        explained, frequency, amplitude = _search(ages, target, nominal, rate, beside)
        is_known = np.abs(known - nominal).min(initial=np.inf) <= 2 * DRIFT_HZ
        if explained > (LOST if is_known else DETECTED) and amplitude > MIN_DEPTH:
            found.append((explained, amplitude, frequency, len(others)))
    if len(found) > 1 and not found[0][3]:  # indistinguishable: the better one stands for both
        found = [max(found)]
    return [(amplitude, frequency) for _, amplitude, frequency, _ in found]


def block_powers(light: LightMap, blocks: bool) -> np.ndarray:
    """Luminance integrated over each of BLOCKS, or over the whole map as one block."""
    if not blocks:
        return np.array([light.power])
    rows, cols, _ = light.radiance.shape
    powers = np.zeros((min(BLOCKS[0], rows), min(BLOCKS[1], cols)))
    _add_blocks(light.radiance, cell_solid_angles(rows, cols, light.coverage), powers)
    return powers.ravel()


def without_flicker(light: LightMap, now: Flicker) -> np.ndarray:
    """The radiance (rows, cols, 3) float32 of the map without what flickers; `now` has the powers of its blocks."""
    rows, cols, _ = light.radiance.shape
    excess = now.excess.astype(np.float32).reshape(min(BLOCKS[0], rows), min(BLOCKS[1], cols))
    down, across = np.arange(rows) * excess.shape[0] // rows, np.arange(cols) * excess.shape[1] // cols
    return light.radiance / excess[down[:, None], across[None, :], None]


@kernel
def _add_blocks(radiance, solid_angles, powers):
    rows, cols, _ = radiance.shape
    for i in range(rows):
        down = i * powers.shape[0] // rows
        for j in range(cols):
            light = LUMINANCE_RED * radiance[i, j, 0] + LUMINANCE_GREEN * radiance[i, j, 1] + LUMINANCE_BLUE * radiance[i, j, 2]
            powers[down, j * powers.shape[1] // cols] += light * solid_angles[i]


@kernel
def _beat(frequency, rate):
    """The frequency as frames at `rate` see it, at most half the rate."""
    return abs(frequency - math.floor(frequency / rate + 0.5) * rate)


@kernel
def _trend(ages):
    """(3, n): what the scene does, a parabola. ages: (n,), times before the last frame, <= 0."""
    columns = np.empty((3, ages.size))
    for i in range(ages.size):
        t = ages[i] / -ages[0]
        columns[0, i], columns[1, i], columns[2, i] = 1.0, t, t * t
    return columns


@kernel
def _waves(ages, frequency, rate):
    """(4, n): what a lamp does, cosine and sine of the frequency and of its double.

    The double is left out where the camera sees it as standing still or as the frequency itself.
    """
    span, double = -ages[0], _beat(2 * frequency, rate)
    use_double = double > 1 / span and abs(double - _beat(frequency, rate)) > 1 / span
    columns = np.zeros((4, ages.size))
    for i in range(ages.size):
        cosine, sine = cosine_and_sine(frequency * ages[i])
        columns[0, i], columns[1, i] = cosine, sine
        if use_double:
            columns[2, i], columns[3, i] = 2 * cosine * cosine - 1, 2 * sine * cosine
    return columns


# Sums may be reordered, so that several are formed at a time.
@kernel(fastmath={"reassoc"})
def _least_squares(columns, target):
    """Fit of target (n, k) by columns (c, n): (weights (c, k), squared residuals (k,)).

    The normal equations by Cholesky's decomposition, written out: numba takes 8 s to compile its calls of LAPACK.
    """
    count, n = columns.shape
    factor, weights = np.zeros((count, count)), np.zeros((count, target.shape[1]))
    for c in range(count):
        for d in range(c + 1):
            for i in range(n):
                factor[c, d] += columns[c, i] * columns[d, i]
        factor[c, c] += 1e-9 * n  # a column that is left out, or sine and cosine at half the frame rate, keep the system solvable
        for i in range(n):
            for k in range(target.shape[1]):
                weights[c, k] += columns[c, i] * target[i, k]
    _solve(factor, weights)
    residuals, squares = target.copy(), np.zeros(target.shape[1])
    for i in range(n):
        for c in range(count):
            for k in range(squares.size):
                residuals[i, k] -= columns[c, i] * weights[c, k]
        for k in range(squares.size):
            squares[k] += residuals[i, k] * residuals[i, k]
    return weights, squares


@subroutine
def _solve(factor, rows):
    """Solves a symmetric, positive definite system (c, c), of which the lower half is read and overwritten, for rows (c, k), in place."""
    count, width = rows.shape
    for c in range(count):
        for d in range(c + 1):
            for e in range(d):
                factor[c, d] -= factor[c, e] * factor[d, e]
            factor[c, d] = np.sqrt(factor[c, c]) if c == d else factor[c, d] / factor[d, d]
        for k in range(width):
            for d in range(c):
                rows[c, k] -= factor[c, d] * rows[d, k]
            rows[c, k] /= factor[c, c]
    for c in range(count - 1, -1, -1):
        for k in range(width):
            for d in range(c + 1, count):
                rows[c, k] -= factor[d, c] * rows[d, k]
            rows[c, k] /= factor[c, c]


@kernel
def _explained(about, residuals, n):
    """Fraction (k,) of the squares `about` the parabola that the sines explain, given squared residuals (k,) over n frames."""
    explained = np.zeros(about.size)
    for k in range(explained.size):
        explained[k] = 1 - residuals[k] / about[k] if about[k] > 1e-12 * n else 0.0
    return explained


@subroutine
def _copy_rows(rows, columns):
    """Copies rows (c, n) into the first ones of columns."""
    for c in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            columns[c, i] = rows[c, i]


@kernel
def _search(ages, target, nominal, rate, beside):
    """(fraction of the rest that is explained, frequency, depth) of the best fit to target (n,) near the nominal frequency.

    beside: (c, n), columns of all else, whose residual is the rest.
    """
    explained, single, n, c = np.empty(DRIFT_STEPS), target.reshape(-1, 1), ages.size, beside.shape[0]
    columns = np.empty((c + 4, n))
    _copy_rows(beside, columns)
    about = _least_squares(beside, single)[1]
    for k in range(DRIFT_STEPS):
        _copy_rows(_waves(ages, nominal - DRIFT_HZ + k * DRIFT_STEP_HZ, rate), columns[c:])
        explained[k] = _explained(about, _least_squares(columns, single)[1], n)[0]
    k = 0
    for other in range(1, DRIFT_STEPS):
        k = other if explained[other] > explained[k] else k
    offset = 0.0
    if 0 < k < DRIFT_STEPS - 1:  # the top of the parabola through the best and its neighbours
        bend = explained[k - 1] - 2 * explained[k] + explained[k + 1]
        offset = 0.5 * (explained[k - 1] - explained[k + 1]) / bend if bend < 0 else 0.0
    frequency = nominal - DRIFT_HZ + (k + offset) * DRIFT_STEP_HZ
    _copy_rows(_waves(ages, frequency, rate), columns[c:])
    weights, residuals = _least_squares(columns, single)
    amplitude = np.sqrt(weights[c, 0] ** 2 + weights[c + 1, 0] ** 2)
    # log(1 + d sin) has the amplitude a = 2 (1 - sqrt(1 - d^2)) / d, so d = a / (1 + a^2 / 4).
    # Of the variance, each over its degrees of freedom: few frames are explained by chance.
    unexplained = residuals[0] / (n - c - 4) / (about[0] / (n - c)) if about[0] > 1e-12 * n else 1.0
    return 1 - unexplained, frequency, amplitude / (1 + 0.25 * amplitude**2)


def _excess(columns: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """Power now over power without flicker, for each block (n, blocks); 1 where a block was dark or changes in another way, as where sines
    fit it that no lamp has: of more than MOST_OF_MEAN, or darker than a black frame.
    """
    lit = powers.min(axis=0) > BLACK_FRAME * np.maximum(powers.mean(axis=0), 1e-300)
    target = np.log(np.where(lit, powers, 1.0))
    weights, residuals = _least_squares(columns, target)
    explained = _explained(_least_squares(columns[:3], target)[1], residuals, len(target))
    waves = columns[3:].T @ weights[3:]
    lamp = np.exp(waves - waves.max(axis=0))  # of the brightest frame, which overflows nowhere
    mean = lamp.mean(axis=0)
    possible = lit & (MOST_OF_MEAN * mean >= 1) & (lamp.min(axis=0) >= BLACK_FRAME * mean)
    return (lamp[-1] / mean) ** (possible * np.clip((explained - CORRECT_NOT) / (CORRECT_FULLY - CORRECT_NOT), 0, 1))
