from functools import partial
from typing import get_args, get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as limits
from hypothesis import strategies as st
from scipy.signal import remez

from vemlight.sampler.temporal.filters import FILTERS, PAPER_WEIGHTS, equiripple, weights_from_settings
from vemlight.settings import Sampler as Settings

Sampler = partial(Settings, method="havran-azimuth")  # the filters, gloss set and clusters of 2005


def gain(taps: np.ndarray, hertz: float, rate: float) -> float:
    return float(abs((taps * np.exp(-2j * np.pi * hertz / rate * np.arange(len(taps)))).sum()))


def test_the_papers_taps_are_a_design_for_25_hertz_not_for_21():
    as_found = remez(9, [0, 7, 9.6, 12.5], [1, 0], fs=25)
    assert np.abs(as_found - PAPER_WEIGHTS).max() < 1e-5
    as_written = remez(9, [0, 7, 9, 10.5], [1, 0], fs=21)
    assert np.abs(as_written - PAPER_WEIGHTS).max() > 0.05
    assert sum(PAPER_WEIGHTS) == pytest.approx(1.09245, abs=1e-5)


def test_the_papers_taps_are_normalised():
    taps = weights_from_settings(Sampler(filter="fir2005"), 25.0)
    np.testing.assert_allclose(taps[:5], [0.05690, 0.01186, -0.12647, 0.25919, 0.59703], atol=5e-6)


def test_binomial_never_overshoots():
    taps = weights_from_settings(Sampler(filter="binomial"), 21.0)
    np.testing.assert_allclose(taps, np.array([1, 4, 6, 4, 1]) / 16)
    assert [gain(taps, f, 21) for f in (2, 5, 7)] == pytest.approx([0.834, 0.29, 0.06], abs=0.01)


@pytest.mark.parametrize("name", ["none", "iir"])
def test_what_is_no_sum_over_frames_has_one_weight(name):
    assert weights_from_settings(Sampler(filter=name), 25.0).tolist() == [1.0]


@given(st.floats(1, 1000), st.integers(1, 32).map(lambda half: 2 * half), st.floats(0.1, 100), st.floats(1.05, 5))
@limits(max_examples=60)
def test_any_rate_order_and_band_gives_a_filter(rate, order, pass_hz, above):
    taps = weights_from_settings(Sampler(filter="fir", order=order, pass_hz=pass_hz, stop_hz=pass_hz * above), rate)
    assert taps.shape == (order + 1,)
    assert taps.sum() == pytest.approx(1, abs=1e-12)
    # A filter that is 1/2 everywhere is off by 1/2 in both bands, so the best is off by no more, and with gain 1 at rest it amplifies by at
    # most 1.5 / 0.5; by Parseval and Cauchy its weights' sizes then have at most this sum. Where Remez did not converge they have any.
    assert np.abs(taps).sum() < 3 * np.sqrt(order + 1)


DESIGNS = [(8, 3.0, 6.0, 60.0, False), (8, 3.0, 6.0, 120.0, True), (54, 1.125, 1.18, 32.0, True)]


@pytest.mark.parametrize(("order", "passed", "stop", "rate", "said"), DESIGNS)
def test_a_design_that_cannot_hold_its_bands_is_said(order, passed, stop, rate, said, capsys):
    equiripple.cache_clear()
    taps = equiripple(order, passed, stop, rate)
    line = capsys.readouterr().err
    left = max(gain(taps, f, rate) for f in np.linspace(stop, rate / 2, 2000))
    assert (left > 0.2) == said
    assert (f"leaves up to {left:.0%}" in line) == said
    assert line.count("\n") == said


def test_the_band_is_kept_and_the_rest_removed():
    for rate in (21.0, 25.0, 30.0):
        taps = equiripple(16, 3.0, 6.0, rate)
        assert [gain(taps, f, rate) for f in (1, 2, 3)] == pytest.approx([1, 1, 1], abs=0.08)
        assert max(gain(taps, f, rate) for f in (6, 8, rate / 2)) < 0.05


@pytest.mark.parametrize(("passed", "stop"), [(7.0, 9.0), (7.0, 9.6), (3.0, 6.0), (2.0, 11.0)])
def test_the_bands_are_those_that_were_asked_for(passed, stop, capsys):
    # The equiripple design: the gain leaves what it has in the pass band just behind its end, and reaches the stop band's at its start.
    taps = equiripple(24, passed, stop, 25.0)
    ripple = max(abs(gain(taps, f, 25.0) - 1) for f in np.linspace(0, passed, 200))
    left = max(gain(taps, f, 25.0) for f in np.linspace(stop, 12.5, 200))
    assert 1 - gain(taps, passed + 0.15 * (stop - passed), 25.0) > ripple
    assert gain(taps, stop - 0.15 * (stop - passed), 25.0) > left
    assert not capsys.readouterr().err


def test_bands_above_half_the_rate_are_moved_and_a_line_says_so(capsys):
    equiripple.cache_clear()
    equiripple(8, 7.0, 9.0, 16.0)
    assert "ends at 5.04 Hz and what is stopped begins at 7.2 Hz, instead of 7 and 9 Hz" in capsys.readouterr().err


def test_an_unknown_rate_filters_nothing():
    assert weights_from_settings(Sampler(filter="fir"), 0.0).tolist() == [1.0]


def test_at_a_low_rate_the_bands_lie_below_half_of_it():
    # At 6 frames a second nothing above 3 Hz is seen: the stop band begins at 2.7 Hz and what is below 1.9 Hz is kept.
    weights = equiripple(16, 3.0, 6.0, 6.0)
    assert gain(weights, 1.5, 6.0) > 0.8
    assert gain(weights, 2.8, 6.0) < 0.2


def test_the_table_has_the_filters_of_the_settings():
    names = set(get_args(get_type_hints(Settings)["filter"]))
    assert set(FILTERS) == names - {"auto", "adaptive"}  # the paper's by another name, and the tracked method's own smoothing
