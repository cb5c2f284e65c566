"""Laws that every method must keep, ours among them."""

from collections.abc import Callable

import numpy as np
import pytest

from bench.rivals.kollig_keller import kollig_keller
from bench.rivals.median_cut import median_cut, variance_minimisation
from bench.rivals.penrose import penrose
from bench.rivals.q2tree import DEPTH, q2tree, quadrilaterals
from bench.rivals.sequential import begun, sequential
from bench.rivals.spatiotemporal import spatiotemporal
from bench.rivals.structured import structured
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage, angle_between, cell_solid_angles, direction_from_angles, map_irradiance
from vemlight.sampler.probes import irradiance_of_lights, irradiance_of_map, probes
from vemlight.sampler.sampler_input import SamplerInput

Method = Callable[[np.ndarray, Coverage, int], LightSet]
METHODS: list[Method] = [median_cut, variance_minimisation, kollig_keller, structured, q2tree, penrose]
BY_REGION: list[Method] = METHODS[:5]


def sky(seed: int) -> np.ndarray:
    coarse = np.random.default_rng(seed).lognormal(0, 1.2, (10, 30, 3))
    return coarse.repeat(3, axis=0).repeat(4, axis=1).astype(np.float32)


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.__name__)
def test_energy_is_kept_in_every_channel(method, coverage):
    for count in (1, 7, 40):
        lights = method(sky(1), coverage, count)
        np.testing.assert_allclose(lights.irradiance.sum(axis=0, dtype=float), map_irradiance(sky(1), coverage), rtol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(lights.directions, axis=1), 1, atol=1e-5)
        assert 0 < len(lights.ids) <= count


@pytest.mark.parametrize("method", BY_REGION[:4], ids=lambda m: m.__name__)
def test_the_number_of_lights_is_the_one_asked_for(method):
    assert [len(method(sky(1), "hemisphere", count).ids) for count in (1, 2, 7, 40)] == [1, 2, 7, 40]


def test_quartering_misses_the_number_by_two_at_most():
    lit = [len(q2tree(sky(1), "hemisphere", count).ids) for count in range(9, 60)]
    assert all(count - 2 <= found <= count for count, found in zip(range(9, 60), lit, strict=True))


def test_quadrilaterals_have_equal_areas_at_every_depth():
    areas = np.repeat(cell_solid_angles(360, 720, "sphere"), 720)
    for depth in range(4):
        sums = np.bincount(quadrilaterals(360, 720, "sphere") >> 2 * (DEPTH - depth), areas)
        assert len(sums) == 12 * 4**depth
        np.testing.assert_allclose(sums, sums.mean(), rtol=0.005 * 2**depth)  # half a degree of border, counted to whole cells


def test_light_that_changes_in_one_place_leaves_the_quadrilaterals_elsewhere():
    before, brighter = sky(1), sky(1)
    brighter[12:15, 20:24] *= 4
    old, new = q2tree(before, "hemisphere", 40), q2tree(brighter, "hemisphere", 40)
    _, a, b = np.intersect1d(old.ids, new.ids, return_indices=True)
    assert len(a) > 20
    far = angle_between(old.directions[a].astype(float), direction_from_angles(np.radians(40.0), np.radians(66.0))) > np.radians(30)
    np.testing.assert_allclose(old.directions[a][far], new.directions[b][far], atol=1e-6)


@pytest.mark.parametrize("method", BY_REGION, ids=lambda m: m.__name__)
def test_one_lit_cell_is_one_light_in_its_place(method):
    radiance = np.zeros((30, 120, 3), np.float32)
    radiance[10, 60] = [1.0, 2.0, 3.0]
    lights = method(radiance, "hemisphere", 16)
    lit = lights.irradiance.sum(axis=1) > 1e-6
    place = direction_from_angles(np.radians(31.5), np.radians(181.5))
    assert lit.sum() == 1
    assert np.degrees(angle_between(lights.directions[lit].astype(float), place)).max() < 1.5


def test_one_lit_cell_draws_the_samples_of_the_tiling():
    radiance = np.zeros((30, 120, 3), np.float32)
    radiance[10, 60] = [1.0, 2.0, 3.0]
    lights = penrose(radiance, "hemisphere", 64)
    place = direction_from_angles(np.radians(31.5), np.radians(181.5))
    near = np.degrees(angle_between(lights.directions.astype(float), place)) < 3
    assert lights.irradiance[near].sum() > 0.99 * lights.irradiance.sum()


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.__name__)
def test_a_black_map_gives_no_light(method):
    lights = method(np.zeros((12, 24, 3), np.float32), "hemisphere", 8)
    assert np.isfinite(lights.directions).all()
    assert lights.irradiance.sum() == 0


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.__name__)
def test_the_same_map_gives_the_same_lights(method):
    for one, other in zip(method(sky(2), "hemisphere", 20), method(sky(2), "hemisphere", 20), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.__name__)
