import numpy as np
import pytest

from vemlight.renderer.luminaire.acquisition import AcquisitionPlanes, Quantisation, field_from_radiance
from vemlight.renderer.luminaire.bases import BasisKind, basis, compact_dual, span_dual
from vemlight.renderer.luminaire.lightfield import LightField, far_intensity, flux
from vemlight.renderer.luminaire.reference import irradiance, radiance

DOWN = np.array([0.0, 0.0, -1.0])


def a_field(kind: BasisKind = "bell", rows=3, cols=4, seed=1) -> LightField:
    images = np.random.default_rng(seed).random((rows, cols, 10, 12, 3)).astype(np.float32)
    return LightField(images, kind, 0.05, (-0.075, -0.05), 0.4, (-0.5, -0.4, 0.5, 0.4), "radiometric", "random")


def by_midpoints(field, point, normal=None, n=500):
    """Irradiance from the radiance of n^2 rays, with nothing of the quadrature under test."""
    u = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n * 0.4 - 0.2] * 2), axis=-1)
    r = np.sqrt(np.sum((u - point[:2]) ** 2, axis=-1) + point[2] ** 2)
    s = u + (field.distance_m / point[2]) * (point[:2] - u)
    kernel = point[2] / r**3 * (0.4 / n) ** 2
    if normal is not None:
        kernel = kernel * np.maximum(((u - point[:2]) @ normal[:2] - point[2] * normal[2]) / r, 0)
    return (radiance(field, u, s) * kernel[..., None]).sum(axis=(0, 1))


@pytest.mark.parametrize("kind", ["bell", "b-spline"])
@pytest.mark.parametrize("point", [(0, 0, 0.4), (0.1, 0.05, 0.40001), (0.1, 0.05, 0.39999), (0.1, 0.2, 1.5), (0.03, 0.01, 0.1)])
def test_quadrature_is_the_sum_over_rays(kind, point):
    field, normal = a_field(kind), np.array([0.6, 0.0, -0.8])
    # 500^2 midpoints of a field with jumps at pixel edges: an edge is off by half a step, 1/1000 of the field, at each of 22 edges
    assert irradiance(field, np.array(point, float)) == pytest.approx(by_midpoints(field, np.array(point, float)), rel=3e-3)
    assert irradiance(field, np.array(point, float), normal) == pytest.approx(by_midpoints(field, np.array(point, float), normal), rel=4e-3)


def test_the_sum_of_the_images_is_the_irradiance_on_the_measurement_plane():
    # with the receiver's cosine the kernel phi cos^0 is a polynomial: C times the integral of phi, to the last digit
    field = a_field()
    for row, column in [(0, 0), (4, 7), (9, 11)]:
        s = np.array([-0.5 + (column + 0.5) / 12, -0.4 + (row + 0.5) * 0.08, 0.4])
        assert irradiance(field, s, DOWN) == pytest.approx(field.images[:, :, row, column].sum(axis=(0, 1), dtype=float), rel=1e-9)


def test_flux_is_the_integral_of_radiance_over_rays():
    field = a_field()
    rng = np.random.default_rng(3)
    u, s = rng.uniform(-0.2, 0.2, (200_000, 2)), rng.uniform((-0.5, -0.4), (0.5, 0.4), (200_000, 2))
    cos2 = 1 / (1 + np.sum((s - u) ** 2, axis=-1) / 0.16)
    ours = (radiance(field, u, s) * (cos2**2 / 0.16)[:, None]).mean(axis=0) * (0.4 * 0.4) * (1.0 * 0.8)
    assert ours == pytest.approx(flux(field), rel=0.01)  # 200,000 samples of a spread of 1.6 times the mean: 0.4 %


def test_intensity_far_away_is_irradiance_times_distance_squared():
    field = a_field()
    direction = np.array([[0.3, -0.2, 1.0]]) / np.sqrt(1.13)
    far = 400.0
    # the field is 1 m wide: at 400 m the distance differs by 0.25 % at most, its square by 0.5 %
    assert far_intensity(field, direction)[0] == pytest.approx(irradiance(field, far * direction[0]) * far**2, rel=1e-2)
    assert not far_intensity(field, -direction).any()


def test_there_is_no_light_on_or_behind_the_sampling_plane():
    for z in (0.0, -1e-9, -0.5):
        assert not irradiance(a_field(), np.array([0.0, 0.0, z])).any()


def lambertian(u, _):
    """A smooth glow, cos^2 over a disc of radius 0.5; the same towards all directions."""
    value = np.cos(np.minimum(np.linalg.norm(u, axis=-1), 0.5) * np.pi) ** 2
    return np.repeat(value[:, None], 3, axis=1)


