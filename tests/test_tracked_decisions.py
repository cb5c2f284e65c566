"""The tracked method's thresholds and rates, each by what it decides: a test fails where its number moves by half."""

import numpy as np
import pytest

from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.light.sphere import direction_from_angles
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import initial_state
from vemlight.sampler.step import step
from vemlight.sampler.tracking.cleaning import cleaned
from vemlight.sampler.tracking.noise import Noise, noise_after
from vemlight.sampler.tracking.split_merge import URGENT, Sites, best_splits, cheapest_pair, split_and_merge
from vemlight.sampler.tracking.tiles import tiles_from_map
from vemlight.sampler.tracking.tracked import initial_tracked, tracked_step
from vemlight.sampler.tracking.voronoi import cells_from_sites, lights_from_cells, root
from vemlight.settings import Sampler

ROWS, COLS = 30, 120
NO_AGES = np.zeros((0, 0), np.uint8)


def sky(turn=0.0, lamp=0.0):
    theta, phi = (np.arange(ROWS)[:, None] + 0.5) / ROWS * np.pi / 2, (np.arange(COLS)[None] + 0.5 + turn) / COLS * 2 * np.pi
    gray = (1 + np.cos(theta)) * (1.5 + np.cos(phi))
    gray[12:14, 40:42] += lamp
    return (gray[..., None] * [0.8, 1.0, 1.2]).astype(np.float32)


def settled(count, frames=12, radiance=None):
    """The state after some frames of light that stands still, and the time of the next frame."""
    state = initial_tracked()
    for k in range(frames):
        state, _, _ = tracked_step(count, state, SamplerInput(sky() if radiance is None else radiance, "hemisphere", k / 25))
    return state, frames / 25


def relative_energy(count, state, radiance):
    """The energy of the cells with which a frame begins, over squared power."""
    tiles = tiles_from_map(radiance, "hemisphere", count, NO_BRIGHT_CELLS)
    energy = (cells_from_sites(tiles, state.sites.directions).root_energy ** 2).sum()
    return energy / float(tiles.flux.sum(axis=1) @ LUMINANCE_WEIGHTS) ** 2


@pytest.mark.parametrize(("count", "first"), [(8, 32), (32, 128), (160, 400)])
def test_when_more_lights_are_wanted_a_frame_has_up_to_four_times_as_many(count, first):
    state, time_s = settled(count)
    _, lights, _ = tracked_step(400, state, SamplerInput(sky(), "hemisphere", time_s))
    assert len(lights.ids) == first


def test_a_new_light_leaves_its_parents_direction_with_a_time_constant_of_three_frames():
    state, time_s = settled(32)
    state, _, _ = tracked_step(33, state, SamplerInput(sky(), "hemisphere", time_s))
    later, _, _ = tracked_step(33, state, SamplerInput(sky(), "hemisphere", time_s + 0.12))
    (new,) = np.flatnonzero(state.sites.ids == state.sites.ids.max())
    assert np.abs(state.sites.offsets[new]).max() > 1e-3
    np.testing.assert_allclose(later.sites.offsets[new], state.sites.offsets[new] * np.exp(-1), rtol=1e-6)


@pytest.mark.parametrize(("times_mean", "changed"), [(1.6, False), (1.95, False), (2.05, True), (3.0, True)])
def test_light_that_has_twice_its_usual_energy_is_a_scene_change(times_mean, changed):
    state, time_s = settled(8, radiance=sky(lamp=300.0))
    energy = relative_energy(64, state, sky(lamp=300.0))
    assert energy > 1e-3
    state = state._replace(mean_energy=energy / times_mean)
    after, _, _ = tracked_step(32, state, SamplerInput(sky(lamp=300.0), "hemisphere", time_s))
    assert after.sites.offsets.any() == (not changed)  # after a scene change new lights are where their light is at once


def test_an_energy_below_two_per_cent_of_the_power_is_no_scene_change():
    seen = []
    for count in range(16, 200, 12):
        state, time_s = settled(count, 6)
        energy = relative_energy(2 * count, state, sky())
        after, _, _ = tracked_step(2 * count, state._replace(mean_energy=0.0), SamplerInput(sky(), "hemisphere", time_s))
        assert after.sites.offsets.any() == (energy <= 0.02**2)
        seen.append(energy / 0.02**2)
    assert any(0.6 < ratio < 1 for ratio in seen)
    assert any(1 < ratio < 1.7 for ratio in seen)


def test_the_mean_energy_moves_a_fifth_of_the_way_a_frame():
    state, time_s = settled(32)
    before = state._replace(mean_energy=10 * state.mean_energy)
    after, _, _ = tracked_step(32, before, SamplerInput(sky(), "hemisphere", time_s))
    energy = relative_energy(32, after, sky())
    assert after.mean_energy == pytest.approx(before.mean_energy + 0.2 * (energy - before.mean_energy), rel=1e-6)


