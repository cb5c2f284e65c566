import numpy as np
import pytest

from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.reference import irradiance, relative_error, spot_irradiance
from vemlight.renderer.luminaire.shift_invariant import error_bound, is_shift_invariant, radiance_images

DOWN = np.array([0.0, 0.0, -1.0])


def even(distance: float, half: float) -> LightField:
    images = np.ones((3, 3, 16, 16, 3), np.float32)
    return LightField(images, "bell", 0.01, (-0.01, -0.01), distance, (-half, -half, half, half), "radiometric", "even")


@pytest.mark.parametrize(("s", "at_45_degrees"), [(0.02, 0.040), (0.04, 0.080), (0.08, 0.160)])
def test_figure_3_of_2003(s, at_45_degrees):
    theta = np.radians(np.arange(0, 90, 0.5))
    error = relative_error(theta, s)
    assert error.max() == pytest.approx(at_45_degrees, rel=0.01)
    assert np.degrees(theta[error.argmax()]) == pytest.approx(45, abs=3)
    assert relative_error(np.zeros(1), 0.04)[0] == pytest.approx(8e-4, rel=0.01)


def test_the_bound_holds_for_the_geometric_term_over_every_support():
    field = even(0.5, 0.4)
    bound = error_bound(field)
    exact_over_approximate = []
    rng = np.random.default_rng(1)
    s = (np.floor(rng.uniform(0, 16, (4000, 2))) + 0.5) / 16 * 0.8 - 0.4
    centre = rng.choice([-0.01, 0.0, 0.01], (4000, 2))
    u = centre + rng.uniform(-0.01, 0.01, (4000, 2))

    def cos4(a):
        return (1 + np.sum((s - a) ** 2, axis=1) / 0.25) ** -2
    exact_over_approximate = np.abs(cos4(u) - cos4(centre)) / cos4(centre)
    assert exact_over_approximate.max() <= bound
    assert exact_over_approximate.max() > 0.4 * bound  # E_r is the whole range over the support, this one side of it


def test_model_no_more_than_needed():
    assert is_shift_invariant(even(0.5, 0.05))
    assert not is_shift_invariant(even(0.05, 0.1))
    dark = even(0.05, 0.1)
    dark.images[:] = 0
    assert error_bound(dark) == 0


def test_the_images_are_divided_by_the_geometric_term_at_the_centre():
    field = even(0.5, 0.4)
    term = radiance_images(field)[1, 1, 8, 8, 0] / field.images[1, 1, 8, 8, 0]
    tan2 = 2 * 0.025**2 / 0.25
    assert term == pytest.approx((0.5 / 0.01) ** 2 * (1 + tan2) ** 2, rel=1e-6)


def test_a_narrow_lamp_is_as_good_as_exact_and_a_wide_one_stays_near_its_bound():
    narrow = even(0.5, 0.05)
    for point in (np.array([0.0, 0, 1.0]), np.array([0.05, 0.02, 2.0])):
        exact = irradiance(narrow, point, DOWN)
        assert spot_irradiance(narrow, point, DOWN) == pytest.approx(exact, rel=error_bound(narrow) + 1e-3)
    wide = even(0.1, 0.15)
    point = np.array([0.3, 0.1, 0.4])
    assert spot_irradiance(wide, point, DOWN) == pytest.approx(irradiance(wide, point, DOWN), rel=error_bound(wide))


def test_far_away_equation_14_is_exact_but_for_the_bound():
    field = even(0.5, 0.4)
    field.images[:] = np.random.default_rng(2).random(field.images.shape)
    for point in (np.array([1.0, 0.5, 3.0]), np.array([0.2, 0.9, 2.0])):
        # the mean over the support has even weights and phi has not: for grain of single pixels that adds what the box is wide
        assert spot_irradiance(field, point, DOWN) == pytest.approx(irradiance(field, point, DOWN), rel=0.1)


def test_behind_the_lamp_it_is_dark():
    assert not spot_irradiance(even(0.5, 0.4), np.array([0, 0, -0.1])).any()


@pytest.mark.parametrize(("distance_m", "percent"), [(0.74, 7.65), (0.66, 8.57)])
def test_the_approximation_is_accepted_up_to_8_percent(distance_m, percent):
    field = even(distance_m, distance_m)
    assert error_bound(field) == pytest.approx(percent / 100, abs=2e-3)
    assert is_shift_invariant(field) == (percent < 8)


@pytest.mark.parametrize(("level", "counts"), [(7e-4, False), (1.5e-3, True)])
def test_pixels_under_a_thousandth_of_the_brightest_do_not_enter_the_bound(level, counts):
    field = even(1.0, 2.0)
    field.images[:] = 0
    field.images[1, 1, 7:9, 7:9] = 1
    on_axis = error_bound(field)
    field.images[1, 1, 0, 0] = level
    assert (error_bound(field) > 1.5 * on_axis) == counts
