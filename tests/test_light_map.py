import numpy as np
import pytest

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.sphere import cell_solid_angles, map_irradiance
from vemlight.sampler.light_map import light_map


def test_invalid_values_are_set_to_zero_and_counted_by_cell():
    radiance = np.ones((6, 8, 3), np.float32)
    radiance[0, 0] = np.nan
    radiance[1, 1, 2] = np.inf
    radiance[2, 2, 0] = -0.5
    radiance[3, 3, 1] = 2e30
    light = light_map(radiance, "hemisphere")
    assert light.invalid_cells == 4
    expected = np.ones((6, 8, 3), np.float32)
    expected[0, 0], expected[1, 1, 2], expected[2, 2, 0], expected[3, 3, 1] = 0, 0, 0, 0
    np.testing.assert_array_equal(light.radiance, expected)


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
def test_integrals_equal_the_maps_own(coverage):
    radiance = np.random.default_rng(1).lognormal(0, 3, (45, 90, 3)).astype(np.float32)
    light = light_map(radiance, coverage)
    np.testing.assert_allclose(light.irradiance, map_irradiance(radiance, coverage), rtol=1e-12)
    assert light.power == pytest.approx(float(luminance_from_rgb(light.irradiance)), rel=1e-12)


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
def test_the_floor_keeps_the_power_and_lifts_the_dark(coverage):
    radiance = np.zeros((18, 36, 3), np.float32)
    radiance[5, 7] = 1e6
    light = light_map(radiance, coverage)
    weights = cell_solid_angles(18, 36, coverage)
    assert (light.importance * weights[:, None]).sum() == pytest.approx(light.power, rel=1e-12)
    mean = light.power / (weights.sum() * 36)
    assert light.importance.min() == pytest.approx(1e-3 * mean, rel=1e-12)


def test_a_black_map_is_sampled_evenly():
    light = light_map(np.zeros((4, 8, 3), np.float32), "hemisphere")
    assert light.power == 0
    assert light.invalid_cells == 0
    assert (light.importance == 1).all()


def test_the_largest_values_stay_finite_as_float32():
    light = light_map(np.full((4, 8, 3), 9.9e29, np.float32), "sphere")
    assert light.invalid_cells == 0
    assert np.isfinite(light.irradiance.astype(np.float32)).all()


def test_a_good_map_is_looked_at_and_neither_copied_nor_changed():
    radiance = np.random.default_rng(2).random((8, 16, 3)).astype(np.float32)
    light = light_map(radiance, "hemisphere")
    assert np.shares_memory(light.radiance, radiance)
    with pytest.raises(ValueError):
        light.radiance[0, 0, 0] = 1
    radiance[0, 0, 0] = np.nan  # the caller's own stays writable, and an invalid one as it was
    assert light_map(radiance, "hemisphere").radiance[0, 0, 0] == 0
    assert np.isnan(radiance[0, 0, 0])
