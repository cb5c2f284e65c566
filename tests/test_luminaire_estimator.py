import numpy as np
import pytest

from tests.support.light_fields import lobed_field
from vemlight.light.colour import luminance_from_rgb
from vemlight.renderer.luminaire.bvh import hierarchy_from_triangles
from vemlight.renderer.luminaire.estimator import Occluders, halton, interleaved_shifts, irradiance_receivers, shade
from vemlight.renderer.luminaire.reference import irradiance
from vemlight.renderer.luminaire.tables import summed_area_tables

DOWN = np.array([0.0, 0.0, -1.0])


def some_points(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Places before, on, within 1e-4 of, between and far from the planes, with surfaces that face the lamp or graze its light."""
    rng = np.random.default_rng(seed)
    z = rng.choice([0.1, 0.25, 0.3999, 0.39999, 0.4, 0.40001, 0.4001, 0.41, 0.6, 1.0, 3.0], count)
    points = np.concatenate([rng.uniform(-0.3, 0.3, (count, 2)) * np.maximum(z / 0.4, 1)[:, None], z[:, None]], axis=1)
    normals = rng.normal(size=(count, 3)) * [1, 1, 0.4]
    normals[:, 2] = -np.abs(normals[:, 2]) - 0.2
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def same_shifts(count: int) -> np.ndarray:
    return interleaved_shifts(np.zeros(count, int), np.zeros(count, int), 1)


@pytest.mark.parametrize("kind", ["bell", "b-spline"])
def test_a_hundred_thousand_samples_give_the_exact_irradiance(kind):
    field = lobed_field(kind)
    points, normals = some_points(90, 4)
    got = luminance_from_rgb(shade(summed_area_tables(field), irradiance_receivers(points, normals), same_shifts(90), 100_000))
    truth = luminance_from_rgb(np.array([irradiance(field, p, n) for p, n in zip(points, normals, strict=True)]))
    lit = truth > 1e-4 * truth.max()
    assert lit.sum() > 60
    assert np.abs(got[lit] / truth[lit] - 1).max() < 2e-3


def test_a_point_at_grazing_height_above_the_lamp_is_as_exact():
    field = lobed_field()
    points = np.array([[0.02, 0.01, z] for z in (1e-4, 1e-3, 5e-3, 0.02)])
    for normal in (DOWN, np.array([-0.9, 0.0, -0.436])):
        receivers = irradiance_receivers(points, np.tile(normal, (4, 1)))
        got = luminance_from_rgb(shade(summed_area_tables(field), receivers, same_shifts(4), 100_000))
        truth = luminance_from_rgb(np.array([irradiance(field, p, normal) for p in points]))
        assert np.abs(got / truth - 1).max() < 2e-3


def test_few_samples_are_right_on_average():
    """Unbiased: 4,000 estimates of 5 samples each, shifted at random, average to the integral (4,000 x 5 samples of spread 1.5: 1 %)."""
    field, rng = lobed_field("bell", 1.5), np.random.default_rng(1)
    for point in (np.array([0.1, 0.05, 0.9]), np.array([0.0, 0.1, 0.4]), np.array([0.05, 0.0, 0.2])):
        receivers = irradiance_receivers(np.tile(point, (4000, 1)), np.tile(DOWN, (4000, 1)))
        got = shade(summed_area_tables(field), receivers, rng.random((4000, 3)), 5)
        assert luminance_from_rgb(got.mean(axis=0)) == pytest.approx(luminance_from_rgb(irradiance(field, point, DOWN)), rel=0.04)


def test_a_cap_on_the_samples_of_an_image_adds_no_bias():
    field = lobed_field()
    points, normals = some_points(40, 9)
    receivers = irradiance_receivers(points, normals)
    got = luminance_from_rgb(shade(summed_area_tables(field), receivers, same_shifts(40), 40_000, max_per_image=900))
    truth = luminance_from_rgb(np.array([irradiance(field, p, n) for p, n in zip(points, normals, strict=True)]))
    lit = truth > 1e-4 * truth.max()
    assert np.abs(got[lit] / truth[lit] - 1).max() < 0.03


def test_behind_the_lamp_and_beside_all_supports_it_is_dark():
    field = lobed_field()
    points = np.array([[0, 0, 0.0], [0, 0, -0.1], [0, 0, -1e-12], [5, 0, 0.4], [40, 0, 1.0]], float)
    out = shade(summed_area_tables(field), irradiance_receivers(points, np.tile(DOWN, (5, 1))), same_shifts(5), 100)
    assert not out.any()


def test_black_images_and_one_lit_pixel():
    black = lobed_field()._replace(images=np.zeros((5, 5, 24, 24, 3), np.float32))
    points, normals = some_points(50, 2)
    assert not shade(summed_area_tables(black), irradiance_receivers(points, normals), same_shifts(50), 100).any()
    black.images[2, 3, 7, 11] = [1, 2, 4]
    got = shade(summed_area_tables(black), irradiance_receivers(points, normals), same_shifts(50), 20_000)
    truth = np.array([irradiance(black, p, n) for p, n in zip(points, normals, strict=True)])
    assert np.all(np.isfinite(got))
    assert got == pytest.approx(truth, rel=0.01, abs=1e-3 * truth.max())


def test_negative_pixels_take_light_away():
    field = lobed_field()
    field.images[:, :, ::3] *= -0.3
    points, normals = some_points(40, 6)
    got = shade(summed_area_tables(field), irradiance_receivers(points, normals), same_shifts(40), 100_000)
    truth = np.array([irradiance(field, p, n) for p, n in zip(points, normals, strict=True)])
    assert np.abs(got - truth).max() < 5e-3 * truth.max()


def test_a_peak_of_a_hundred_thousand_times_the_mean():
    field = lobed_field("bell", 0.3)
    field.images[2, 2, 12, 13] = 1e5
    points, normals = some_points(60, 8)
    got = luminance_from_rgb(shade(summed_area_tables(field), irradiance_receivers(points, normals), same_shifts(60), 50_000))
    truth = luminance_from_rgb(np.array([irradiance(field, p, n) for p, n in zip(points, normals, strict=True)]))
    lit = truth > 1e-4 * np.median(truth)
    assert np.abs(got[lit] / truth[lit] - 1).max() < 0.02


def test_halton_begins_at_index_1():
    assert halton(4) == pytest.approx(np.array([[1 / 2, 1 / 3], [1 / 4, 2 / 3], [3 / 4, 1 / 9], [1 / 8, 4 / 9]]))


def test_interleaved_shifts_repeat_in_tiles():
    rows, columns = np.indices((8, 8)).reshape(2, -1)
    assert not interleaved_shifts(rows, columns, 1)[:, :2].any()
    shifts = interleaved_shifts(rows, columns, 4).reshape(8, 8, 3)
    assert np.array_equal(shifts[:4, :4], shifts[4:, 4:])
    assert len(np.unique(shifts[:4, :4].reshape(-1, 3), axis=0)) == 16


def test_a_wall_takes_the_light_away():
    field = lobed_field()
    wall = np.array([[[-9, -9, 0.7], [9, -9, 0.7], [0, 9, 0.7]]], float)
    points, normals = np.array([[0, 0, 1.0], [0, 0, 0.6]]), np.tile(DOWN, (2, 1))
    occluders, receivers = Occluders(hierarchy_from_triangles(wall), np.eye(4)), irradiance_receivers(points, normals)
    lit = shade(summed_area_tables(field), receivers, same_shifts(2), 500)
    shadowed = shade(summed_area_tables(field), receivers, same_shifts(2), 500, occluders=occluders)
    assert not shadowed[0].any()
    assert np.array_equal(shadowed[1], lit[1])


def test_a_surface_whose_shading_normal_faces_away_is_dark():
    receivers = irradiance_receivers(np.array([[0.0, 0.0, 1.0]]), DOWN[None])
    assert shade(summed_area_tables(lobed_field()), receivers, same_shifts(1), 100).all()
    for away in ({"normals": -DOWN[None]}, {"flat_normals": -DOWN[None]}):
        assert not shade(summed_area_tables(lobed_field()), receivers._replace(**away), same_shifts(1), 100).any()


def test_images_that_share_a_sequence_do_not_err_alike():
    """RMS error at 200 samples of 25 images: 8 % where each image goes on in the sequence, 21 % where each begins it anew."""
    field, rng = lobed_field("bell", 1.5), np.random.default_rng(3)
    points = np.concatenate([rng.uniform(-0.2, 0.2, (60, 2)), np.full((60, 1), 0.9)], axis=1)
    receivers = irradiance_receivers(points, np.tile(DOWN, (60, 1)))
    truth = luminance_from_rgb(shade(summed_area_tables(field), receivers, same_shifts(60), 50_000))
    error = luminance_from_rgb(shade(summed_area_tables(field), receivers, same_shifts(60), 200)) / truth - 1
    assert np.sqrt(np.mean(error**2)) < 0.12
