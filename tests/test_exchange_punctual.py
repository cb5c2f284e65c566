"""A light as other programs have it."""

import numpy as np
import pytest

from tests.support.exchange import turned
from vemlight.exchange.punctual import SUN_DEG, Punctual, rotations_to
from vemlight.light.light_set import LightSet

UP = np.array([[0.0, 0, 1]])


def test_a_rotation_turns_z_to_the_light_everywhere_and_straight_down():
    random = np.random.default_rng(1)
    special = [[0, 0, 1], [0, 0, -1], [1e-7, 0, -1], [0, 1e-4, -1], [1e-9, 0, 1]]
    directions = np.concatenate([random.normal(size=(1000, 3)), special])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rotations = rotations_to(directions)
    assert np.abs(np.linalg.norm(rotations, axis=1) - 1).max() < 1e-15
    assert np.abs(turned(rotations, UP) - directions).max() < 1e-14
    assert (rotations[:, 2] == 0).all()  # the shortest


def test_strength_times_colour_is_the_irradiance_and_a_dark_light_is_white():
    lights = LightSet.of(np.arange(2), np.concatenate([UP, UP]), np.array([[0.2, 4.0, 1.0], [0, 0, 0]]))
    found = Punctual.of(lights)
    assert found.strength.tolist() == [4.0, 0.0]
    assert np.abs(found.strength[:, None] * found.colour - lights.irradiance).max() < 1e-7
    assert found.colour[1].tolist() == [1, 1, 1]


@pytest.mark.parametrize("half_deg", [0.5, 3.0, 30.0, 80.0])
def test_the_angle_is_that_of_the_disc_with_the_light_s_extent(half_deg):
    """The covariance of directions spread evenly over a cap, by numbers."""
    cosines = 1 - (1 - np.cos(np.radians(half_deg))) * (np.arange(200_000) + 0.5) / 200_000
    mean = cosines.mean()
    along, across = (cosines**2).mean() - mean**2, ((1 - cosines**2) / 2).mean()
    lights = LightSet.of(np.arange(1), UP, np.ones((1, 3)), np.array([[across, 0, 0, across, 0, along]]))
    assert Punctual.of(lights).angle_deg[0] == pytest.approx(2 * half_deg, rel=1e-4)


def test_no_light_is_narrower_than_the_sun_or_wider_than_a_hemisphere():
    points = LightSet.of(np.arange(1), UP, np.ones((1, 3)))
    assert Punctual.of(points).angle_deg.tolist() == [SUN_DEG] == [0.53]
    for covariance, angle in ([1e-9, 0, 0, 1e-9, 0, 0], SUN_DEG), ([0.4, 0, 0, 0.4, 0, 0.2], 180.0):
        assert Punctual.of(points._replace(covariances=np.array([covariance], np.float32))).angle_deg.tolist() == [angle]
