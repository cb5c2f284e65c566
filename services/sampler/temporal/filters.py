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

MAX_LEFT = 0.2  # of what is stopped, beyond which a line says so; the default's design leaves .16 at 60 frames a second. .17 to .3 would do
BAND_PROBES = 200  # of a band; its gain has order / 2 waves at most, 32


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

    A rate too low for the stop band has nothing above its half to remove: both bands are moved below it, and a line says so. Another one
    does where so few weights cannot hold both bands.
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
    made = _unit_sum(tuple(weights.tolist()))
    changed = max(abs(gain(made, hertz / rate_hz) - 1) for hertz in np.linspace(0, passed, BAND_PROBES))
    left = max(gain(made, hertz / rate_hz) for hertz in np.linspace(stop, half, BAND_PROBES))
    if left > MAX_LEFT or changed > 2 * MAX_LEFT:
        notice(
            f"filter fir: order {order} at {rate_hz:g} frames a second leaves up to {left:.0%} of what is faster than {stop:.3g} Hz, and "
            f"is off by up to {changed:.0%} below {passed:.3g} Hz; raise order, or set pass_hz and stop_hz further apart"
        )
    return made


def gain(weights: np.ndarray, cycles: float) -> float:
    """What is left of a sine wave of so many cycles a frame."""
    return float(abs((weights * np.exp(-2j * np.pi * cycles * np.arange(len(weights)))).sum()))


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
