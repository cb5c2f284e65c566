"""The number of lights under an error limit, and the error that is reported."""

from typing import Any

import numpy as np
import pytest

from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.sampler.error_limit import (
    LADDER_STEPS,
    LIMIT,
    NO_ESTIMATE,
    capped_text,
    estimate_after,
    estimate_of,
    extrapolated,
    is_capped,
    ladder,
    smallest_within,
)
from vemlight.sampler.hard_probes import HARD_PROBES, SLICES, hard_probes, relative_squares
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.sampler.tracking.tiles import tiles_from_map
from vemlight.settings import Sampler


def sky(seed):
    """A smooth sky with a few lamps and sometimes a sun."""
    generator = np.random.default_rng(seed)
    theta, phi = (np.arange(45) + 0.5) * np.pi / 90, (np.arange(180) + 0.5) * np.pi / 90
    directions = direction_from_angles(theta[:, None], phi[None])
    radiance = 0.3 + generator.uniform(0, 1) * directions[..., 2]
    for _ in range(int(generator.integers(2, 7))):
        axis = direction_from_angles(np.arccos(generator.random()), 2 * np.pi * generator.random())
        radiance = radiance + generator.lognormal(0, 1) * np.exp(generator.uniform(5, 300) * (directions @ axis - 1))
    radiance[10, 20] += generator.choice([0.0, 2e3])
    return (radiance[..., None] * generator.uniform(0.6, 1, 3)).astype(np.float32)


def error_elsewhere(radiance, lights):
    """The same error at other probes, from every cell of the map."""
    cells = tiles_from_map(radiance, "hemisphere", 100_000, NO_BRIGHT_CELLS)
    return float(np.sqrt(relative_squares(hard_probes("hemisphere", HARD_PROBES, 5 * HARD_PROBES), cells, lights).mean()))


def run(frames, **settings):
    options: dict[str, Any] = {"filter": "none", **settings}
    state, out = initial_state(), []
    for k, radiance in enumerate(frames):
        state, lights, report = step(Sampler(**options), state, SamplerInput(radiance, "hemisphere", k / 25))
        out.append((lights, report))
    return out


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("limit", [30.0, 10.0, 5.0])
def test_the_limit_holds_at_other_probes_and_so_does_the_estimate(limit, soft):
    for seed in range(100, 106):
        lights, report = run([sky(seed)], error_percent=limit, soft=soft, count=1024)[0]
        measured = error_elsewhere(sky(seed), lights)
        assert measured < limit / 100
        assert 0.8 * measured < report.error <= LIMIT * limit / 100


@pytest.mark.parametrize("soft", [False, True])
def test_the_lights_are_those_of_that_count_and_a_step_fewer_would_not_do(soft):
    lights, _ = run([sky(3)], error_percent=10.0, soft=soft, count=400)[0]
    sizes = ladder(400)
    k = int(np.flatnonzero(sizes == len(lights.ids))[0])
    (same, _), (fewer, _) = (run([sky(3)], count=int(size), soft=soft)[0] for size in (sizes[k], sizes[k - 1]))
    np.testing.assert_array_equal(lights.directions, same.directions)
    cells = tiles_from_map(sky(3), "hemisphere", 1024, NO_BRIGHT_CELLS)
    assert estimate_of(cells, fewer, "hemisphere").error > 0.9 * LIMIT * 0.1


@pytest.mark.parametrize("seed", [6, 12, 28])
def test_as_many_probes_decide_as_tell_whether_the_limit_is_kept(seed):
    """Three lamps of 2 to 5 degrees in the dark. By 1024 probes they take 13 lights, 512 and 27, which exceed what is reported."""
    generator = np.random.default_rng(seed)
    theta, phi = (np.arange(45) + 0.5) * np.pi / 90, (np.arange(180) + 0.5) * np.pi / 90
    directions, lamps = direction_from_angles(theta[:, None], phi[None]), np.full((45, 180, 3), 0.01, np.float32)
    for _ in range(3):
        axis = direction_from_angles(np.arccos(generator.random()), 2 * np.pi * generator.random())
        lamps[directions @ axis > np.cos(np.radians(generator.uniform(2, 5)))] = 10 ** generator.uniform(1, 3)
    lights, report = run([lamps], error_percent=5.0, count=512)[0]
    cells = tiles_from_map(lamps, "hemisphere", 100_000, NO_BRIGHT_CELLS)
    others = hard_probes("hemisphere", 16 * HARD_PROBES, 32 * HARD_PROBES)
    assert np.sqrt(relative_squares(others, cells, lights).mean()) < report.error <= LIMIT * 0.05
    assert len(lights.ids) <= 54