@pytest.fixture(scope="module")
def glow() -> LightField:
    planes = AcquisitionPlanes("bell", 0.125, 13, 13, 0.8, (2.4, 2.4), 48, 48)
    return field_from_radiance(lambertian, planes, span_dual("bell"), (0.5, 0.5), per_spacing=8)


@pytest.mark.parametrize("point", [(0, 0, 2), (0.4, -0.3, 1.5), (1.5, 0.5, 2)])
def test_the_reconstruction_divides_by_cos4_and_does_not_multiply(glow, point):
    """Granier et al. 2003, equation 3, against Lu et al. 2015, whose Psi = Phi delta^2 cos^4 theta is upside down."""
    point = np.array(point, float)
    u = np.stack(np.meshgrid(*[(np.arange(200) + 0.5) / 200 - 0.5] * 2), axis=-1)
    off = u - point[:2]
    cos = point[2] / np.sqrt(np.sum(off**2, axis=-1) + point[2] ** 2)
    source = lambertian(u.reshape(-1, 2), None)[:, 0].reshape(200, 200)
    truth = (source * cos**3).sum() / point[2] ** 2 / 200**2
    assert irradiance(glow, point)[0] == pytest.approx(truth, rel=1e-2)  # pixels are 1/8 of the distance between the planes
    s = u + 0.8 / point[2] * (point[:2] - u)
    printed = (radiance(glow, u, s)[..., 0] * cos**8 * cos**3).sum() / point[2] ** 2 / 200**2
    assert printed < 0.95 * truth


def test_equation_7_of_2015_needs_the_u_that_its_print_leaves_out():
    delta, beyond, p, u = 0.8, 0.5, np.array([0.3, -0.7]), np.array([-0.2, 0.4])
    s = u + delta / (delta + beyond) * (p - u)
    assert s == pytest.approx(np.array([0.1077, -0.2769]), abs=5e-5)
    assert delta / (delta + beyond) * (p - u) == pytest.approx(np.array([0.3077, -0.6769]), abs=5e-5)  # as printed
    # u, s and p lie on one line
    assert np.cross(np.append(s - u, delta), np.append(p - u, delta + beyond)) == pytest.approx(np.zeros(3), abs=1e-12)


def test_the_two_integrals_of_2015_are_one():
    """Equation 4 over S, equation 9 on S and the integral over U with one formula for all p, here for one function and C = 1."""
    field = a_field("b-spline", 1, 1)._replace(images=np.ones((1, 1, 8, 8, 3), np.float32), first_m=(0.01, -0.02))
    for point in (np.array([0.1, 0.05, 0.9]), np.array([0.1, 0.05, 0.4])):
        beyond, h, d = point[2] - 0.4, 0.05, 0.4
        n = 1500
        u = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n * 3 * h - 1.5 * h] * 2), axis=-1) + np.array([0.01, -0.02])
        phi = np.prod(basis("b-spline", (u - [0.01, -0.02]) / h), axis=-1)
        s = u + d / point[2] * (point[:2] - u)
        cos = d / np.sqrt(np.sum((s - u) ** 2, axis=-1) + d * d)
        psi = phi * d * d / cos**4 / h**2
        if beyond:  # ds = (beyond / z_p)^2 du
            distance = np.sqrt(np.sum((s - point[:2]) ** 2, axis=-1) + beyond**2)
            other = beyond * (psi / distance**3).sum() * (beyond / point[2]) ** 2 * (3 * h / n) ** 2
        else:
            other = d * (psi / (d / cos) ** 3).sum() * (3 * h / n) ** 2
        assert irradiance(field, point)[0] == pytest.approx(other, rel=1e-5)


@pytest.mark.parametrize(("quantisation", "worst"), [(None, 1e-3), (Quantisation(slide_bits=8), 5e-3), (Quantisation(8, 12), 6e-3)])
def test_a_field_in_the_span_is_measured_as_it_is(quantisation, worst):
    """Source, bench and reconstruction close the circle: positive and negative lobes apart, with the steps of slide and camera."""
    planes = AcquisitionPlanes("bell", 0.05, 3, 3, 0.4, (0.4, 0.4), 6, 6)
    images = np.random.default_rng(5).random((3, 3, 6, 6, 3))
    truth = planes.field(images, "radiometric", "")
    got = field_from_radiance(lambda u, s: radiance(truth, u, s), planes, compact_dual("bell", 4), (0.1, 0.1), per_spacing=32,
                              quantisation=quantisation)
    # 32 midpoints a spacing err by h^2 / 24 of the second derivative, 4 x 1.4, in each of two directions: 2 x 2.3e-4
    assert np.abs(got.images - truth.images).max() < worst
