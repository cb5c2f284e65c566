"""Transfer curves at the values that their standards print, their slopes where two branches meet, and what lies outside."""

import numpy as np
import pytest

from vemlight.light.transfers import TRANSFERS, hlg_system_gamma

PUBLISHED = [  # signal, light, relative tolerance (of the standards' own rounding)
    ("srgb", 0.5, 0.21404, 1e-4),
    ("bt709", 0.018 * 4.5, 0.018, 2e-3),
    ("bt709", 0.4090, 0.18, 1e-3),  # mid gray at 40.9 %
    ("bt1886", 0.5, 0.5**2.4, 1e-12),
    ("pq", 0.508078, 100.0, 1e-3),  # BT.2408-7, table 1: 100 cd/m2 at 50.8 %, 203 at 58.1 %, 1000 at 75.2 %
    ("pq", 0.580689, 203.0, 1e-3),
    ("pq", 0.751827, 1000.0, 1e-3),
    ("pq", 1.0, 10_000.0, 1e-9),
    ("hlg", 0.5, 1 / 12, 1e-9),  # BT.2100-2, table 5
    ("hlg", 1.0, 1.0, 1e-5),
    ("logc3", 0.391007, 0.18, 1e-4),  # ARRI 2012: mid gray
    ("logc4", 0.278396, 0.18, 1e-4),  # ARRI 2022, table 1
    ("slog3", 420 / 1023, 0.18, 1e-9),  # Sony 2014: 18 % at 420, 90 % at 598, 0 at 95
    ("slog3", 598 / 1023, 0.90, 5e-3),
    ("vlog", 433 / 1023, 0.18, 2e-3),  # Panasonic 2014: 18 % at 433, 90 % at 602
    ("vlog", 602 / 1023, 0.90, 1e-2),
    ("acescct", 0.413588, 0.18, 1e-4),
    ("linear", 0.3, 0.3, 0),
]


@pytest.mark.parametrize(("name", "signal", "light", "tolerance"), PUBLISHED)
def test_published_values(name, signal, light, tolerance):
    assert TRANSFERS[name].light_from_signal(np.array(signal)) == pytest.approx(light, rel=max(tolerance, 1e-15))


@pytest.mark.parametrize(("name", "signal"), [("slog3", 95 / 1023), ("vlog", 0.125), ("logc4", 95 / 1023 - 0.0928), ("acescct", 0.0729055)])
def test_black_is_where_the_makers_put_it(name, signal):
    assert abs(TRANSFERS[name].light_from_signal(np.array(signal))) < 2e-2


@pytest.mark.parametrize("name", sorted(TRANSFERS))
def test_curves_rise_without_a_step(name):
    """The largest step between neighbours is not far from those beside it: the branches meet."""
    signals = np.linspace(0, 1, 20_001)
    light = TRANSFERS[name].light_from_signal(signals)
    steps = np.diff(light)
    assert np.all(np.isfinite(light))
    assert np.all(steps >= 0)
    ratio = steps[2:] / np.maximum(np.maximum(steps[1:-1], steps[:-2]), 1e-9 * light.max())
    assert ratio[100:].max() < 1.6  # vlog is rounded by its maker; the first hundred of PQ are below 1e-5 cd/m2


@pytest.mark.parametrize("name", sorted(TRANSFERS))
def test_signals_outside_are_numbers(name):
    light = TRANSFERS[name].light_from_signal(np.array([-0.125, 1.125]))
    assert np.all(np.isfinite(light))
    assert light[0] <= 0.011 * TRANSFERS[name].light_from_signal(np.array(1.0))


def test_the_gamma_of_hlg_displays():
    assert hlg_system_gamma(1000) == pytest.approx(1.2)
    assert hlg_system_gamma(2000) == pytest.approx(1.326, abs=1e-3)  # BT.2390-8, table 5
    assert hlg_system_gamma(4000) == pytest.approx(1.2 * 1.111**2)
    assert hlg_system_gamma(400) == pytest.approx(1.033, abs=1e-3)
