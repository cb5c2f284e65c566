import numpy as np
import pytest

from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.sphere import Coverage, cell_directions, map_irradiance
from vemlight.sampler.tracking.cleaning import cleaned
from vemlight.sampler.tracking.noise import NO_NOISE, noise_after
from vemlight.sampler.tracking.tiles import grid, tiles_from_map
from vemlight.sampler.tracking.voronoi import Assignment, assign


def sky(seed, rows=36, cols=90):
    radiance = np.random.default_rng(seed).lognormal(0, 1.5, (rows, cols, 3)).astype(np.float32)
    radiance[np.random.default_rng(seed + 1).random((rows, cols)) < 0.2] = 0
    return radiance


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
@pytest.mark.parametrize("count", [1, 64, 1000])
def test_tiles_hold_the_map_and_its_moment(count, coverage: Coverage):
    radiance = sky(0)
    total = map_irradiance(radiance, coverage)
    tiles = tiles_from_map(radiance, coverage, count, NO_BRIGHT_CELLS)
    np.testing.assert_allclose(tiles.flux.sum(axis=1), total, rtol=1e-12)
    np.testing.assert_allclose(tiles.power, luminance_from_rgb(tiles.flux.T), rtol=1e-12)
    of = grid(36, 90, coverage)
    moment = np.einsum("ij,i,ijc->c", luminance_from_rgb(radiance.astype(float)), of.solid_angles, cell_directions(36, 90, coverage))
    # Directions weigh cells by their luminance in float32, which rounds by 6e-8.
    np.testing.assert_allclose(tiles.direction @ tiles.power, moment, atol=6e-8 * tiles.power.sum())


def test_more_lights_get_finer_tiles():
    counts = [len(tiles_from_map(sky(0), "hemisphere", n, NO_BRIGHT_CELLS).power) for n in (8, 64, 512)]
    assert counts[0] < counts[1] < counts[2] <= 36 * 90


def places(seed, count):
    sites = np.random.default_rng(seed).normal(size=(count, 3)) * [1, 1, 0.5] + [0, 0, 1]
    return sites / np.linalg.norm(sites, axis=1, keepdims=True)


def searched(tiles, sites):
    n = len(tiles.power)
    assignment = Assignment(np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n))
    assign(tiles, sites, np.arange(len(sites)), assignment)
    return assignment


@pytest.mark.parametrize("lights", [8, 300])
@pytest.mark.parametrize("count", [1, 2, 3, 17, 200])
def test_the_nearest_two_sites_are_those_of_a_full_search(count, lights):
    tiles, sites = tiles_from_map(sky(2), "hemisphere", lights, NO_BRIGHT_CELLS), places(0, count)
    first, second, overlap = searched(tiles, sites)
    chords = np.linalg.norm(tiles.direction.T[:, None] - sites[None], axis=-1)
    nearest = np.sort(chords, axis=1)
    each = np.arange(len(first))
    # float32 tells chords apart to some 1e-7 of the directions' length.
    np.testing.assert_allclose(chords[each, first], nearest[:, 0], atol=1e-6)
    if count == 1:
        assert (second == -1).all()
    else:
        assert (first != second).all()
        np.testing.assert_allclose(chords[each, second], nearest[:, 1], atol=1e-6)
    assert (overlap >= 0).all()
    assert (overlap <= 0.5).all()


@pytest.mark.parametrize("count", [3, 4, 40, 200])
def test_a_few_sites_that_moved_change_the_nearest_two_as_a_search_anew_would(count):
    tiles, sites, generator = tiles_from_map(sky(2), "hemisphere", 300, NO_BRIGHT_CELLS), places(1, count), np.random.default_rng(1)
    found = searched(tiles, sites)
    for k in range(5):
        moved = generator.choice(count, 3, replace=False)
        sites[moved] = places(2 + k, 3)
        assign(tiles, sites, moved, found)
        for one, other in zip(found, searched(tiles, sites), strict=True):
            np.testing.assert_array_equal(one, other)


def test_invalid_cells_are_inpainted_and_darkness_is_accepted_late():
    before, now = sky(3), sky(4)
    now[0, :3] = [[np.nan, 1, 1], [1, np.inf, 1], [1, 1, -1]]
    now[5] = 0
    original = now.copy()
    clean, ages, invalid = cleaned(now, None, np.zeros((0, 0), np.uint8), 0.0)
    assert invalid == 3
    np.testing.assert_array_equal(now, original)
    np.testing.assert_array_equal(clean[0, :3], [[0, 1, 1], [1, 0, 1], [1, 1, 0]])
    np.testing.assert_array_equal(clean[1:], now[1:])
    for wait in (True, True, False):
        clean, ages, _ = cleaned(now, before, ages, 0.0)
        np.testing.assert_array_equal(clean[0, :3], before[0, :3])
        np.testing.assert_array_equal(clean[5], before[5] if wait else 0)
    clean, ages, _ = cleaned(before, before, ages, 0.0)
    assert (ages[5] == np.where(before[5].any(axis=-1), 0, 2)).all()


def test_noise_is_found_and_taken_out_and_changes_are_not():
    generator, truth = np.random.default_rng(5), np.exp(sky(6).clip(0, 2))
    noise, clean, ages = NO_NOISE, None, np.zeros((0, 0), np.uint8)
    for _ in range(40):
        seen = (truth * (1 + 0.03 * generator.standard_normal(truth.shape[:2])[..., None])).astype(np.float32)
        noise = noise_after(noise, seen)
        clean, ages, _ = cleaned(seen, clean, ages, noise.variance)
    assert np.sqrt(noise.variance) == pytest.approx(0.03, rel=0.15)
    assert np.std(clean / truth - 1) < 0.6 * 0.03
    brighter, _, _ = cleaned((1.5 * truth).astype(np.float32), clean, ages, noise.variance)
    np.testing.assert_allclose(brighter, 1.5 * truth, rtol=1e-6)


def test_a_turning_sky_has_no_noise():
    noise, radiance = NO_NOISE, np.cumsum(sky(7), axis=1)
    for k in range(20):
        noise = noise_after(noise, np.roll(radiance, 2 * k, axis=1))
    assert np.sqrt(noise.variance) < 0.01
