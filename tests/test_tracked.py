import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as limits
from hypothesis import strategies as st

from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage, angle_between, direction_from_angles, map_irradiance
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.tracking.tracked import TrackedReport, TrackedState, initial_tracked, tracked_step

ROWS, COLS = 30, 120


def scene(seed=0, sun=0.0):
    radiance = np.random.default_rng(seed).lognormal(0, 1, (ROWS, COLS, 3)).astype(np.float32)
    radiance[10, 60] += sun
    return radiance


def run(
    maps, count=32, coverage: Coverage = "hemisphere", smoothing=False, fps=25.0, bright_cells=NO_BRIGHT_CELLS
) -> tuple[list[tuple[LightSet, TrackedReport]], TrackedState]:
    state, out = initial_tracked(), []
    for k, radiance in enumerate(maps):
        state, lights, report = tracked_step(count, state, SamplerInput(radiance, coverage, k / fps, bright_cells), smoothing)
        out.append((lights, report))
    return out, state


def total(lights):
    return lights.irradiance.sum(axis=0, dtype=float)


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
@pytest.mark.parametrize("sun", [0.0, 1e6])
@pytest.mark.parametrize("count", [1, 2, 32, 200])
def test_the_lights_sum_to_the_map_in_every_channel(count, sun, coverage):
    out, _ = run([scene(sun=sun), scene(1, sun)], count, coverage)
    for seed, (lights, report) in enumerate(out):
        expected = map_irradiance(scene(seed, sun), coverage)
        np.testing.assert_allclose(total(lights), expected, rtol=1e-6)
        np.testing.assert_allclose(report.irradiance, expected, rtol=1e-12)
        assert len(lights.ids) == count


@given(st.integers(0, 2**32), st.integers(1, 150), st.sampled_from(["hemisphere", "sphere"]), st.booleans())
@limits(max_examples=30, suppress_health_check=[HealthCheck.too_slow])
def test_any_maps_any_count(seed, count, coverage, smoothing):
    generator = np.random.default_rng(seed)
    maps = []
    for _ in range(3):
        radiance = (generator.lognormal(0, generator.uniform(0, 4), (8, 16, 3)) * (generator.random((8, 16, 1)) < 0.3)).astype(np.float32)
        radiance.flat[generator.integers(0, radiance.size, 5)] = [np.nan, np.inf, -np.inf, -1.0, 1e35]
        maps.append(radiance)
    for (lights, report), radiance in zip(run(maps, count, coverage, smoothing)[0], maps, strict=True):
        if not smoothing:
            clean = np.where(np.isfinite(radiance) & (radiance >= 0) & (radiance < 1e30), radiance, 0)
            np.testing.assert_allclose(report.irradiance, map_irradiance(clean, coverage), rtol=1e-12)
        np.testing.assert_allclose(total(lights), report.irradiance, rtol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(lights.directions, axis=1), 1, atol=1e-6)
        assert len(np.unique(lights.ids)) == len(lights.ids) <= count
        assert np.isfinite(lights.irradiance).all()
        assert (lights.irradiance >= 0).all()
        if coverage == "hemisphere":
            assert lights.directions[:, 2].min() > -1e-6


def test_one_lit_cell_is_one_light_in_its_place_whatever_the_count():
    radiance = np.zeros((90, 360, 3), np.float32)
    radiance[30, 200] = [1.0, 2.0, 3.0]
    (lights, _), = run([radiance], 64)[0]
    assert len(lights.ids) == 1
    assert np.degrees(angle_between(lights.directions[0].astype(float), direction_from_angles(np.radians(30.5), np.radians(200.5)))) < 1e-4
    np.testing.assert_allclose(lights.irradiance[0] / lights.irradiance[0, 0], [1, 2, 3], rtol=1e-6)


def test_a_bright_cell_stands_where_its_sample_says():
    radiance = scene(sun=1e6)
    place = direction_from_angles(np.radians(31.9), np.radians(180.4))  # in cell (10, 60), whose centre is at (31.5, 181.5)
    bright = BrightCells(np.array([10 * COLS + 60]), place[None].astype(np.float32), np.ones(1, np.float32))
    (lights, _), = run([radiance], 32, bright_cells=bright)[0]
    brightest = lights.directions[lights.irradiance[:, 1].argmax()].astype(float)
    assert np.degrees(angle_between(brightest, place)) < 0.01