def test_a_scene_change_is_met_by_six_exchanges_a_frame():
    state, time_s = settled(64)
    lit = sky()
    for k in range(16):  # lamps that come at once, more than are answered in a frame
        lit[3 + 4 * (k % 6), 7 * k : 7 * k + 2] += 1e4
    after, _, _ = tracked_step(64, state, SamplerInput(lit, "hemisphere", time_s))
    assert len(set(after.sites.ids) - set(state.sites.ids)) == 6


def test_sites_follow_a_sky_that_turns():
    state = initial_tracked()
    for k in range(40):
        state, _, _ = tracked_step(16, state, SamplerInput(sky(k), "hemisphere", k / 25))
    anew, _, _ = tracked_step(16, initial_tracked(), SamplerInput(sky(39), "hemisphere", 0.0))
    assert relative_energy(16, state, sky(39)) < 1.15 * relative_energy(16, anew, sky(39))


def test_in_slow_light_exchanges_come_eight_frames_apart():
    state, births = initial_tracked(), []
    for k in range(200):
        known = set(state.sites.ids)
        state, _, _ = tracked_step(32, state, SamplerInput(sky(k / 2, lamp=40.0), "hemisphere", k / 25))
        births += [k] * (k > 0) * len(set(state.sites.ids) - known)
    gaps = np.diff(births)
    assert len(births) >= 4
    assert gaps.min() >= 8
    assert gaps.min() <= 12


def test_the_first_frame_finds_its_number_at_once():
    settings, radiance = Sampler(error_percent=10.0, count=600, filter="none"), sky(lamp=200.0)
    state, counts = initial_state(), []
    for k in range(30):
        state, lights, _ = step(settings, state, SamplerInput(radiance, "hemisphere", k / 25))
        counts.append(len(lights.ids))
    assert counts[0] <= 1.25 * counts[-1]


def test_an_exchange_gains_twice_its_cost_and_half_a_mean_cell():
    state, _ = settled(24, 4)
    sites, gains_over_cost, gains_over_mean = state.sites, [], []
    for k in range(150):  # a lamp that comes, fainter or brighter
        lit = sky()
        lit[6 + k % 12, k % 118 : k % 118 + 2] += 60 * 1.03**k
        tiles = tiles_from_map(lit, "hemisphere", 24, NO_BRIGHT_CELLS)
        cells = cells_from_sites(tiles, sites.directions)
        (gain,), (cell,), _ = best_splits(tiles, sites.directions, cells, 1, False)
        cost, larger, smaller = cheapest_pair(sites.directions, cells)
        mean = (cells.root_energy**2).mean()
        exchanges, _, _ = split_and_merge(tiles, sites, cells, 1, URGENT, False)
        assert (exchanges > 0) == (gain >= 2 * cost + 0.5 * mean and cell not in (larger, smaller))
        gains_over_cost.append((gain - 0.5 * mean) / cost)
        gains_over_mean.append((gain - 2 * cost) / mean)
    # Some lie where half or twice either number would decide otherwise.
    assert any(1 < ratio < 2 for ratio in gains_over_cost)
    assert any(2 < ratio < 4 for ratio in gains_over_cost)
    assert any(0.25 < ratio < 0.5 for ratio in gains_over_mean)
    assert any(0.5 < ratio < 1 for ratio in gains_over_mean)


def test_the_weight_of_a_distance_is_worked_out_by_hand():
    # d / sqrt(d + 1 degree): at one degree 1 / sqrt(2) of its root, far away the root itself.
    degree = 0.0175
    assert root(degree) == pytest.approx(np.sqrt(degree / 2))
    assert root(1.0) == pytest.approx(1 / np.sqrt(1 + degree))


@pytest.mark.parametrize(("along", "moved"), [(-0.95, False), (-0.87, True)])
def test_a_direction_that_its_offset_nearly_cancels_is_shown_without_it(along, moved):
    radiance = np.zeros((ROWS, COLS, 3), np.float32)
    radiance[10, 20] = 1
    tiles = tiles_from_map(radiance, "hemisphere", 1, NO_BRIGHT_CELLS)
    directions = np.ascontiguousarray(tiles.direction.T / np.linalg.norm(tiles.direction.T))
    cells = cells_from_sites(tiles, directions)
    across = np.cross(directions[0], [0.0, 0.0, 1.0])
    offsets = along * directions + 0.02 * across / np.linalg.norm(across)
    shown, _ = lights_from_cells(tiles, cells.moment, cells.assignment, directions, offsets)
    assert (np.abs(shown - directions).max() > 0.01) == moved


def test_lloyd_weights_follow_radiance_to_the_power_of_eight_fifths():
    dim = np.ones((ROWS, COLS, 3), np.float32)
    one, two = (tiles_from_map(scale * dim, "hemisphere", 40, NO_BRIGHT_CELLS) for scale in (np.float32(1), np.float32(2)))
    np.testing.assert_allclose(two.weight / one.weight, 2**1.6, rtol=1e-5)


