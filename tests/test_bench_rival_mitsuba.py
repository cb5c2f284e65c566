import numpy as np
import pytest

from vemlight.light.sphere import angle_between, direction_from_angles, map_irradiance

pytest.importorskip("mitsuba", reason="Mitsuba is in the bench extra")

from bench.rivals.mitsuba_envmap import mitsuba_envmap


def test_energy_is_kept_in_every_channel():
    sky = np.random.default_rng(0).lognormal(0, 1, (30, 120, 3)).astype(np.float32)
    for coverage in ("hemisphere", "sphere"):
        lights = mitsuba_envmap(sky, coverage, 50)
        np.testing.assert_allclose(lights.irradiance.sum(axis=0, dtype=float), map_irradiance(sky, coverage), rtol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(lights.directions, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize(("row", "col"), [(10, 60), (25, 3), (3, 118)])
def test_one_lit_cell_is_found_where_it_is(row, col):
    radiance = np.zeros((30, 120, 3), np.float32)
    radiance[row, col] = [1.0, 2.0, 3.0]
    lights = mitsuba_envmap(radiance, "hemisphere", 64)
    place = direction_from_angles(np.radians(3 * row + 1.5), np.radians(3 * col + 1.5))
    mean = (lights.irradiance[:, 1:2] * lights.directions).sum(axis=0)
    assert np.degrees(angle_between(mean / np.linalg.norm(mean), place)) < 0.7
    assert np.degrees(angle_between(lights.directions.astype(float), place)).max() < 4.5


def test_a_black_map_gives_no_light():
    assert mitsuba_envmap(np.zeros((12, 24, 3), np.float32), "hemisphere", 8).irradiance.sum() == 0