def test_an_estimate_says_its_standard_error_more_and_is_sure_two_of_them_less():
    uneven = NO_ESTIMATE._replace(squares=np.append(float(SLICES), np.zeros(SLICES - 1)))  # of mean 1 and deviation sqrt(SLICES - 1)
    assert uneven.error == pytest.approx(np.sqrt(2))
    even = NO_ESTIMATE._replace(squares=np.tile([0.9, 1.1], SLICES // 2))  # of deviation 0.1
    below = np.sqrt(1 - 2 * 0.1 / np.sqrt(SLICES - 1)) / LIMIT
    assert even.surely_exceeds(0.999 * below)
    assert not even.surely_exceeds(1.001 * below)


def test_a_sun_that_wanders_over_the_cells_takes_no_more_lights():
    """One probe in whose shadow half the sun is all that is seen tells nothing of the others: 128 lights would cut the sun."""
    theta, phi = (np.arange(90) + 0.5) * np.pi / 180, (np.arange(360) + 0.5) * np.pi / 180
    directions, frames = direction_from_angles(theta[:, None], phi[None]), []
    for k in range(14):
        sun = direction_from_angles(np.radians(86.0 - k), 4.002 + 0.005 * k)
        off_deg = np.degrees(np.arccos(np.clip(directions @ sun, -1, 1)))
        sky = 0.1 + 0.4 * sun[2] * (1 + 0.5 * np.clip(directions @ sun, 0, 1) ** 8) + 9e3 * np.clip(0.5 + (1 - off_deg) / 0.7, 0, 1)
        frames.append(np.repeat(sky[..., None], 3, axis=-1).astype(np.float32))
    out = run(frames, error_percent=5.0, filter="auto", count=512)
    assert max(len(lights.ids) for lights, _ in out) <= 32
    assert len({int(lights.ids[lights.irradiance[:, 1].argmax()]) for lights, _ in out}) == 1


def test_more_error_never_takes_more_lights():
    limits = (60.0, 40.0, 25.0, 15.0, 10.0, 8.0, 6.0)
    for seed in range(3):
        counts = [len(run([sky(seed)], error_percent=limit, count=512)[0][0].ids) for limit in limits]
        assert counts == sorted(counts)


def test_the_choice_is_monotone_whatever_the_errors():
    generator = np.random.default_rng(0)
    for _ in range(200):
        error_of = dict(zip(ladder(100).tolist(), generator.lognormal(-2, 0.5, len(ladder(100))), strict=True))
        counts = [smallest_within(limit, 100, error_of.__getitem__) for limit in (0.3, 0.2, 0.15, 0.1)]
        assert counts == sorted(counts)
        chosen = ladder(100).tolist().index(counts[2])
        octave = ladder(100).tolist()[chosen : chosen + LADDER_STEPS + 1]
        assert counts[2] == 100 or all(error_of[size] <= LIMIT * 0.15 for size in octave)


def test_an_unreachable_limit_takes_all_lights_and_says_so():
    lights, report = run([sky(1)], error_percent=0.1, count=30)[0]
    assert len(lights.ids) == 30
    assert is_capped(100 * report.error, 0.1)
    assert "0.1 %: 30 lights have" in capped_text(30, 100 * report.error, 0.1)
    assert not is_capped(4.1, 5.0)
    assert is_capped(4.3, 5.0)
    assert not is_capped(50.0, 0.0)


@pytest.mark.parametrize("most", [1, 2, 4, 5, 72, 1000])
def test_the_ladder_ends_where_it_should(most):
    sizes = ladder(most)
    assert sizes[-1] == most
    assert (np.diff(sizes) > 0).all()


def test_the_ladder_has_four_steps_an_octave_from_four_on():
    assert ladder(32).tolist() == [4, 5, 6, 7, 8, 10, 11, 13, 16, 19, 23, 27, 32]


def test_a_prediction_is_on_the_ladder_at_most_twice_the_number():
    assert extrapolated(64, 0.042, 0.05, 500) == 64
    assert extrapolated(64, 0.043, 0.05, 500) == 76
    assert extrapolated(64, 4.0, 0.05, 500) == 128
    assert extrapolated(64, 0.004, 0.05, 500) in ladder(8)
    assert extrapolated(64, 4.0, 0.05, 70) == 70


def test_one_slice_is_looked_at_while_nothing_happens_and_all_when_something_does():
    radiance = sky(4)
    lights, _ = run([radiance], count=24)[0]
    tiles = tiles_from_map(radiance, "hemisphere", 64, NO_BRIGHT_CELLS)
    whole = estimate_of(tiles, lights, "hemisphere")
    limit = 1.01 * whole.error / LIMIT
    assert estimate_after(NO_ESTIMATE, tiles, lights, "hemisphere", limit).part == 0
    after = whole
    for k in range(SLICES):
        after = estimate_after(after, tiles, lights, "hemisphere", limit)
        assert after.part == (k + 1) % SLICES
    assert after.error == pytest.approx(whole.error, rel=1e-4)
    assert estimate_after(after, tiles, lights, "hemisphere", 0.9 * limit).part == 0  # beyond the limit
    dark = np.append(lights.directions, [[0, 0, 1]], axis=0), np.append(lights.irradiance, [[0, 0, 0]], axis=0)
    other = LightSet.of(np.append(lights.ids, 99), *dark)
    assert estimate_after(whole, tiles, other, "hemisphere", 10.0).part == 0  # as true, but another number
    for brighter, part in ((1.02, 1), (1.04, 0)):
        changed = tiles_from_map(np.float32(brighter) * radiance, "hemisphere", 64, NO_BRIGHT_CELLS)
        more = lights._replace(irradiance=np.float32(brighter) * lights.irradiance)
        assert estimate_after(whole, changed, more, "hemisphere", 10.0).part == part
    turned = lights._replace(directions=lights.directions @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], np.float32))
    assert estimate_after(whole, tiles, turned, "hemisphere", 10.0).part == 0


