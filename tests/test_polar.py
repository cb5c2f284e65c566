"""Lat-long images as polar maps."""

import numpy as np
import pytest

from vemlight.capture.polar import latlong_to_polar, overlaps, polar_from_latlong
from vemlight.light.sphere import cell_from_direction, direction_from_angles, latlong_from_direction, latlong_solid_angles, map_irradiance

SIZES = [(64, 128), (512, 1024), (63, 127), (30, 60)]


def polar(image: np.ndarray, rows: int = 90, cols: int = 360, coverage: str = "hemisphere") -> np.ndarray:
    weights = latlong_to_polar(*image.shape[:2], rows, cols, coverage)  # type: ignore[arg-type]
    return polar_from_latlong(image, weights)


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_power_of_the_sphere_is_conserved(height: int, width: int) -> None:
    image = np.random.default_rng(1).lognormal(0, 3, (height, width, 3)).astype(np.float32)
    truth = np.einsum("ijc,i->c", image.astype(np.float64), latlong_solid_angles(height, width))
    got = map_irradiance(polar(image, 180, 360, "sphere"), "sphere")
    np.testing.assert_allclose(got, truth, rtol=1e-6)  # float32 maps: 6e-8 a cell


@pytest.mark.parametrize(("height", "width"), [(64, 128), (512, 1024)])
def test_power_of_the_hemisphere_is_the_upper_half(height: int, width: int) -> None:
    image = np.random.default_rng(2).lognormal(0, 3, (height, width, 3)).astype(np.float32)
    truth = np.einsum("ijc,i->c", image[: height // 2].astype(np.float64), latlong_solid_angles(height, width)[: height // 2])
    np.testing.assert_allclose(map_irradiance(polar(image), "hemisphere"), truth, rtol=1e-6)


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_even_light_stays_even(height: int, width: int) -> None:
    np.testing.assert_allclose(polar(np.full((height, width, 3), 0.7, np.float32)), 0.7, rtol=1e-6)


def test_one_lit_pixel_lands_where_it_points() -> None:
    rng = np.random.default_rng(3)
    for theta, phi in zip(rng.uniform(0.02, 1.5, 40), rng.uniform(0, 2 * np.pi, 40), strict=True):
        image = np.zeros((512, 1024, 3), np.float32)
        row, col = latlong_from_direction(direction_from_angles(theta, phi), 512, 1024)
        image[int(row), int(col)] = 1.0
        lit = polar(image)[..., 0]
        centre = direction_from_angles((int(row) + 0.5) * np.pi / 512, np.pi - (int(col) + 0.5) * 2 * np.pi / 1024)
        i, j = cell_from_direction(centre, 90, 360, "hemisphere")
        assert lit[int(i), int(j)] > 0
        # 2 x 2 cells at most: the pixel is a third of one
        assert 1 <= np.count_nonzero(lit) <= 4


def test_black_stays_black() -> None:
    assert not polar(np.zeros((64, 128, 3), np.float32)).any()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_invalid_pixel_makes_the_cells_invalid_that_it_overlaps_and_no_others(bad: float) -> None:
    # 180 rows of 1 degree each: every pixel coincides with one cell
    image = np.ones((180, 360, 3), np.float32)
    image[20, 100] = bad
    got = polar(image)
    invalid = ~np.isfinite(got).all(axis=-1)
    assert np.argwhere(invalid).tolist() == [[20, 180 - 100 - 1]]
    assert np.all(got[~invalid] == 1)


def test_negative_pixels_count_in_the_mean() -> None:
    image = np.ones((360, 720, 3), np.float32)
    image[40, 10] = -1
    got = polar(image)
    assert got.min() < 1
    assert np.count_nonzero(got[..., 0] < 0.999) == 1


def test_sun_a_million_times_its_sky() -> None:
    image = np.ones((512, 1024, 3), np.float32)
    image[100, 300] = 1e6
    solid = latlong_solid_angles(512, 1024)
    truth = 2 * np.pi + (1e6 - 1) * solid[100]
    np.testing.assert_allclose(map_irradiance(polar(image), "hemisphere"), truth, rtol=1e-6)


def test_overlaps_are_means() -> None:
    edges = np.array([0.0, 1.0, 3.0, 4.0])
    got = overlaps(np.array([0.0, 0.5, 3.0]), np.array([1.0, 3.5, 4.0]), edges)
    assert got.start.tolist() == [0, 1, 4, 5]
    assert got.index.tolist() == [0, 0, 1, 2, 2]
    np.testing.assert_allclose(got.weight, [1, 0.5 / 3, 2 / 3, 0.5 / 3, 1])


def test_rounding_at_coinciding_edges_is_no_overlap() -> None:
    edges = np.array([0.0, 1.0, 2.0])
    assert overlaps(np.array([0.0]), np.array([1 + 1e-13]), edges).index.tolist() == [0]
    assert overlaps(np.array([0.0]), np.array([1 + 1e-6]), edges).index.tolist() == [0, 1]
