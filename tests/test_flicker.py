import numpy as np
import pytest

from vemlight.sampler.light_map import light_map
from vemlight.sampler.temporal.flicker import (
    BLACK_FRAME,
    FIT_FRAMES,
    MIN_FIT_FRAMES,
    MOST_OF_MEAN,
    NO_FLICKER,
    block_powers,
    flicker_after,
    without_flicker,
)


def watch(times, power):
    state, out = NO_FLICKER, []
    for t, p in zip(times, power, strict=True):
        state = flicker_after(state, float(t), np.array([p]))
        out.append(state)
    return out


def lamp(times, hertz=100.0, depth=0.2, phase=0.3):
    return 1 + depth * np.sin(2 * np.pi * hertz * times + phase)


@pytest.mark.parametrize(
    ("fps", "hertz", "beat"), [(21, 100, 5), (21, 120, 6), (30, 100, 10), (24, 100, 4), (29.97, 100, 10.09), (23.976, 120, 0.12)]
)
def test_the_beat_of_lamps_with_the_frame_rate_is_found(fps, hertz, beat):
    times = np.arange(96) / fps
    found = watch(times, lamp(times, hertz))[-1]
    if beat < 1:
        assert found.beat_hz == 0  # so slow that it is a cloud to all that the camera sees
        return
    assert found.beat_hz == pytest.approx(beat, abs=0.05)
    assert found.lamp_hz == pytest.approx(hertz, abs=0.05)
    # At 30 fps the lamp's second harmonic, 200 Hz, beats at 10 Hz as well and cannot be distinguished from the first.
    assert found.depth == pytest.approx(0.2, rel=0.1 if round(fps) == 30 else 0.02)


@pytest.mark.parametrize(("fps", "hertz"), [(25, 100), (50, 100), (20, 100), (30, 120), (60, 120)])
def test_a_rate_that_divides_the_frequency_sees_none(fps, hertz):
    times = np.arange(96) / fps
    assert all(found.depth == 0 and found.excess == 1 for found in watch(times, lamp(times, hertz)))


@pytest.mark.parametrize("offset", [-0.3, -0.07, 0.13, 0.25])
def test_mains_and_clocks_may_be_a_little_off(offset):
    times = np.arange(128) / 21
    found = watch(times, lamp(times, 100 + offset))
    assert found[-1].lamp_hz == pytest.approx(100 + offset, abs=0.03)
    truth = lamp(times, 100 + offset)
    left = np.array([p / state.excess[0] for p, state in zip(truth, found, strict=True)])[FIT_FRAMES:]
    assert left.std() / left.mean() < 0.1 * 0.2 / np.sqrt(2)


def test_correction_removes_the_lamps_flicker_and_not_the_scenes_changes():
    # A cloud over tubes at 21 fps, with a rectified sine's second harmonic and late frames: the cloud stays, the beat goes.
    generator = np.random.default_rng(1)
    times = np.arange(150) / 21 + generator.uniform(-1e-4, 1e-4, 150)
    cloud = 2 + 0.5 * np.sin(2 * np.pi * 0.1 * times)
    power = cloud * (lamp(times, 100, 0.2) + 0.04 * np.cos(2 * np.pi * 200 * times))
    found = watch(times, power)
    left = np.array([p / state.excess[0] for p, state in zip(power, found, strict=True)])
    # A stamp that is 1e-4 s off is a phase 0.06 off, 1.3 % of a depth of 0.2.
    assert np.abs(left / cloud - 1)[FIT_FRAMES:].max() < 0.03
    assert np.abs(power / cloud - 1)[FIT_FRAMES:].max() > 0.2


@pytest.mark.parametrize("seed", range(5))
def test_noise_and_clouds_are_no_flicker(seed):
    generator = np.random.default_rng(seed)
    times = np.arange(200) / 21
    walk = 1 + 0.02 * np.cumsum(generator.standard_normal(200))
    for power in (1 + 0.05 * generator.standard_normal(200), np.abs(walk) + 0.1):
        assert np.mean([state.depth > 0 for state in watch(times, power)]) < 0.05


def test_few_frames_black_frames_and_gaps_show_no_flicker():
    times = np.arange(MIN_FIT_FRAMES - 1) / 21
    assert all(state.depth == 0 for state in watch(times, lamp(times)))
    black = watch(np.arange(60) / 21, np.zeros(60))
    assert all(state.excess == 1 and state.depth == 0 for state in black)
    times = np.arange(96) / 21
    state = watch(times, lamp(times))[-1]
    assert flicker_after(state, times[-1] + 5, np.ones(1)).depth == 0
    assert flicker_after(state, 0.0, np.ones(1)).depth == 0


def test_memory_is_bounded():
    times = np.arange(300) / 30
    assert len(watch(times, lamp(times))[-1].times_s) == FIT_FRAMES
    assert NO_FLICKER.times_s.size == 0