def test_a_bright_cell_is_cut_into_its_samples_when_there_are_lights_for_it():
    radiance = scene(sun=1e5)
    places = direction_from_angles(np.radians([30.4, 30.6, 32.5]), np.radians([180.2, 182.7, 181.5]))
    bright = BrightCells(np.full(3, 10 * COLS + 60), places.astype(np.float32), np.array([0.5, 0.3, 0.2], np.float32))
    (few, _), = run([radiance], 4, bright_cells=bright)[0]
    (many, _), = run([radiance], 100, bright_cells=bright)[0]
    sun = many.irradiance[:, 1] > 0.1 * total(many)[1]
    assert np.degrees(angle_between(many.directions[sun][:, None].astype(float), places)).min(axis=0).max() < 0.05
    assert (few.irradiance[:, 1] > 0.1 * total(few)[1]).sum() < 3
    for lights in (few, many):
        np.testing.assert_allclose(total(lights), map_irradiance(radiance, "hemisphere"), rtol=1e-6)


def test_two_equal_opposite_lamps():
    radiance = np.zeros((ROWS, COLS, 3), np.float32)
    radiance[29, [0, 60]] = 5.0
    lamps = direction_from_angles(np.radians(88.5), np.radians([1.5, 181.5]))
    (two, _), = run([radiance], 8)[0]
    order = np.argsort(-two.directions[:, 0])
    assert len(two.ids) == 2
    assert np.degrees(angle_between(two.directions[order].astype(float), lamps)).max() < 1e-3
    np.testing.assert_allclose(two.irradiance[0], two.irradiance[1], rtol=1e-6)
    # One light for both: the power of both, a direction that exists.
    (one, _), = run([radiance], 1)[0]
    np.testing.assert_allclose(total(one), total(two), rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(one.directions), 1, atol=1e-6)


def test_on_the_sphere_opposite_lamps_that_cancel_leave_the_light_where_its_site_is():
    radiance = np.zeros((30, 60, 3), np.float32)
    radiance[9, 0] = radiance[20, 30] = 5.0
    (one, _), = run([radiance], 1, "sphere")[0]
    np.testing.assert_allclose(np.linalg.norm(one.directions), 1, atol=1e-6)
    np.testing.assert_allclose(total(one), map_irradiance(radiance, "sphere"), rtol=1e-6)


def test_all_light_on_the_horizon_stays_above_it():
    radiance = np.zeros((ROWS, COLS, 3), np.float32)
    radiance[29] = np.random.default_rng(0).lognormal(0, 1, (COLS, 3))
    (lights, _), = run([radiance], 40)[0]
    assert lights.directions[:, 2].min() > 0
    assert np.degrees(np.arcsin(lights.directions[:, 2])).max() < 10
    np.testing.assert_allclose(total(lights), map_irradiance(radiance, "hemisphere"), rtol=1e-6)


@pytest.mark.parametrize("smoothing", [False, True])
def test_black_frames_keep_ids_and_places(smoothing):
    out, _ = run([scene()] * 3 + [np.zeros((ROWS, COLS, 3), np.float32)] * 4 + [scene()], smoothing=smoothing)
    before, dark, after = out[2][0], out[6][0], out[7][0]
    assert (dark.irradiance == 0).all()
    np.testing.assert_array_equal(dark.ids, before.ids)
    assert np.degrees(angle_between(dark.directions.astype(float), before.directions.astype(float))).max() < 3
    np.testing.assert_array_equal(after.ids, before.ids)
    np.testing.assert_allclose(total(after), total(before), rtol=1e-5)


def test_a_first_frame_that_is_black_gives_even_directions():
    (lights, _), = run([np.zeros((ROWS, COLS, 3), np.float32)])[0]
    assert (lights.irradiance == 0).all()
    assert np.abs(lights.directions.mean(axis=0) - [0, 0, 0.5]).max() < 0.05


def test_a_single_black_frame_is_ignored_and_two_in_a_row_are_taken_as_darkness():
    black = np.zeros((ROWS, COLS, 3), np.float32)
    powers = [total(lights)[0] for lights, _ in run([scene(), scene(), black, scene(), black, black, black], smoothing=True)[0]]
    np.testing.assert_allclose(powers[:6], powers[0], rtol=1e-5)
    assert powers[6] == 0


def test_invalid_cells_hold_their_last_valid_value():
    damaged = scene(sun=1e4)
    damaged[8:12, 58:62] = np.nan
    out, _ = run([scene(sun=1e4)] * 4 + [damaged], smoothing=True)
    assert out[4][1].invalid_cells == 16
    np.testing.assert_allclose(total(out[4][0]), total(out[3][0]), rtol=1e-5)


def test_step_is_a_pure_function_and_deterministic():
    _, state = run([scene(k) for k in range(3)], smoothing=True)
    radiance = scene(9, sun=1e3)
    before = radiance.copy()
    first = tracked_step(32, state, SamplerInput(radiance, "hemisphere", 0.2))
    tracked_step(32, first[0], SamplerInput(scene(10), "hemisphere", 0.24))
    again = tracked_step(32, state, SamplerInput(radiance, "hemisphere", 0.2))
    np.testing.assert_array_equal(radiance, before)
    for one, other in zip(first[1], again[1], strict=True):
        np.testing.assert_array_equal(one, other)


