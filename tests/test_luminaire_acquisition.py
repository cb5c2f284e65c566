import numpy as np
import pytest

from vemlight.light.colour import luminance_from_rgb
from vemlight.renderer.luminaire.acquisition import AcquisitionPlanes, Rays, field_from_rays, quantised, waist_z_m
from vemlight.renderer.luminaire.bases import span_dual
from vemlight.renderer.luminaire.goniophotometer import ReflectorLamp, lamp_radiance, lamp_rays, measured_lamp
from vemlight.renderer.luminaire.lightfield import flux
from vemlight.renderer.luminaire.reference import irradiance

PLANES = AcquisitionPlanes("bell", 0.0075, 11, 11, 0.05, (0.1, 0.1), 20, 20)
LAMP = ReflectorLamp(radiance=(5.0, 4.0, 3.0))


@pytest.fixture(scope="module")
def rays() -> Rays:
    return lamp_rays(LAMP, 200_000, 2.6, 7)  # tan(theta) from the aperture's rim to the window's far side: 0.13 / 0.05


def test_the_flux_budget_adds_up_to_all_flux(rays):
    turned = rays._replace(directions=np.concatenate([-rays.directions[:50_000], rays.directions[50_000:]]))
    field, flux_budget = field_from_rays(turned, PLANES, 0.0, "photometric", "lamp")
    assert sum(flux_budget[1:]) == pytest.approx(flux_budget.total, rel=1e-9)
    assert flux_budget.backward == pytest.approx(luminance_from_rgb(rays.flux[:50_000]).sum(), rel=1e-9)
    assert luminance_from_rgb(flux(field)) == pytest.approx(flux_budget.captured, rel=1e-5)


def test_rays_within_the_planes_keep_their_flux(rays):
    inside = Rays(rays.positions * 0.7, rays.directions * [0.5, 0.5, 1], rays.flux)
    inside = inside._replace(directions=inside.directions / np.linalg.norm(inside.directions, axis=1, keepdims=True))
    field, flux_budget = field_from_rays(inside, PLANES, 0.0, "radiometric", "lamp")
    # the lamp ends 3.7 spacings before the grid's last function: tails of 0.156^3.7 = 0.1 % of what lies there
    assert flux(field) == pytest.approx(inside.flux.sum(axis=0), rel=2e-3)
    assert abs(flux_budget.filter_tails) < 2e-3 * flux_budget.total


def test_rays_and_the_virtual_goniophotometer_measure_the_same_lamp(rays):
    from_rays, _ = field_from_rays(rays, PLANES, 0.0, "photometric", "lamp")
    from_bench = measured_lamp(LAMP, PLANES, span_dual("bell"), per_spacing=8)
    # one ray in 40 leads back to the ball: 5,000 of very unequal flux, which stray by 4 %; on the axis fewer pass near a point
    assert flux(from_rays) == pytest.approx(flux(from_bench), rel=0.1)
    for z in (0.1, 0.3):
        point = np.array([0.0, 0.0, z])
        assert irradiance(from_rays, point) == pytest.approx(irradiance(from_bench, point), rel=0.2)


def test_a_ball_at_the_focus_is_seen_in_the_whole_mirror_along_the_axis():
    u = np.stack(np.meshgrid(*[np.linspace(-0.029, 0.029, 41)] * 2), axis=-1).reshape(-1, 2)
    u = u[np.linalg.norm(u, axis=-1) < 0.029]
    value = lamp_radiance(LAMP, u, u, 0.05)  # rays parallel to the axis meet at the focus
    direct = np.linalg.norm(u, axis=-1) < LAMP.ball_radius_m
    assert np.allclose(value[direct], LAMP.radiance)
    assert np.allclose(value[~direct], np.array(LAMP.radiance) * LAMP.reflectance)
    beside = lamp_radiance(LAMP, np.array([[0.031, 0.0]]), np.array([[0.031, 0.0]]), 0.05)
    assert not beside.any()


def test_the_waist_is_where_rays_cross():
    rng = np.random.default_rng(2)
    slope = rng.normal(0, 0.3, (500, 2))
    directions = np.concatenate([slope, np.ones((500, 1))], axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    positions = np.array([0.002, -0.001, -0.013]) + directions * rng.uniform(0.01, 0.05, (500, 1))
    assert waist_z_m(Rays(positions, directions, np.ones((500, 3)))) == pytest.approx(-0.013, abs=1e-9)


def test_rounding_keeps_ends_and_darkness():
    values = np.linspace(0, 2, 1001)
    steps = quantised(values, 2.0, 3)
    assert len(np.unique(np.round(steps, 9))) == 8
    assert steps[[0, -1]].tolist() == [0.0, 2.0]
    assert np.array_equal(quantised(values, 2.0, 0), values)
    assert np.array_equal(quantised(np.zeros(3), 0.0, 8), np.zeros(3))


@pytest.mark.parametrize(("z", "counts"), [(0.03, False), (0.08, True)])
def test_flat_rays_do_not_move_the_waist(z, counts):
    """A ray flatter than 87 degrees that starts 5 mm above the crossing of two steep ones, with as much flux."""
    across = np.sqrt(1 - z**2)
    directions = np.array([[0.6, 0, 0.8], [-0.6, 0, 0.8], [across, 0, z]])
    positions = np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0.005]], float)
    assert (waist_z_m(Rays(positions, directions, np.ones((3, 3)))) > 1e-3) == counts
