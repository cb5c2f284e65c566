import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st
from scipy.stats import chi2

from vemlight.light.colour import luminance_from_rgb
from vemlight.renderer.luminaire.bases import Kind
from vemlight.renderer.luminaire.estimator import halton, interleaving, receivers, shade
from vemlight.renderer.luminaire.lightfield import LightField, irradiance
from vemlight.renderer.luminaire.occlusion import blocked, hierarchy_of
from vemlight.renderer.luminaire.tables import (
    axis_box,
    box_density,
    invert_box,
    mean_importance,
    mean_over_box,
    sample_box,
    table_at,
    tables_of,
)

DOWN = np.array([0.0, 0.0, -1.0])


def a_field(kind: Kind = "bell", contrast: float = 1.0, seed: int = 1) -> LightField:
    """A lamp-like field: a lobe that moves over the image with the basis function, tinted, with log-normal grain of `contrast`."""
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(np.linspace(-1, 1, 24), np.linspace(-1, 1, 24), indexing="ij")
    images = np.empty((5, 5, 24, 24, 3))
    for j, i in np.ndindex(5, 5):
        lobe = np.exp(-3 * ((x - (i - 2) / 5) ** 2 + (y - (j - 2) / 5) ** 2)) * np.exp(contrast * rng.normal(size=(24, 24)))
        images[j, i] = lobe[..., None] * [1.0, 0.8 + 0.2 * i / 5, 0.6]
    return LightField(images.astype(np.float32), kind, 0.05, (-0.1, -0.1), 0.4, (-0.5, -0.5, 0.5, 0.5), "radiometric", "lobes")


