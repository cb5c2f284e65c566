"""Fisheye images as polar maps."""

import msgspec
import numpy as np
import pytest

from vemlight.capture.fisheye import fisheye_to_polar
from vemlight.capture.lens import Lens, direction_from_pixel, pixel_from_direction, pixel_solid_angles
from vemlight.capture.scatter import polar_from_fisheye
from vemlight.light.sphere import angle_between, cell_directions, cell_solid_angles, map_irradiance, rotation_xyz

ROWS, COLS = 45, 180
TILT = tuple(tuple(map(float, row)) for row in rotation_xyz((25, -10, 40)))
LENS = Lens(size=(220, 200), f=(57.0, 57.5), c=(109.2, 99.6), k1=-0.01, k2=0.001, k3=0.0, k4=0.0, rim_deg=95.0)


@pytest.mark.parametrize("tilt", [LENS.world_from_camera, TILT])
def test_power_of_a_pixel_is_conserved(tilt: tuple) -> None:
    lens = msgspec.structs.replace(LENS, world_from_camera=tilt)
    solid = pixel_solid_angles(lens)
    weights = fisheye_to_polar(lens, 2 * ROWS, COLS, "sphere")
    seen = np.argwhere(solid > 0)
    for y, x in seen[np.random.default_rng(5).integers(0, len(seen), 50)]:
        image = np.zeros((200, 220, 3), np.float32)
        image[y, x] = 1.0
        got = map_irradiance(polar_from_fisheye(image, weights), "sphere")
        np.testing.assert_allclose(got, solid[y, x], rtol=1e-5)  # weights are float32


def test_even_sky_stays_even() -> None:
    weights = fisheye_to_polar(LENS, ROWS, COLS, "hemisphere")
    got = polar_from_fisheye(np.ones((200, 220, 3), np.float32), weights)
    # a pixel is half a cell: the balanced overlaps come within 1 % of even, raw 8 x 8 subpixels within 8 %
    np.testing.assert_allclose(got, 1.0, atol=0.01)
    assert map_irradiance(got, "hemisphere")[0] == pytest.approx(2 * np.pi, rel=1e-3)


@pytest.mark.parametrize("tilt", [LENS.world_from_camera, TILT])
def test_one_lit_pixel_lands_where_it_points(tilt: tuple) -> None:
    lens = msgspec.structs.replace(LENS, world_from_camera=tilt)
    weights = fisheye_to_polar(lens, 2 * ROWS, COLS, "sphere")
    directions = cell_directions(2 * ROWS, COLS, "sphere")
    flux_of = cell_solid_angles(2 * ROWS, COLS, "sphere")[:, None]
    pixel_rad = 1 / 57
    seen = np.argwhere(pixel_solid_angles(lens) > 0)
    for y, x in seen[np.random.default_rng(6).integers(0, len(seen), 40)]:
        image = np.zeros((200, 220, 3), np.float32)
        image[y, x] = 1.0
        centre = np.einsum("ij,ijc->c", polar_from_fisheye(image, weights)[..., 1] * flux_of, directions)
        truth = lens.rotation @ direction_from_pixel(np.array([x, y]), lens)
        # cells are 2 degrees, so that the centre of one is off by up to 1.4; the pixel's own width is 1
        assert angle_between(centre / np.linalg.norm(centre), truth) < np.radians(1.45) + pixel_rad


def test_vignetting_is_undone() -> None:
    lens = msgspec.structs.replace(LENS, vignetting=(-0.2, 0.01))
    theta2 = np.arccos(np.clip(direction_from_pixel(np.stack(np.meshgrid(np.arange(220), np.arange(200)), -1), lens)[..., 2], -1, 1)) ** 2
    image = np.repeat((1 - 0.2 * theta2 + 0.01 * theta2**2)[..., None], 3, -1).astype(np.float32)
    got = polar_from_fisheye(image, fisheye_to_polar(lens, ROWS, COLS, "hemisphere"))
    np.testing.assert_allclose(got, 1.0, atol=0.01)


def test_light_outside_the_rim_is_not_seen() -> None:
    lens = msgspec.structs.replace(LENS, rim_deg=60.0)
    image = np.where(pixel_solid_angles(lens)[..., None] > 0, 0.0, 1.0) * np.ones(3)
    assert not polar_from_fisheye(image.astype(np.float32), fisheye_to_polar(lens, ROWS, COLS, "hemisphere")).any()


def test_narrow_cells_at_the_zenith_are_filled() -> None:
    # one degree cells and pixels of one degree: the first ring is 1/360 of a pixel wide
    weights = fisheye_to_polar(LENS, 90, 360, "hemisphere")
    got = polar_from_fisheye(np.ones((200, 220, 3), np.float32), weights)
    np.testing.assert_allclose(got[:5], 1.0, atol=2e-3)


def test_nan_makes_only_its_own_cells_invalid() -> None:
    weights = fisheye_to_polar(LENS, ROWS, COLS, "hemisphere")
    image = np.ones((200, 220, 3), np.float32)
    x, y = np.rint(pixel_from_direction(np.array([0.5, 0.3, 0.8]), LENS)).astype(int)
    image[y, x] = np.nan
    invalid = np.isnan(polar_from_fisheye(image, weights)).all(-1)
    assert 1 <= invalid.sum() <= 4