def test_tubes_beside_a_window_lose_their_flicker_and_the_window_keeps_its_light():
    window, tubes = np.zeros((30, 60, 3), np.float32), np.zeros((30, 60, 3), np.float32)
    window[20:28, 5:25], tubes[5:7, 35:55] = 2.0, 9.0
    state = NO_FLICKER
    for k in range(100):
        bright = 1 + 0.3 * np.sin(200 * np.pi * k / 21)
        light = light_map(window + np.float32(bright) * tubes, "hemisphere")
        state = flicker_after(state, k / 21, block_powers(light, True))
        if k >= FIT_FRAMES:
            np.testing.assert_allclose(without_flicker(light, state), window + tubes, rtol=0.01)
    assert block_powers(light, True).sum() == pytest.approx(light.power, rel=1e-12)
    assert block_powers(light, False) == pytest.approx([light.power])


def test_a_block_that_does_something_else_is_left_alone():
    # Five blocks flicker, one shows a lamp switched on and off by hand, one is dark at times.
    times, generator = np.arange(96) / 21, np.random.default_rng(3)
    others = np.stack([np.where(generator.random(96) < 0.5, 1.0, 2.0), np.where(times < 3, 0.0, 1.0)], axis=1)
    state = NO_FLICKER
    for t, one, pair in zip(times, lamp(times), others, strict=True):
        state = flicker_after(state, float(t), np.append(np.full(5, one), 0.1 * pair))
    assert state.excess[:5] == pytest.approx(lamp(times)[-1], rel=0.02)
    assert state.excess[5:] == pytest.approx(1, abs=0.02)


def test_flicker_is_found_after_a_second_and_fitted_over_64_frames():
    found = watch(np.arange(96) / 21, lamp(np.arange(96) / 21))
    assert [state.depth > 0 for state in found].index(True) == 24 - 1
    assert len(found[-1].times_s) == 64


@pytest.mark.parametrize(("beat", "found"), [(0.7, False), (0.8, False), (1.15, True), (1.5, True)])
def test_a_beat_slower_than_a_second_is_a_cloud(beat, found):
    fps = (100 - beat) / 5  # its fifth multiple lies `beat` below the lamp
    times = np.arange(96) / fps
    assert (watch(times, lamp(times))[-1].depth > 0) == found


@pytest.mark.parametrize(("depth", "found"), [(0.0018, False), (0.0027, False), (0.0033, True), (0.005, True)])
def test_a_depth_below_three_per_mille_is_not_reported(depth, found):
    times = np.arange(96) / 21
    assert (watch(times, lamp(times, depth=depth))[-1].depth > 0) == found


@pytest.mark.parametrize(
    ("explained", "before", "found"), [(0.45, 0.2, False), (0.6, 0.2, True), (0.6, 0.0, False), (0.7, 0.0, False), (0.82, 0.0, True)]
)
def test_flicker_is_found_at_three_quarters_of_the_variance_and_lost_at_half(explained, before, found):
    # A lamp in noise that leaves it that fraction of the variance, made exactly so by fitting the noise out of its span.
    times = np.arange(64) / 21
    state = watch(times[:-1], lamp(times[:-1], depth=0.02))[-1]
    cosine, sine = np.cos(200 * np.pi * times), np.sin(200 * np.pi * times)
    t = times - times[-1]
    span = np.stack([np.ones(64), t, t * t, cosine, sine, np.cos(400 * np.pi * times), np.sin(400 * np.pi * times)])
    noise = np.random.default_rng(0).standard_normal(64)
    noise -= span.T @ np.linalg.lstsq(span.T, noise, rcond=None)[0]
    signal = sine - span[:3].T @ np.linalg.lstsq(span[:3].T, sine, rcond=None)[0]
    noise *= np.sqrt((signal @ signal) / (noise @ noise) * (1 - explained) / explained)
    power = np.exp(0.02 * (signal + noise))
    state = state._replace(times_s=times[:-1], powers=power[:-1, None], lamps_hz=np.full(int(before > 0), 100.0))
    assert (flicker_after(state, float(times[-1]), power[-1:]).depth > 0) == found