def test_a_light_of_even_sky_has_some_six_tiles_and_one_light_the_largest_tiles():
    even = np.ones((90, 360, 3), np.float32)
    assert 5 * 512 < len(tiles_from_map(even, "hemisphere", 512, NO_BRIGHT_CELLS).power) < 7 * 512
    assert len(tiles_from_map(even, "hemisphere", 1, NO_BRIGHT_CELLS).power) == 12 * 45  # of 8 x 8 cells


def test_a_sun_counts_for_four_lights_and_leaves_the_sky_its_tiles():
    # All of 64 lights would go to the sun's base tile; as four of them it leaves the sky tiles of 1/4 x 4/64 of the sun's density.
    radiance = sky()
    radiance[12, 40] = 1e7
    tiles = tiles_from_map(radiance, "hemisphere", 64, NO_BRIGHT_CELLS)
    assert 65 <= len(tiles.power) <= 75


def test_a_bright_cells_samples_have_the_weight_of_a_ninth_of_the_cell():
    radiance = np.ones((ROWS, COLS, 3), np.float32)
    radiance[10, 20] = 5000
    place = direction_from_angles(np.radians([31.2, 31.5, 31.8]), np.radians([61.2, 61.5, 61.8]))
    bright = BrightCells(np.full(3, 10 * COLS + 20), place.astype(np.float32), np.array([0.5, 0.3, 0.2], np.float32))
    tiles = tiles_from_map(radiance, "hemisphere", 400, bright)
    whole = tiles_from_map(radiance, "hemisphere", 400, NO_BRIGHT_CELLS)
    sun = np.flatnonzero(tiles.power > 0.1 * whole.power.max())
    np.testing.assert_allclose(tiles.power[sun] / whole.power.max(), [0.5, 0.3, 0.2], rtol=1e-5)
    np.testing.assert_allclose(tiles.radius[sun] / whole.radius[whole.power.argmax()], 1 / 3, rtol=1e-6)
    np.testing.assert_allclose(tiles.weight[sun] / whole.weight.max(), (1 / 9) * (9 * np.array([0.5, 0.3, 0.2])) ** 1.6, rtol=1e-5)


@pytest.mark.parametrize(("sigmas", "part"), [(0.1, 0.12), (1.5, 0.12), (2.1, 0.7**4), (2.7, 0.9**4), (3.05, 1.0)])
def test_changes_of_three_sigma_go_through_and_smaller_ones_in_part(sigmas, part):
    before, deviation = np.full((4, 8, 3), 2.0, np.float32), 0.02
    after = before * np.float32(1 + sigmas * deviation)
    clean, _, _ = cleaned(after, before, NO_AGES, deviation**2)
    np.testing.assert_allclose((clean - before) / (after - before), part, rtol=1e-3)


def test_the_noise_is_an_average_over_five_frames_without_the_scenes_changes():
    known, radiance = Noise(np.zeros((4, 2), np.float32), np.zeros((4, 2), np.float32), 0.01), np.ones((4, 8, 3), np.float32)
    known = noise_after(known, radiance)
    assert noise_after(known._replace(variance=0.01), radiance).variance == pytest.approx(0.008)
    # Alternating levels of relative distance d have the covariance -d^2 of consecutive changes, unless d is the scene's.
    for distance, counted in ((0.2, True), (0.28, True), (0.32, False), (0.5, False)):
        levels = [np.float32(1), np.float32((2 + distance) / (2 - distance))]
        noise = Noise(np.zeros((0, 0), np.float32), np.zeros((0, 0), np.float32), 0.0)
        for k in range(3):
            noise = noise_after(noise, levels[k % 2] * radiance)
        assert noise.variance == pytest.approx(0.2 * distance**2 if counted else 0.0, rel=1e-5)


@pytest.mark.parametrize(("gap_s", "bridged"), [(0.8, True), (0.98, True), (1.02, False), (1.5, False)])
def test_what_was_seen_over_a_second_ago_fills_no_gap(gap_s, bridged):
    state, time_s = settled(16)
    gap = sky()
    gap[5] = np.nan
    after, _, _ = tracked_step(16, state, SamplerInput(gap, "hemisphere", time_s - 0.04 + gap_s))
    assert after.clean is not None
    assert (after.clean[5] > 0).all() == bridged


def test_of_two_cells_none_is_split_since_both_would_be_merged():
    sites = Sites(np.arange(2), np.eye(3)[:2], np.zeros((2, 3)), 2)
    tiles = tiles_from_map(sky(), "hemisphere", 2, NO_BRIGHT_CELLS)
    count, after, _ = split_and_merge(tiles, sites, cells_from_sites(tiles, sites.directions), 4, URGENT, True)
    assert count == 0
    np.testing.assert_array_equal(after.ids, sites.ids)
