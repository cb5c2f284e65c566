"""Weights of the filters over time that are sums over past frames, newest first, each with the sum 1."""

from functools import lru_cache

import numpy as np
from scipy.signal import remez

from vemlight.settings import Sampler

# Havran et al. 2005, section 3.3, given there as a design for 21 Hz, 7 Hz pass, 9 Hz stop; in truth they are the equiripple
# design for 25 Hz, 7 Hz, 9.6 Hz, with a gain of 1.09245 at rest, which is divided out here.
PAPER = (0.06216, 0.01296, -0.13816, 0.28315, 0.65223, 0.28315, -0.13816, 0.01296, 0.06216)
BINOMIAL = (1.0, 4.0, 6.0, 4.0, 1.0)  # no negative weight, so nothing overshoots; half the paper's delay and a softer edge


def taps_from_settings(settings: Sampler, rate_hz: float) -> np.ndarray:
    """The weights of the filter named in the settings for frames at `rate_hz` (0 when unknown), read-only; "iir" and "none": one weight."""
    if settings.filter in ("auto", "fir2005"):
        return _unit_sum(PAPER)
    if settings.filter == "binomial":
        return _unit_sum(BINOMIAL)
    if settings.filter == "fir":
        # Two digits of the rate: time stamps that shake do not make a new design each frame.
        return equiripple(settings.order, settings.pass_hz, settings.stop_hz, float(f"{rate_hz:.2g}"))
    return _unit_sum((1.0,))


@lru_cache(maxsize=8)
def _unit_sum(weights: tuple[float, ...]) -> np.ndarray:
    result = np.array(weights) / np.sum(weights)
    result.setflags(write=False)
    return result


@lru_cache(maxsize=64)
def equiripple(order: int, pass_hz: float, stop_hz: float, rate_hz: float) -> np.ndarray:
    """The low-pass of `order` + 1 weights whose largest error in both bands is smallest (Parks and McClellan 1972), with gain 1 at rest.

    A rate too low for the bands has nothing above its half to remove: the bands are moved below it. pass_hz is at most 0.7 stop_hz.
    """
    half = rate_hz / 2
    if half <= 0:
        return _unit_sum((1.0,))
    stop = min(stop_hz, 0.9 * half)
    passed = min(pass_hz, 0.7 * stop)
    return _unit_sum(tuple(remez(order + 1, [0, passed, stop, half], [1, 0], fs=rate_hz).tolist()))
