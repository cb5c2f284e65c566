"""The light around the virtual camera."""

import math
from pathlib import Path

import numpy as np
import pytest

from vemlight.capture.simulation.environment import Environment, MapScene, SunDisc, disc_points, hemisphere_irradiance, sun_direction
from vemlight.capture.simulation.interior import FLICKER_HZ, Interior, mean_cosine
from vemlight.capture.simulation.sky import Sky, sun_at
from vemlight.light.images import write_exr
from vemlight.light.sphere import angle_between, latlong_solid_angles, rotation_xyz


def test_disc_points_fill_the_disc_evenly() -> None:
    disc = SunDisc(np.array([0.6, 0.0, 0.8]), 0.3, np.ones(3))
    points = disc_points(disc, 4000)
    off = angle_between(points, disc.direction)
    assert off.max() <= 0.3
    # even per solid angle: the fraction within half the radius is (1 - cos 0.15) / (1 - cos 0.3)
    assert np.mean(off < 0.15) == pytest.approx((1 - math.cos(0.15)) / (1 - math.cos(0.3)), abs=1e-3)
    assert angle_between(points.mean(0) / np.linalg.norm(points.mean(0)), disc.direction) < 1e-3


def test_upper_flux_of_upright_maps_is_exact() -> None:
    image = np.random.default_rng(0).lognormal(0, 2, (32, 64, 3))
    truth = np.einsum("ijc,i->c", image[:16], latlong_solid_angles(32, 64)[:16])
    turned = rotation_xyz((0, 0, 33.0))
    total, level = hemisphere_irradiance(Environment(image, []), turned)
    np.testing.assert_allclose(total, truth, rtol=1e-12)
    cosines = np.cos((np.arange(16) + 0.5) * np.pi / 32)
    np.testing.assert_allclose(level, np.einsum("ijc,i->c", image[:16], latlong_solid_angles(32, 64)[:16] * cosines), rtol=2e-3)


def test_upper_flux_of_a_tilted_even_map_is_half() -> None:
    even = Environment(np.ones((64, 128, 3)), [])
    # pixels at the horizon are split by 8 x 8 points
    total, level = hemisphere_irradiance(even, rotation_xyz((30, 20, 0)))
    np.testing.assert_allclose(total, 2 * np.pi, rtol=1e-4)
    np.testing.assert_allclose(level, np.pi, rtol=1e-3)


def test_setting_sun_counts_by_its_part_above() -> None:
    sun = SunDisc(np.array([1.0, 0, 0]), 0.01, np.ones(3))
    np.testing.assert_allclose(hemisphere_irradiance(Environment(np.zeros((8, 16, 3)), [sun]), np.eye(3))[0], 0.5, atol=0.02)


def test_dark_has_a_sun_direction() -> None:
    assert sun_direction(Environment(np.zeros((8, 16, 3)), [])).tolist() == [0, 0, 1]


def test_sky_moves_and_is_finite() -> None:
    sky = Sky(1)
    a, b = sky.environment(0, 0.0, 0.0), sky.environment(1, 1.0, 0.0)
    assert np.isfinite(a.image).all()
    assert a.image.min() > 0
    assert np.abs(a.image - b.image).max() > 0.05
    assert angle_between(sun_at(0.0), sun_at(1.0)) > np.radians(5)
    assert np.array_equal(Sky(1).environment(0, 0.0, 0.0).image, a.image)
    assert not np.array_equal(Sky(2).environment(0, 0.0, 0.0).image, a.image)


def test_flicker_is_averaged_over_the_exposure() -> None:
    fine = np.mean([mean_cosine(100.0, 0.3, 0.01 + 0.004 * (i + 0.5) / 4000, 0.0) for i in range(4000)])
    assert mean_cosine(100.0, 0.3, 0.01, 0.004) == pytest.approx(fine, abs=1e-6)
    room = Interior(0)
    whole = [room.environment(0, 0.0, 1 / FLICKER_HZ).image.max(), room.environment(0, 0.0, 2 / FLICKER_HZ).image.max()]
    assert whole[0] == pytest.approx(whole[1], rel=1e-9)


def test_bad_pixels_of_a_map_are_dark(tmp_path: Path) -> None:
    image = np.ones((8, 16, 3), np.float32)
    image[0, 0], image[1, 1], image[2, 2] = np.nan, np.inf, -1
    write_exr(tmp_path / "m.exr", image)
    seen = MapScene([tmp_path / "m.exr"]).environment(0, 0.0, 0.0).image
    assert np.count_nonzero(seen[..., 0] == 0) == 3
