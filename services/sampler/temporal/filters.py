"""The table of the filters over time, and the weights of those that are sums over past frames, newest first, each with the sum 1."""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vemlight.files import notice
from vemlight.settings import Sampler

# Havran et al. 2005, section 3.3, given there as a design for 21 Hz, 7 Hz pass, 9 Hz stop; in truth they are the equiripple
# design for 25 Hz, 7 Hz, 9.6 Hz, with a gain of 1.09245 at rest, which is divided out here.
PAPER_WEIGHTS = (0.06216, 0.01296, -0.13816, 0.28315, 0.65223, 0.28315, -0.13816, 0.01296, 0.06216)
BINOMIAL_WEIGHTS = (1.0, 4.0, 6.0, 4.0, 1.0)  # no negative weight, so nothing overshoots; half the paper's delay and a softer edge
MAX_STOP_OVER_NYQUIST = 0.9  # the stop band must have a width, and 0.9 of half the rate leaves the design some; any value in 0.8..0.95 does
MAX_PASS_OVER_STOP = 0.7  # the transition band as well, where the stop band had to be moved; any value in 0.6..0.8 does


class TemporalFilter(NamedTuple):
    """weights: of the newest frames, for the settings and a frame rate in Hz (0 when unknown); symmetric, so that the delay is half of
    their span. recursive: two low-passes instead, whose delay follows from `pass_hz`; the weights are then (1).
    """

    weights: Callable[[Sampler, float], np.ndarray]
    recursive: bool = False


def weights_from_settings(settings: Sampler, rate_hz: float) -> np.ndarray:
    """The weights of the filter that the settings name, read-only."""
    return filter_from_settings(settings).weights(settings, rate_hz)


def filter_from_settings(settings: Sampler) -> TemporalFilter:
    """The filter that the settings name; "auto" is the paper's."""
    return FILTERS["fir2005" if settings.filter == "auto" else settings.filter]


@lru_cache(maxsize=8)
def _unit_sum(weights: tuple[float, ...]) -> np.ndarray:
    result = np.array(weights) / np.sum(weights)
    result.setflags(write=False)
    return result


@lru_cache(maxsize=64)
def equiripple(order: int, pass_hz: float, stop_hz: float, rate_hz: float) -> np.ndarray:
    """The low-pass of `order` + 1 weights whose largest error in both bands is smallest (Parks and McClellan 1972), with gain 1 at rest.

    A rate too low for the stop band has nothing above its half to remove: both bands are moved below it, and a line says so.
    """
    from scipy.signal import firls, remez  # here, since it takes most of a second to import and only this filter needs it

    half = rate_hz / 2
    if half <= 0:
        return _unit_sum((1.0,))
    stop, passed = stop_hz, pass_hz
    if stop_hz > MAX_STOP_OVER_NYQUIST * half:
        stop = MAX_STOP_OVER_NYQUIST * half
        passed = min(pass_hz, MAX_PASS_OVER_STOP * stop)
        notice(
            f"filter fir: {rate_hz:g} frames a second show nothing above {half:g} Hz, so what passes ends at {passed:.3g} Hz and what is "
            f"stopped begins at {stop:.3g} Hz, instead of {pass_hz:g} and {stop_hz:g} Hz"
        )
    bands = [0, passed, stop, half]
    try:
        weights = remez(order + 1, bands, [1, 0], fs=rate_hz)
    except ValueError:  # where no ripple is left to make equal, Remez's exchange does not converge
        weights = firls(order + 1, bands, [1, 1, 0, 0], fs=rate_hz)
    return _unit_sum(tuple(weights.tolist()))


def _equiripple_from_settings(settings: Sampler, rate_hz: float) -> np.ndarray:
    # Two digits of the rate, so that jitter of the time stamps does not make a new design each frame.
    return equiripple(settings.order, settings.pass_hz, settings.stop_hz, float(f"{rate_hz:.2g}"))


def _constant(*weights: float) -> Callable[[Sampler, float], np.ndarray]:
    return lambda _settings, _rate_hz: _unit_sum(weights)


# By the names in the settings; "adaptive" is the tracked method's own smoothing (tracking/cleaning.py).
FILTERS: dict[str, TemporalFilter] = {
    "fir2005": TemporalFilter(_constant(*PAPER_WEIGHTS)),
    "fir": TemporalFilter(_equiripple_from_settings),
    "binomial": TemporalFilter(_constant(*BINOMIAL_WEIGHTS)),
    "iir": TemporalFilter(_constant(1.0), recursive=True),
    "none": TemporalFilter(_constant(1.0)),
}
