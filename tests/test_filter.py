from functools import partial

import numpy as np
import pytest
from numpy.typing import ArrayLike

from vemlight.sampler.temporal.filter import EMPTY_MEMORY, FilterFrame, filtered
from vemlight.sampler.temporal.filters import weights_from_settings
from vemlight.settings import Sampler as Settings

Sampler = partial(Settings, method="havran-azimuth")  # the filters, gloss set and clusters of 2005

PAPER = Sampler(filter="fir2005")
TAPS = weights_from_settings(PAPER, 25.0)
UP = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0])


def frame(time_s, power=1.0, light: ArrayLike = UP):
    return FilterFrame(time_s, np.full(3, float(power)), np.array(light, float).reshape(-1, 6))


def run(frames, settings=PAPER):
    memory, out = EMPTY_MEMORY, []
    for one in frames:
        memory, result, _, _ = filtered(settings, memory, one, 0.0)
        out.append(result)
    return out, memory


def test_the_papers_taps_have_gain_one_at_rest_and_their_published_response():
    assert TAPS.sum() == pytest.approx(1, abs=1e-15)
    # |H| at 21 Hz as worked out from the published taps after normalisation.
    expected = {0: 1, 2: 0.844, 5: 0.989, 7: 0.431, 8: 0.100, 9: 0.058, 10: 0.085, 10.5: 0.084}
    for hertz, gain in expected.items():
        assert abs((TAPS * np.exp(-2j * np.pi * hertz / 21 * np.arange(9))).sum()) == pytest.approx(gain, abs=6e-4)


def test_an_even_sequence_gets_the_plain_fir():
    x = np.random.default_rng(1).random(40) + 1
    out, _ = run([frame(k / 25, p) for k, p in enumerate(x)])
    plain = np.convolve(np.concatenate([np.full(8, x[0]), x]), TAPS, "valid")
    np.testing.assert_allclose([f.power[0] for f in out], plain, rtol=1e-9)


def test_light_switched_off_keeps_its_energy_and_is_never_negative():
    # The plain response is 1, .943, .931, 1.058, .799, .202, -.0577, .069, .057, 0; the negative lobe is owed to the next frames.
    for lit in (1, 2, 10):
        x = [0.0] * 9 + [1.0] * lit + [0.0] * 20
        out, memory = run([frame(k / 25, p) for k, p in enumerate(x)])
        power = np.array([f.power[1] for f in out])
        assert power.min() >= 0
        # In the dark there is nothing to take the last lobe from, at most .0577 of a frame's light: it waits for the next light.
        assert -0.058 < memory.debt[1] <= 0
        assert power.sum() + memory.debt[1] == pytest.approx(lit, abs=1e-12)
        out, memory = run([frame(k / 25, p) for k, p in enumerate([*x, *[0.1] * 20])])
        np.testing.assert_allclose(memory.debt, 0, atol=1e-12)
        plain = np.convolve(np.concatenate([np.zeros(8), x, [0.1] * 20]), TAPS, "valid")
        assert sum(f.power[1] for f in out) == pytest.approx(plain.sum(), rel=1e-12)


def test_the_delay_is_half_the_order():
    memory, _, _, _ = filtered(PAPER, EMPTY_MEMORY, frame(0.0), 0.0)
    _, _, delay_s, _ = filtered(PAPER, memory, frame(0.04), 0.0)
    assert delay_s == pytest.approx(0.16)


def test_a_lost_frame_is_bridged_and_a_long_gap_starts_anew():
    ramp = [frame(k / 25, k) for k in range(30) if k not in (20, 22, 23)]
    out, _ = run(ramp)
    for one, result in zip(ramp[12:], out[12:], strict=True):
        assert result.power[0] == pytest.approx(one.power[0] - 4, abs=1e-9)  # a ramp comes out as a ramp, four frames late
    out, _ = run([*ramp, frame(10.0, 500.0)])
    assert out[-1].power[0] == pytest.approx(500)


def test_time_that_runs_backwards_starts_anew():
    out, _ = run([frame(5.0, 1.0), frame(5.04, 1.0), frame(0.0, 7.0)])
    assert out[-1].power[0] == pytest.approx(7)


def test_late_frames_do_not_change_a_steady_motion():
    generator = np.random.default_rng(2)
    times = np.cumsum(0.04 + 0.01 * generator.uniform(-1, 1, 60))
    out, _ = run([frame(t, 3 + 2 * t) for t in times])
    lag = np.array([3 + 2 * t - f.power[0] for t, f in zip(times, out, strict=True)])[12:] / 2
    assert np.abs(lag - 0.16).max() < 0.02  # the delay in s, within the period's own uncertainty


def test_directions_never_vanish_nor_sink_below_the_horizon():
    horizon, zenith, back = [1.0, 0, 0], [0.0, 0, 1], [-1.0, 0, 0]
    blip = [horizon] * 9 + [[np.cos(1.4), 0, np.sin(1.4)]] + [horizon] * 9
    cases = [[horizon] * 9 + [zenith] * 9, blip, [horizon, back] * 12, [horizon] * 9 + [back] * 9]
    for case in cases:
        out, _ = run([frame(k / 25, 1.0, [*d, 1, 1, 1]) for k, d in enumerate(case)])
        directions = np.concatenate([f.lights[:, :3] for f in out])
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-12)
        assert directions[:, 2].min() >= 0


def test_new_lights_begin_where_they_are_and_others_stay():
    memory, before, _, _ = filtered(PAPER, EMPTY_MEMORY, frame(0.0, 1.0, [UP]), 0.0)
    side = np.array([1.0, 0, 0, 0.5, 0.5, 0.5])
    memory, out, _, _ = filtered(PAPER, memory, frame(0.04, 1.0, [UP, side]), 0.0)
    np.testing.assert_allclose(out.lights, [UP, side], atol=1e-12)
    _, out, _, _ = filtered(PAPER, memory, frame(0.08, 1.0, [UP]), 0.0)
    np.testing.assert_allclose(out.lights, before.lights, atol=1e-12)


