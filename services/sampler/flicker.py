"""Light that flickers with the mains, seen through the beat with the frame rate: found in the total power, reported, and taken out on wish.

Lamps flicker at twice the mains frequency, 100 or 120 Hz, far above half any frame rate here, so 21 frames a second see 100 Hz as
5 Hz. A filter of the lights cannot know that this 5 Hz is none of the scene's; the time stamps do: sines of 100 and 120 Hz are fitted
to the power at the frames' own times. A rate that divides the frequency (25 or 50 frames a second under 100 Hz) sees no flicker.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

LAMPS_HZ = (100.0, 120.0)
FRAMES = 64  # in the fit: 2.6 s at 25 frames a second, so frequencies are told apart to 0.4 Hz
FEWEST = 24  # seven unknowns, and enough left over to tell flicker from chance
DRIFT_HZ = 0.4  # mains +-0.2 Hz and as much for clocks of cameras, searched in STEPS of DRIFT_STEP_HZ
DRIFT_STEP_HZ = 0.1
STEPS = 9
SLOWEST_BEAT_HZ = 1.0  # slower beats look like clouds; and at least two of them must fit in the time seen
FOUND, LOST = 0.6, 0.4  # share of the power's variance that the sines must explain to count as flicker, and to go on counting
BLACK = 1e-3  # of the mean: a frame so dark is no lamp's doing, and its logarithm would rule the fit
FAINTEST = 3e-3  # depth below which flicker is not worth a report: half of the 0.5 % that eyes can see (Weber)


class Flicker(NamedTuple):
    """times_s, power: of the last frames, total luminance. beat_hz: as the camera sees it, 0 when none is found. lamp_hz: what flickers.
    depth: amplitude over mean. excess: power now over power without flicker, 1 when none is found.
    """

    times_s: np.ndarray
    power: np.ndarray
    beat_hz: float
    lamp_hz: float
    depth: float
    excess: float


NONE = Flicker(np.zeros(0), np.zeros(0), 0.0, 0.0, 0.0, 1.0)


def with_frame(before: Flicker, time_s: float, power: float) -> Flicker:
    """What is known once the frame at `time_s` with total `power` is in. Time that goes back or stops for over a beat starts anew."""
    if before.times_s.size and not 0 < time_s - before.times_s[-1] <= 1 / SLOWEST_BEAT_HZ:
        before = NONE
    times, powers = np.append(before.times_s[1 - FRAMES :], time_s), np.append(before.power[1 - FRAMES :], power)
    quiet = Flicker(times, powers, 0.0, 0.0, 0.0, 1.0)
    seen_s, mean = float(times[-1] - times[0]), float(powers.mean())
    if len(times) < FEWEST or powers.min() <= BLACK * mean:
        return quiet
    rate = (len(times) - 1) / seen_s
    best = (LOST if before.depth > 0 else FOUND, quiet)
    for nominal in LAMPS_HZ:
        beat = abs(nominal - round(nominal / rate) * rate)
        if beat < max(SLOWEST_BEAT_HZ, 2 / seen_s):
            continue
        share, lamp_hz, depth, excess = _search(times - times[-1], powers / mean, nominal, rate)
        if share > best[0] and depth > FAINTEST:
            best = (share, Flicker(times, powers, abs(lamp_hz - round(lamp_hz / rate) * rate), lamp_hz, depth, excess))
    return best[1]


@njit(cache=True)
def _search(times, power, nominal, rate):
    """(share of variance explained, frequency, depth, excess now) of the best fit near the nominal frequency."""
    shares = np.empty(STEPS)
    for k in range(STEPS):
        shares[k] = _fit(times, power, nominal - DRIFT_HZ + k * DRIFT_STEP_HZ, rate)[0]
    k = int(np.argmax(shares))
    offset = 0.0
    if 0 < k < STEPS - 1:  # the top of the parabola through the best and its neighbours
        bend = shares[k - 1] - 2 * shares[k] + shares[k + 1]
        offset = 0.5 * (shares[k - 1] - shares[k + 1]) / bend if bend < 0 else 0.0
    frequency = nominal - DRIFT_HZ + (k + offset) * DRIFT_STEP_HZ
    share, depth, excess = _fit(times, power, frequency, rate)
    return share, frequency, depth, excess


@njit(cache=True)
def _fit(times, power, frequency, rate):
    """Least squares, to the logarithm, of a parabola (what the scene does) and sines of the frequency and its double (what the lamp does).

    (share of the variance about the parabola that the sines explain, the lamp's amplitude over its mean, power now over power without
    flicker). The double is left out where the camera sees it as standing still or as the frequency itself.
    """
    n = times.size
    span = -times[0]
    beats = frequency - np.round(frequency / rate) * rate, 2 * frequency - np.round(2 * frequency / rate) * rate
    double = abs(beats[1]) > 1 / span and abs(abs(beats[1]) - abs(beats[0])) > 1 / span
    columns = np.zeros((7, n))
    for i in range(n):
        t, angle = times[i] / span, 2 * np.pi * frequency * times[i]
        columns[0, i], columns[1, i], columns[2, i] = 1.0, t, t * t
        columns[3, i], columns[4, i] = np.cos(angle), np.sin(angle)
        if double:
            columns[5, i], columns[6, i] = np.cos(2 * angle), np.sin(2 * angle)
    target = np.log(power)
    normal = columns @ columns.T
    for c in range(7):
        normal[c, c] += 1e-9 * n  # a column that is left out, or sine and cosine at half the frame rate, keep the system solvable
    right = columns @ target
    plain = columns[:3].T @ np.linalg.solve(normal[:3, :3].copy(), right[:3].copy())
    weights = np.linalg.solve(normal, right)
    lamp = columns[3:].T @ weights[3:]
    scene = columns[:3].T @ weights[:3]
    about, left = ((target - plain) ** 2).sum(), ((target - scene - lamp) ** 2).sum()
    if about <= 1e-12 * n:
        return 0.0, 0.0, 1.0
    amplitude = np.sqrt(weights[3] ** 2 + weights[4] ** 2)  # of log(1 + d sin): 2 (1 - sqrt(1 - d^2)) / d, so d = a / (1 + a^2 / 4)
    return 1 - left / about, amplitude / (1 + 0.25 * amplitude**2), np.exp(lamp[n - 1]) / np.exp(lamp).mean()