@pytest.mark.parametrize("soft", [False, True])
def test_the_limit_holds_in_the_frame_in_which_a_lamp_comes_or_goes(soft):
    """Verified after the last choice, by all probes, not by what was seen of the last frames."""
    still = sky(8)
    lamp = still.copy()
    lamp[12:15, 90:93] += 0.5 * still.sum() / 9
    frames = [still] * 3 + [lamp] * 3 + [still] * 3
    for radiance, (lights, report) in zip(frames, run(frames, error_percent=8.0, soft=soft, count=512), strict=True):
        assert error_elsewhere(radiance, lights) < 0.08
        assert report.error <= LIMIT * 0.08


def test_the_number_settles_and_nothing_is_learnt_in_the_dark():
    out = run([sky(3)] * 30, error_percent=10.0, count=512)
    counts = [len(lights.ids) for lights, _ in out]
    assert len(set(counts)) <= 2
    assert len(set(counts[-5:])) == 1
    dark = run([np.zeros_like(sky(3))] * 3 + [sky(3)], error_percent=10.0, count=512)
    assert len(dark[-1][0].ids) == counts[0]


@pytest.mark.parametrize("soft", [False, True])
def test_two_lamps_in_the_dark_take_a_few_lights(soft):
    """One light for two lamps is wrong by many times what the dark side receives; that is no reason for dozens."""
    for seed in range(6):
        generator, radiance = np.random.default_rng(seed), np.zeros((45, 180, 3), np.float32)
        for row, col in zip(generator.integers(5, 39, 2), generator.integers(0, 174, 2), strict=True):
            radiance[row : row + 6, col : col + 6] = generator.lognormal(3, 1)
        counts = [len(lights.ids) for lights, _ in run([radiance] * 5, error_percent=40.0, count=512, soft=soft)]
        assert max(counts) <= 8


@pytest.mark.parametrize("sun", [0.0, 3e4])
def test_the_samples_of_a_warp_keep_the_limit_too(sun):
    radiance = sky(2)
    radiance[30, 60] += sun
    lights, report = run([radiance], method="havran-azimuth", error_percent=15.0, count=1024)[0]
    assert len(lights.ids) < 1024
    assert error_elsewhere(radiance, lights) < 0.15
    assert report.error == pytest.approx(error_elsewhere(radiance, lights), rel=0.15)