def some_points(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Places before, on, within 1e-4 of, between and far from the planes, with surfaces that face the lamp or graze its light."""
    rng = np.random.default_rng(seed)
    z = rng.choice([0.1, 0.25, 0.3999, 0.39999, 0.4, 0.40001, 0.4001, 0.41, 0.6, 1.0, 3.0], count)
    points = np.concatenate([rng.uniform(-0.3, 0.3, (count, 2)) * np.maximum(z / 0.4, 1)[:, None], z[:, None]], axis=1)
    normals = rng.normal(size=(count, 3)) * [1, 1, 0.4]
    normals[:, 2] = -np.abs(normals[:, 2]) - 0.2
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def same(count: int) -> np.ndarray:
    return interleaving(np.zeros(count, int), np.zeros(count, int), 1)


@pytest.mark.parametrize("kind", ["bell", "b-spline"])
def test_a_hundred_thousand_samples_give_the_exact_irradiance(kind):
    field = a_field(kind)
    points, normals = some_points(90, 4)
    got = luminance_from_rgb(shade(tables_of(field), receivers(points, normals), same(90), 100_000))
    truth = luminance_from_rgb(np.array([irradiance(field, p, n) for p, n in zip(points, normals, strict=True)]))
    lit = truth > 1e-4 * truth.max()
    assert lit.sum() > 60
    assert np.abs(got[lit] / truth[lit] - 1).max() < 2e-3


def test_a_point_at_grazing_height_above_the_lamp_is_as_exact():
    field = a_field()
    points = np.array([[0.02, 0.01, z] for z in (1e-4, 1e-3, 5e-3, 0.02)])
    for normal in (DOWN, np.array([-0.9, 0.0, -0.436])):
        got = luminance_from_rgb(shade(tables_of(field), receivers(points, np.tile(normal, (4, 1))), same(4), 100_000))
        truth = luminance_from_rgb(np.array([irradiance(field, p, normal) for p in points]))
        assert np.abs(got / truth - 1).max() < 2e-3


def test_few_samples_are_right_on_average():
    """Unbiased: 4,000 estimates of 5 samples each, shifted at random, average to the integral (4,000 x 5 samples of spread 1.5: 1 %)."""
    field, rng = a_field("bell", 1.5), np.random.default_rng(1)
    for point in (np.array([0.1, 0.05, 0.9]), np.array([0.0, 0.1, 0.4]), np.array([0.05, 0.0, 0.2])):
        got = shade(tables_of(field), receivers(np.tile(point, (4000, 1)), np.tile(DOWN, (4000, 1))), rng.random((4000, 3)), 5)
        assert luminance_from_rgb(got.mean(axis=0)) == pytest.approx(luminance_from_rgb(irradiance(field, point, DOWN)), rel=0.04)


def test_a_cap_on_the_samples_of_an_image_adds_no_bias():
    field = a_field()
    points, normals = some_points(40, 9)
    got = luminance_from_rgb(shade(tables_of(field), receivers(points, normals), same(40), 40_000, most=900))
    truth = luminance_from_rgb(np.array([irradiance(field, p, n) for p, n in zip(points, normals, strict=True)]))
    lit = truth > 1e-4 * truth.max()
    assert np.abs(got[lit] / truth[lit] - 1).max() < 0.03


def test_behind_the_lamp_and_beside_all_supports_it_is_dark():
    field = a_field()
    points = np.array([[0, 0, 0.0], [0, 0, -0.1], [0, 0, -1e-12], [5, 0, 0.4], [40, 0, 1.0]], float)
    out = shade(tables_of(field), receivers(points, np.tile(DOWN, (5, 1))), same(5), 100)
    assert not out.any()


def test_black_images_and_one_lit_pixel():
    black = a_field()._replace(images=np.zeros((5, 5, 24, 24, 3), np.float32))
    points, normals = some_points(50, 2)
    assert not shade(tables_of(black), receivers(points, normals), same(50), 100).any()
    black.images[2, 3, 7, 11] = [1, 2, 4]
    got = shade(tables_of(black), receivers(points, normals), same(50), 20_000)
    truth = np.array([irradiance(black, p, n) for p, n in zip(points, normals, strict=True)])
    assert np.all(np.isfinite(got))
    assert got == pytest.approx(truth, rel=0.01, abs=1e-3 * truth.max())


def test_negative_pixels_take_light_away():
    field = a_field()
    field.images[:, :, ::3] *= -0.3
    points, normals = some_points(40, 6)
    got = shade(tables_of(field), receivers(points, normals), same(40), 100_000)
    truth = np.array([irradiance(field, p, n) for p, n in zip(points, normals, strict=True)])
    assert np.abs(got - truth).max() < 5e-3 * truth.max()


def test_a_peak_of_a_hundred_thousand_times_the_mean():
    field = a_field("bell", 0.3)
    field.images[2, 2, 12, 13] = 1e5
    points, normals = some_points(60, 8)
    got = luminance_from_rgb(shade(tables_of(field), receivers(points, normals), same(60), 50_000))
    truth = luminance_from_rgb(np.array([irradiance(field, p, n) for p, n in zip(points, normals, strict=True)]))
    lit = truth > 1e-4 * np.median(truth)
    assert np.abs(got[lit] / truth[lit] - 1).max() < 0.02


def test_a_box_is_the_sum_of_its_pixels():
    tables, rng = tables_of(a_field("bell", 2.0)), np.random.default_rng(3)
    for _ in range(200):
        x0, x1, y0, y1 = *np.sort(rng.uniform(0, 24, 2)), *np.sort(rng.uniform(0, 24, 2))
        if rng.random() < 0.5:
            x1, y1 = min(x0 + 10.0 ** rng.uniform(-9, 0), 24), min(y0 + 10.0 ** rng.uniform(-9, 0), 24)
        plain = mean_over_box(np.repeat(tables.importance[3][..., None], 3, axis=2), (x0, x1, y0, y1))[0]
        assert mean_importance(tables.sums[3], tables.importance[3], x0, x1, y0, y1) == pytest.approx(plain, rel=1e-6)


@pytest.mark.parametrize("box", [(3.3, 17.8, 5.1, 20.4), (3.3, 4.7, 5.1, 5.6), (3.3, 9.9, 5.1, 5.6), (0.0, 24.0, 0.0, 24.0)])
def test_samples_of_a_box_have_its_density(box):
    """Chi-square over pixels; the printed marginal of equation 8, the whole image's cut to the box, fails where they are no products."""
    tables, rng = tables_of(a_field("bell", 1.5)), np.random.default_rng(5)
    sums, importance = tables.sums[7], tables.importance[7]
    counts = np.zeros((24, 24))
    n = 20_000
    x0, x1, y0, y1 = box
    for a, b in rng.random((n, 2)):
        x, y, row, column = sample_box(sums, importance, x0, x1, y0, y1, a, b)
        assert 0 <= x <= 1
        assert 0 <= y <= 1
        counts[row, column] += 1
    overlap = [np.clip(np.minimum(high, np.arange(24) + 1) - np.maximum(low, np.arange(24)), 0, None) for low, high in (box[2:], box[:2])]
    density = np.array([[box_density(sums, importance, x0, x1, y0, y1, j, i) for i in range(24)] for j in range(24)])
    expected = n * overlap[0][:, None] * overlap[1] * density / ((box[1] - box[0]) * (box[3] - box[2]))
    assert expected.sum() == pytest.approx(n, rel=1e-9)
    cells = expected >= 5
    assert counts[expected == 0].sum() == 0
    statistic = ((counts - expected)[cells] ** 2 / expected[cells]).sum()
    assert chi2.sf(statistic, cells.sum() - 1) > 1e-3
    if cells.sum() > 100 and overlap[0].min() == 0:
        whole = overlap[1] * importance.sum(axis=0)
        rows = overlap[0][:, None] * importance
        printed = n * whole / whole.sum() * rows / rows.sum(axis=0)
        assert chi2.sf(((printed - expected)[cells] ** 2 / expected[cells]).sum(), cells.sum() - 1) < 1e-6


@given(st.floats(0.001, 0.999), st.floats(0.001, 0.999))
@example_settings(max_examples=60)
def test_inverting_a_sample_brings_the_numbers_back(a, b):
    tables = tables_of(a_field("bell", 1.0))
    box = (3.3, 17.8, 5.1, 20.4)
    x, y, _, _ = sample_box(*(tables.sums[7], tables.importance[7], *box, a, b))
    assert invert_box(*(tables.sums[7], *box, x, y)) == pytest.approx((a, b), abs=1e-9)


def test_a_dark_pixel_is_never_drawn():
    field = a_field()
    field.images[:, :, :, 5:9] = 0
    field.images[:, :, 10:12] = 0
    tables, rng = tables_of(field), np.random.default_rng(5)
    for a, b in [*rng.random((2000, 2)), (0.0, 0.0), (1 - 2**-53, 1 - 2**-53)]:
        for box in ((0.0, 24.0, 0.0, 24.0), (8.5, 9.5, 9.2, 10.7), (4.0, 20.0, 9.0, 13.0)):
            _, _, row, column = sample_box(*(tables.sums[7], tables.importance[7], *box, a, b))
            assert tables.importance[7, row, column] > 0


@given(p=st.floats(-2, 2), z=st.floats(1e-3, 5), low=st.floats(-1, 1))
@example_settings(max_examples=200)
def test_points_of_the_support_are_seen_through_the_box(p, z, low):
    """Between the planes, where Delta is negative, the box is mirrored; the printed |Delta| gives another box."""
    x0, x1, u0, u1 = axis_box(low, low + 0.1, p, 0.4 / z, -0.5, 0.05, 20)
    for u in np.linspace(low, low + 0.1, 7):
        x = (u + 0.4 / z * (p - u) + 0.5) / 0.05
        if 0 < x < 20:
            assert x0 - 1e-9 <= x <= x1 + 1e-9
            assert min(u0, u1) - 1e-9 <= u <= max(u0, u1) + 1e-9
            if x1 - x0 > 1e-6:
                assert u0 + (u1 - u0) * (x - x0) / (x1 - x0) == pytest.approx(u, abs=1e-6)


def counts_of(rounding, shares: np.ndarray, samples: int) -> tuple[float, int]:
    """(energy lost by images without samples, sum of samples) of a rounding."""
    k = rounding(samples * shares / shares.sum())
    return float(shares[k == 0].sum() / shares.sum()), int(k.sum())


def test_rounding_to_the_nearest_loses_what_systematic_rounding_keeps():
    rng = np.random.default_rng(1)
    for images, samples, lost in ((25, 200, 0.007), (63, 200, 0.025), (99, 200, 0.043), (63, 63, 0.088), (99, 50, 0.16)):
        draws = [np.exp(2 * rng.normal(size=images)) for _ in range(400)]
        nearest = np.mean([counts_of(np.rint, a, samples)[0] for a in draws])
        assert nearest == pytest.approx(lost, rel=0.25)
        total = np.zeros(images)
        for _ in range(4000):
            edges = np.floor(np.concatenate([[0], np.cumsum(samples * draws[0] / draws[0].sum())]) + rng.random())
            assert np.diff(edges).sum() in (samples - 1, samples, samples + 1)  # cumsum may end 1e-14 off a whole number
            total += np.diff(edges)
        assert np.abs(total / 4000 - samples * draws[0] / draws[0].sum()).max() < 0.04  # 4000 draws of spread below 1/2: 0.008


def test_halton_begins_at_index_1():
    assert halton(4) == pytest.approx(np.array([[1 / 2, 1 / 3], [1 / 4, 2 / 3], [3 / 4, 1 / 9], [1 / 8, 4 / 9]]))


def test_interleaving_repeats_in_tiles():
    rows, columns = np.indices((8, 8)).reshape(2, -1)
    assert not interleaving(rows, columns, 1)[:, :2].any()
    shifts = interleaving(rows, columns, 4).reshape(8, 8, 3)
    assert np.array_equal(shifts[:4, :4], shifts[4:, 4:])
    assert len(np.unique(shifts[:4, :4].reshape(-1, 3), axis=0)) == 16


def test_rays_are_blocked_by_the_triangles_they_meet():
    rng = np.random.default_rng(3)
    corners = rng.uniform(-1, 1, (80, 1, 3)) + rng.uniform(-0.3, 0.3, (80, 3, 3))
    scene = hierarchy_of(corners)
    singles = [hierarchy_of(corners[k : k + 1]) for k in range(80)]
    hits = 0
    for _ in range(150):
        o, target = rng.uniform(-2, 2, 3), rng.uniform(-1, 1, 3)
        d = target - o
        expected = any(blocked(*(one, *o, *d, 0.0, 1.5)) for one in singles)
        assert blocked(*(scene, *o, *d, 0.0, 1.5)) == expected
        hits += expected
    assert 20 < hits < 140
    assert not blocked(*(hierarchy_of(np.zeros((0, 3, 3))), *np.zeros(3), *np.ones(3), 0.0, 1.0))


def test_a_wall_takes_the_light_away():
    field = a_field()
    wall = np.array([[[-9, -9, 0.7], [9, -9, 0.7], [0, 9, 0.7]]], float)
    points, normals = np.array([[0, 0, 1.0], [0, 0, 0.6]]), np.tile(DOWN, (2, 1))
    lit = shade(tables_of(field), receivers(points, normals), same(2), 500)
    shadowed = shade(tables_of(field), receivers(points, normals), same(2), 500, scene=hierarchy_of(wall))
    assert not shadowed[0].any()
    assert np.array_equal(shadowed[1], lit[1])


def test_table_corners_are_totals():
    tables = tables_of(a_field())
    assert table_at(tables.sums[0], 24.0, 24.0) == pytest.approx(tables.importance[0].sum())
    assert table_at(tables.sums[0], 0.0, 24.0) == 0