def settled(count):
    return run([scene(sun=500.0)] * 40, count)[1]


@pytest.mark.parametrize(("before", "after"), [(32, 33), (33, 32)])
def test_one_light_more_or_less_moves_one_other_light(before, after):
    state = settled(before)
    _, same, _ = tracked_step(before, state, SamplerInput(scene(sun=500.0), "hemisphere", 2.0), smoothing=False)
    _, changed, _ = tracked_step(after, state, SamplerInput(scene(sun=500.0), "hemisphere", 2.0), smoothing=False)
    shared, a, b = np.intersect1d(same.ids, changed.ids, return_indices=True)
    assert len(changed.ids) == after
    assert len(shared) == 32
    moved = np.degrees(angle_between(same.directions[a].astype(float), changed.directions[b].astype(float)))
    assert (moved > 3).sum() <= 2  # degrees; lights are 20 apart


def test_twice_as_many_lights_are_there_at_once_and_half_as_many_too():
    state, counts = settled(32), []
    for k, wanted in enumerate([64] * 20 + [16]):
        state, lights, _ = tracked_step(wanted, state, SamplerInput(scene(sun=500.0), "hemisphere", 2 + k / 25))
        counts.append(len(lights.ids))
    assert counts[:20] == [64] * 20
    assert counts[20] == 16


def test_a_lamp_that_comes_on_gets_its_light_at_once_and_no_other_jumps():
    lit = scene()
    i, j = np.mgrid[:ROWS, :COLS]
    lamp = (np.abs(i - 12) < 2) & (np.abs(j - 80) < 2)
    lit[lamp] += 300.0
    place = direction_from_angles(np.radians(37.5), np.radians(241.5))
    state = run([scene()] * 10, smoothing=True)[1]
    _, before, _ = tracked_step(32, state, SamplerInput(scene(), "hemisphere", 0.4))
    _, after, _ = tracked_step(32, state, SamplerInput(lit, "hemisphere", 0.4))
    lamps = np.degrees(angle_between(after.directions.astype(float), place)) < 8
    added = total(after)[1] - total(before)[1]
    assert after.irradiance[lamps, 1].sum() > 0.9 * added
    _, a, b = np.intersect1d(before.ids, after.ids, return_indices=True)
    moved = np.degrees(angle_between(before.directions[a].astype(float), after.directions[b].astype(float)))
    assert ((moved > 10) & ~lamps[b]).sum() <= 2


def test_lights_go_with_the_lamps_of_a_turning_sky():
    sky = np.full((ROWS, COLS, 3), 0.01, np.float32)
    for k in range(8):
        sky[4 + 3 * k : 6 + 3 * k, 14 * k : 14 * k + 2] = 20.0
    out, _ = run([np.roll(sky, k, axis=1) for k in range(20)], 10)
    first, last = out[0][0], out[-1][0]
    _, a, b = np.intersect1d(first.ids, last.ids, return_indices=True)
    lamps = first.irradiance[a, 1] > 0.05 * total(first)[1]
    assert lamps.sum() >= 8
    angle = np.radians(19 * 3)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    away = np.degrees(angle_between(first.directions[a].astype(float) @ turn.T, last.directions[b].astype(float)))
    assert (away[lamps] < 2).sum() >= 7


def test_error_falls_with_the_number_of_lights():
    from vemlight.sampler.probes import irradiance_of_lights, irradiance_of_map, probes

    at, errors = probes(300, "hemisphere"), []
    for count in (4, 16, 64):
        square = 0.0
        for seed in range(3):
            sky = np.random.default_rng(seed).lognormal(0, 1.5, (10, 40, 3)).repeat(3, axis=0).repeat(3, axis=1).astype(np.float32)
            (lights, _), = run([sky], count)[0]
            truth = irradiance_of_map(at, sky.astype(float), "hemisphere")
            square += np.mean((irradiance_of_lights(at, lights.directions, lights.irradiance) / truth.mean() - truth / truth.mean()) ** 2)
        errors.append(np.sqrt(square / 3))
    assert errors[0] > 1.5 * errors[1] > 2.25 * errors[2]


def test_another_coverage_begins_anew():
    _, state = run([scene()] * 3)
    _, lights, _ = tracked_step(32, state, SamplerInput(scene(), "sphere", 0.12))
    np.testing.assert_allclose(total(lights), map_irradiance(scene(), "sphere"), rtol=1e-6)
    assert lights.directions[:, 2].min() < -0.5