def test_error_falls_with_the_number_of_lights(method):
    at, errors = probes(200, "hemisphere"), []
    for count in (8, 32, 128):
        square = 0.0
        for seed in range(4):
            truth = irradiance_of_map(at, sky(seed).astype(float), "hemisphere")
            lights = method(sky(seed), "hemisphere", count)
            square += np.mean(((irradiance_of_lights(at, lights.directions, lights.irradiance) - truth) / truth.mean()) ** 2)
        errors.append(np.sqrt(square / 4))
    assert errors[0] > errors[1] > errors[2]


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.__name__)
def test_more_lights_stand_where_there_is_more_light(method):
    radiance = sky(3) / sky(3).mean()
    radiance[:, :60] *= 10
    lights = method(radiance, "hemisphere", 40)
    assert (lights.directions[:, 1] > 0).sum() > 0.6 * len(lights.ids)  # phi in (0, pi)


def test_near_the_zenith_azimuths_are_short():
    """Light of 60 degrees of azimuth and 20 of polar angle is cut across the latter: 60 degrees of azimuth are 12 on the sky there."""
    radiance = np.zeros((90, 360, 3), np.float32)
    radiance[2:22, :60] = 1
    one, other = variance_minimisation(radiance, "hemisphere", 2).directions.astype(float)
    assert abs(np.arctan2(one[1], one[0]) - np.arctan2(other[1], other[0])) < np.radians(5)
    assert abs(np.arccos(one[2]) - np.arccos(other[2])) > np.radians(5)


def test_of_equal_light_a_small_part_gets_the_fewer_lights():
    """Agarwal et al. 2003: importance goes with the fourth root of a part's solid angle, up to 0.01 sr."""
    radiance = np.zeros((60, 240, 3), np.float32)
    radiance[30:32, 20:22] = 25.0
    radiance[26:36, 140:150] = 1.0
    lights = structured(radiance, "hemisphere", 7)
    small = lights.directions[:, 1] > 0
    assert small.sum() < 3.5 < (~small).sum()


def followed(maps: list[np.ndarray], count: int) -> list[LightSet]:
    """The lights of sequential sampling for each of the maps in turn."""
    population, made = begun(count), []
    for k, radiance in enumerate(maps):
        population, lights = sequential(population, SamplerInput(radiance, "hemisphere", k / 25))
        made.append(lights)
    return made


def stratified(maps: list[np.ndarray], count: int) -> list[LightSet]:
    return spatiotemporal(count, [SamplerInput(radiance, "hemisphere", k / 25) for k, radiance in enumerate(maps)])


@pytest.mark.parametrize("method", [followed, stratified])
def test_methods_of_sequences_keep_the_power_of_each_frame(method):
    maps = [sky(seed) * (1 + seed) for seed in range(6)]
    for radiance, lights in zip(maps, method(maps, 40), strict=True):
        power = luminance_from_rgb(lights.irradiance.sum(axis=0, dtype=float))
        np.testing.assert_allclose(power, luminance_from_rgb(map_irradiance(radiance, "hemisphere")), rtol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(lights.directions, axis=1), 1, atol=1e-5)
        assert len(np.unique(lights.ids)) == len(lights.ids) > 0


@pytest.mark.parametrize("method", [followed, stratified])
def test_methods_of_sequences_give_black_frames_no_light(method):
    lit, black, again = method([sky(1), np.zeros_like(sky(1)), sky(1)], 40)
    assert black.irradiance.sum() == 0
    assert lit.irradiance.sum() == pytest.approx(again.irradiance.sum(), rel=0.2)  # exact in luminance


def test_a_population_of_a_still_map_keeps_most_of_its_ids():
    before, after = followed([sky(1)] * 2, 200)
    assert len(np.intersect1d(before.ids, after.ids)) == len(before.ids)


def test_a_population_whose_weight_is_in_few_samples_is_drawn_anew_from_them():
    before, after = sky(1), sky(1)
    after[:, :30] *= 1e4  # a quarter of the sky: less than half of the samples carry all weight
    old, new = followed([before, after], 200)
    quarter = (new.directions[:, 1] > 0) & (new.directions[:, 0] > 0)
    assert quarter.mean() > 0.95
    assert len(np.intersect1d(old.ids, new.ids)) < 100


def test_strata_last_as_long_as_the_light_does_not_change():
    still = stratified([sky(1)] * 8, 40)
    assert all(np.array_equal(lights.ids, still[0].ids) for lights in still)
    assert sum(len(lights.ids) for lights in still) <= 8 * 40
    brighter = sky(1)
    brighter[:, :60] *= 50
    switched = stratified([sky(1)] * 4 + [brighter] * 4, 40)
    assert np.array_equal(switched[0].ids, switched[3].ids)
    assert not np.array_equal(switched[3].ids, switched[4].ids)
    assert len(switched[4].ids) > len(switched[3].ids)  # the number of lights follows the importance