@pytest.mark.parametrize(("explained", "part"), [(0.2, 0.0), (0.29, 0.0), (0.45, 0.5), (0.61, 1.0), (0.8, 1.0)])
def test_a_block_is_corrected_by_what_its_sines_explain(explained, part):
    # Nine blocks flicker alone; the last also has noise, in quadrature to all that is fitted.
    times = np.arange(64) / 21
    t = times - times[-1]
    sine = np.sin(200 * np.pi * times + 0.3)
    columns = [np.ones(64), t, t * t, *(f(w * times) for w in (200 * np.pi, 400 * np.pi) for f in (np.cos, np.sin))]
    span = np.stack(columns)
    noise = np.random.default_rng(1).standard_normal(64)
    noise -= span.T @ np.linalg.lstsq(span.T, noise, rcond=None)[0]
    signal = sine - span[:3].T @ np.linalg.lstsq(span[:3].T, sine, rcond=None)[0]
    noise *= np.sqrt((signal @ signal) / (noise @ noise) * (1 - explained) / explained)
    blocks = np.exp(0.1 * np.stack([sine] * 9 + [signal + noise], axis=1))
    state = NO_FLICKER
    for time_s, powers in zip(times, blocks, strict=True):
        state = flicker_after(state, float(time_s), powers)
    assert np.log(state.excess[9]) / np.log(state.excess[0]) == pytest.approx(part, abs=0.1)


def test_blocks_are_fifteen_degrees():
    even = light_map(np.ones((90, 360, 3), np.float32), "hemisphere")
    assert len(block_powers(even, True)) == 6 * 24


FRAMES_A_SECOND = (21.0, 24.0, 25.0, 29.97, 30.0, 50.0, 60.0)


def received(fps, count, generator, lost=0.2):
    """Times of the frames that arrive, with the jitter of their stamps."""
    times = np.arange(count) / fps
    return times[generator.random(count) >= lost] + generator.uniform(-1e-4, 1e-4)


def scene(kind, times, generator):
    """A log power: still with a sensor's noise, a random walk, clouds of half a second, or slow waves."""
    passed, n = np.diff(times, prepend=times[0]), len(times)
    if kind == "still":
        return 3e-3 * generator.standard_normal(n)
    if kind == "walk":
        return np.cumsum(0.02 * np.sqrt(25 * np.maximum(passed, 0) / 25) * generator.standard_normal(n))
    if kind == "clouds":
        power = np.zeros(n)
        for k in range(1, n):
            stays = np.exp(-passed[k] / 0.3)
            power[k] = stays * power[k - 1] + 0.1 * np.sqrt(1 - stays**2) * generator.standard_normal()
        return power
    slow, phase = generator.uniform(0.05, 1.5, 6), generator.uniform(0, 2 * np.pi, 6)
    return (0.06 / np.sqrt(slow) * np.sin(2 * np.pi * slow * times[:, None] + phase)).sum(axis=1) + 2e-4 * generator.standard_normal(n)


@pytest.mark.parametrize("fps", FRAMES_A_SECOND)
@pytest.mark.parametrize("kind", ["still", "walk", "clouds", "waves"])
def test_no_sky_flickers_when_a_fifth_of_its_frames_is_lost(fps, kind):
    for seed in range(4):
        generator = np.random.default_rng(seed)
        times = received(fps, 200, generator)
        assert all(found.depth == 0 for found in watch(times, np.exp(scene(kind, times, generator))))


@pytest.mark.parametrize("fps", FRAMES_A_SECOND)
@pytest.mark.parametrize("lost", [0.0, 0.2])
def test_lamps_of_both_mains_are_found_together_and_removed(fps, lost):
    generator = np.random.default_rng(1)
    times = received(fps, 200, generator, lost)
    seen = [hertz for hertz in (100.0, 120.0) if abs(hertz - np.round(hertz / fps) * fps) > 1]
    power = np.prod([lamp(times, hertz, 0.15, hertz) for hertz in seen], axis=0)
    found = watch(times, power)[FIT_FRAMES:]
    for state in found:
        np.testing.assert_allclose(np.sort(state.lamps_hz), seen, atol=0.1)
    left = np.array([p / state.excess[0] for p, state in zip(power[FIT_FRAMES:], found, strict=True)])
    assert left.std() < 0.15 * power[FIT_FRAMES:].std()


@pytest.mark.parametrize("depth", [0.9, 3.0, 300.0])
def test_a_block_is_corrected_by_no_more_than_a_lamp_can_do(depth):
    """Beside a lamp a weak block follows the beat: by 0.9 in the logarithm a lamp may, by 3 none does, and by 300 numbers end."""
    times = np.arange(64) / 21
    beat = np.sin(2 * np.pi * 100 * times)
    powers = np.stack([1 + 0.3 * beat, 1e-3 * np.exp(depth * (beat - 1))], axis=1)
    powers[:, 1] = np.maximum(powers[:, 1], 1e-300)
    state = NO_FLICKER
    for time_s, now in zip(times, powers, strict=True):
        state = flicker_after(state, time_s, now)
        assert np.isfinite(state.excess).all()
        assert (state.excess <= MOST_OF_MEAN).all()
        assert (state.excess >= BLACK_FRAME).all()
    assert state.depth > 0
    assert state.excess[0] != 1
    assert (state.excess[1] != 1) == (depth < 1)