def test_memory_does_not_grow_and_old_memories_stay_valid():
    memory = EMPTY_MEMORY
    for k in range(200):
        old, now = memory, frame(k / 25, 1 + k % 3)
        memory, first, _, _ = filtered(PAPER, old, now, 0.0)
        again = filtered(PAPER, old, now, 0.0)[1]
        np.testing.assert_array_equal(first.power, again.power)
        assert len(memory.frames) <= 11
    for k in range(200):  # a burst of frames in the time of one
        memory, _, _, _ = filtered(PAPER, memory, frame(8 + k * 1e-4), 0.0)
        assert len(memory.frames) <= 50


@pytest.mark.parametrize("name", ["fir2005", "fir", "binomial", "iir", "none"])
def test_every_filter_leaves_rest_alone_and_follows_a_step(name):
    settings = Sampler(filter=name)
    out, memory = run([frame(k / 25, 2.0 if k < 20 else 5.0) for k in range(60)], settings)
    assert out[19].power[0] == pytest.approx(2, rel=1e-9)
    assert out[-1].power[0] == pytest.approx(5, rel=1e-6)
    assert min(f.power[0] for f in out) > 0
    delay_s = filtered(settings, memory, frame(2.4, 5.0), 0.0).delay_s
    # The step's centre of gravity lies the delay later: sum over frames of what is missing, over the step.
    missing = sum(5 - f.power[0] for f in out[20:]) / 3 / 25
    assert missing == pytest.approx(delay_s, abs=1e-6)


@pytest.mark.parametrize("name", ["binomial", "iir", "none"])
def test_filters_without_negative_weights_never_overshoot(name):
    generator = np.random.default_rng(3)
    powers = generator.lognormal(0, 2, 80)
    out, _ = run([frame(k / 25, p) for k, p in enumerate(powers)], Sampler(filter=name))
    assert max(f.power[0] for f in out) <= powers.max()
    assert min(f.power[0] for f in out) >= powers.min()


def test_the_two_low_passes_have_half_the_power_at_their_edge_and_ignore_the_frame_rate():
    for rate in (200.0, 1000.0):
        times = np.arange(int(4 * rate)) / rate
        out, _ = run([frame(t, 1 + 0.5 * np.sin(2 * np.pi * 3 * t)) for t in times], Sampler(filter="iir", pass_hz=3.0))
        swing = np.ptp([f.power[0] for f in out[len(out) // 2 :]]) / 2
        assert swing / 0.5 == pytest.approx(np.sqrt(0.5), rel=0.02)


def test_another_filter_takes_over_without_a_jump():
    memory, last = EMPTY_MEMORY, None
    for k in range(60):
        settings = [PAPER, Sampler(filter="binomial"), Sampler(filter="iir"), Sampler(filter="fir")][k // 15]
        memory, out, _, _ = filtered(settings, memory, frame(k / 25, 10 + k), 0.0)
        if last is not None and k > 12:  # past the beginning of the ramp, where the 2005 taps undershoot
            assert abs(out.power[0] - last - 1) < 3.2  # a ramp of 1 a frame; the delays differ by up to three frames
        last = out.power[0]


@pytest.mark.parametrize("name", ["fir2005", "iir"])
def test_a_covered_frame_does_not_steer_the_lights(name):
    away = np.array([1.0, 0, 0, 1, 1, 1])
    frames = [frame(k / 25, 1e-5 if k == 20 else 1.0, away if k == 20 else UP) for k in range(40)]
    out, _ = run(frames, Sampler(filter=name))
    np.testing.assert_allclose(np.concatenate([f.lights for f in out]), np.tile(UP, (40, 1)), atol=1e-9)


def test_below_the_horizon_is_allowed_on_the_sphere():
    down = np.array([0.0, 0, -1, 1, 1, 1])
    _, out, _, _ = filtered(Sampler(), EMPTY_MEMORY, frame(0.0, 1.0, down), -1.0)
    np.testing.assert_allclose(out.lights, [down], atol=1e-12)


@pytest.mark.parametrize(("power", "steers"), [(5e-4, False), (9e-4, False), (1.1e-3, True), (2e-3, True)])
def test_a_frame_of_a_thousandth_of_the_power_does_not_steer_the_lights(power, steers):
    away = np.array([1.0, 0, 0, 1, 1, 1])
    frames = [frame(k / 25, power if k == 20 else 1.0, away if k == 20 else UP) for k in range(25)]
    out, _ = run(frames, Sampler(filter="binomial"))
    assert (np.abs(out[20].lights - UP).max() > 0.01) == steers


@pytest.mark.parametrize(("gap_s", "anew"), [(0.9, False), (0.98, False), (1.02, True), (1.5, True)])
def test_after_a_gap_of_a_second_a_filter_starts_anew(gap_s, anew):
    out, _ = run([*(frame(k / 25, 1.0) for k in range(20)), frame(0.76 + gap_s, 5.0)], Sampler(filter="iir", pass_hz=0.1))
    assert (out[-1].power[0] == 5.0) == anew


@pytest.mark.parametrize(("lost", "period_s"), [(3, 0.04), (4, 0.06), (5, 0.08)])
def test_the_period_is_the_median_of_eight_intervals(lost, period_s):
    times = np.cumsum([0.04] * 20 + [0.08] * lost)
    memory = EMPTY_MEMORY
    for time_s in times:
        memory, _, _, period = filtered(PAPER, memory, frame(float(time_s)), 0.0)
    assert period == pytest.approx(period_s)
