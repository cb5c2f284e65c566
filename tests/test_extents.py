"""Lights with extent: exact light, exact second moments, and shadows nearer to the map's than those of points."""

import numpy as np
import pytest

from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.light.light_set import are_covariances
from vemlight.light.sphere import Coverage, cell_directions, cell_solid_angles, direction_from_angles, map_irradiance
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.score import score
from vemlight.sampler.tracking.tracked import initial_tracked, tracked_step

ROWS, COLS = 45, 180


def disc_map(degrees, radiance, theta=40.0, phi=100.0, sky=1.0):
    """A sky with an even round source."""
    directions = cell_directions(ROWS, COLS, "hemisphere")
    inside = directions @ direction_from_angles(np.radians(theta), np.radians(phi)) > np.cos(np.radians(degrees / 2))
    gray = np.where(inside, radiance, sky * (1.2 + directions[..., 0]))
    return (gray[..., None] * [0.9, 1.0, 1.3]).astype(np.float32)


def soft(radiance, count=32, frames=1, coverage: Coverage = "hemisphere"):
    state, lights = initial_tracked(), None
    for k in range(frames):
        state, lights, _ = tracked_step(count, state, SamplerInput(radiance, coverage, k / 25, NO_BRIGHT_CELLS), False, soft=True)
    assert lights is not None
    assert lights.covariances is not None
    return lights, lights.covariances


def full(covariances):
    return covariances.astype(float)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]


MAPS = {
    "sky": disc_map(0, 0),
    "sun": disc_map(4, 5e4),
    "lamps": disc_map(8, 300) + disc_map(8, 300, 60, 280, 0),
    "noise": np.random.default_rng(0).lognormal(0, 2, (ROWS, COLS, 3)).astype(np.float32),
    "one cell": np.zeros((ROWS, COLS, 3), np.float32),
}
MAPS["one cell"][20, 30] = 7.0


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("count", [1, 2, 8, 64])
def test_the_light_is_the_maps_in_every_channel_and_every_covariance_can_be(name, count):
    lights, covariances = soft(MAPS[name], count, 3)
    assert len(lights.ids) <= count
    assert len(set(lights.ids.tolist())) == len(lights.ids)
    np.testing.assert_allclose(lights.irradiance.sum(axis=0, dtype=float), map_irradiance(MAPS[name], "hemisphere"), rtol=1e-5)
    assert (lights.irradiance >= 0).all()
    assert are_covariances(covariances)
    np.testing.assert_allclose(np.linalg.norm(lights.directions, axis=1), 1, atol=1e-6)


def test_one_light_has_the_maps_own_moments():
    radiance = disc_map(0, 0)
    lights, covariances = soft(radiance, 1)
    directions = cell_directions(ROWS, COLS, "hemisphere").reshape(-1, 3)
    power = (radiance[..., 1] * cell_solid_angles(ROWS, COLS, "hemisphere")[:, None]).reshape(-1)
    mean = power @ directions / power.sum()
    covariance = np.einsum("n,ni,nj->ij", power, directions, directions) / power.sum() - np.outer(mean, mean)
    np.testing.assert_allclose(lights.directions[0], mean / np.linalg.norm(mean), atol=1e-3)
    # The mean needs no field of its own: its square and the covariance's trace are 1.
    assert 1 - np.trace(full(covariances)[0]) == pytest.approx(mean @ mean, rel=2e-3)
    # Tiles of 8 degrees are taken as even across, which moves light by a thousandth between the axes.
    np.testing.assert_allclose(full(covariances)[0], covariance, atol=2e-3)


def test_a_lamp_is_one_light_with_the_variance_of_a_disc():
    lights, covariances = soft(disc_map(5.0, 3000.0, sky=0.2), 16, 3)
    lamp = lights.irradiance[:, 1].argmax()
    # An even disc of radius r has the mean square r^2 / 4 along each axis; cells are 2 degrees.
    spread = np.degrees(np.sqrt(np.trace(full(covariances)[lamp]) / 2))
    assert spread == pytest.approx(2.5 / 2, rel=0.25)
    assert lights.directions[lamp] @ direction_from_angles(np.radians(40), np.radians(100)) > np.cos(np.radians(0.5))


def test_one_lit_cell_is_one_point():
    lights, covariances = soft(MAPS["one cell"], 8)
    assert (lights.irradiance[:, 1] > 0).sum() == 1
    assert np.abs(covariances[lights.irradiance[:, 1].argmax()]).max() < 1e-6


@pytest.mark.parametrize(("name", "times"), [("sky", 2.0), ("lamps", 2.0), ("noise", 1.5)])
def test_shadows_are_truer_than_those_of_points(name, times):
    _, points, _ = tracked_step(16, initial_tracked(), SamplerInput(MAPS[name], "hemisphere", 0.0, NO_BRIGHT_CELLS), False)
    errors = [score([(MAPS[name], lights)]).error for lights in (points, soft(MAPS[name], 16)[0])]
    assert errors[0] > times * errors[1]


def test_light_even_round_the_sphere_is_several_lights():
    lights, _ = soft(np.ones((90, 90, 3), np.float32), 16, coverage="sphere")
    assert (lights.irradiance[:, 1] > 0.02 * 4 * np.pi).all()
    assert np.linalg.norm(lights.irradiance[:, 1] @ lights.directions) < 0.05 * 4 * np.pi


def test_the_same_map_gives_the_same_bytes():
    (one, extents), (two, same) = soft(MAPS["noise"], 64, 2), soft(MAPS["noise"], 64, 2)
    assert [array.tobytes() for array in (*one[:3], extents)] == [array.tobytes() for array in (*two[:3], same)]
