import numpy as np
import pytest

from vemlight.light.sphere import cell_directions, cell_solid_angles
from vemlight.sampler.probes import irradiance_of_lights, irradiance_of_map, irradiance_of_unit_light, probes


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
def test_the_probes_are_even(coverage):
    at = probes(512, coverage)
    np.testing.assert_allclose(np.linalg.norm(np.concatenate(at), axis=1), 1, atol=1e-12)
    # An even hemisphere has its mean at height 1/2, an even sphere at 0.
    np.testing.assert_allclose(at.normals.mean(axis=0), [0, 0, 0.5 if coverage == "hemisphere" else 0], atol=0.02)
    np.testing.assert_allclose(at.occluders.mean(axis=0), 0, atol=0.02)
    assert np.abs((at.normals * at.occluders).sum(axis=1).mean()) < 0.06


def test_a_light_is_seen_by_its_cosine_and_beside_the_occluder():
    up = np.array([0.0, 0.0, 1.0])
    low = np.array([np.sqrt(1 - 0.25), 0, 0.5])
    assert irradiance_of_unit_light(up, up, low) == pytest.approx(0.5)
    assert irradiance_of_unit_light(up, -up, low) == 0
    assert irradiance_of_unit_light(-up, up, low) == 0
    across = np.array([-0.5, 0, np.sqrt(1 - 0.25)])  # at a right angle to the light: in the middle of the soft edge
    assert irradiance_of_unit_light(up, across, low) == pytest.approx(0.25)
    tilted = across + np.sin(np.radians(2.0)) / 2 * low  # halfway up the edge, which is two degrees wide to either side
    assert irradiance_of_unit_light(up, tilted, low) == pytest.approx(0.375)


def test_a_map_counts_as_the_lights_of_its_cells():
    radiance = np.random.default_rng(1).lognormal(0, 1, (10, 20, 3)).astype(np.float32)
    radiance[3:5] = 0
    at = probes(50, "hemisphere")
    directions = cell_directions(10, 20, "hemisphere").reshape(-1, 3)
    irradiance = (radiance * cell_solid_angles(10, 20, "hemisphere")[:, None, None]).reshape(-1, 3)
    np.testing.assert_allclose(irradiance_of_map(at, radiance, "hemisphere"), irradiance_of_lights(at, directions, irradiance), rtol=1e-6)


def test_an_even_sky_gives_the_closed_form_on_average():
    # Each occluder hides half of the sky on average; an upward hemisphere of radiance 1 gives pi (1 + cos tilt) / 2.
    at = probes(4096, "hemisphere")
    got = irradiance_of_map(at, np.ones((45, 90, 3), np.float32), "hemisphere")
    assert got.mean() == pytest.approx((np.pi * (1 + at.normals[:, 2]) / 2).mean() / 2, rel=0.01)
