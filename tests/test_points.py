import numpy as np
import pytest
from scipy import stats
from scipy.spatial import KDTree

from vemlight.sampler.light_map import light_map
from vemlight.sampler.probes import irradiance_of_lights, irradiance_of_map, probes
from vemlight.sampler.warps.points import halton, points
from vemlight.sampler.warps.square import disc_from_square
from vemlight.sampler.warps.warp import warp_from_map


def test_halton_starts_as_written_down_by_hand():
    expected = [[1 / 2, 1 / 3], [1 / 4, 2 / 3], [3 / 4, 1 / 9], [1 / 8, 4 / 9], [5 / 8, 7 / 9], [3 / 8, 2 / 9]]
    np.testing.assert_allclose(halton(6), expected, atol=1e-15)


@pytest.mark.parametrize(("shorter", "longer"), [(1, 2), (72, 216), (216, 5000)])
@pytest.mark.parametrize("kind", ["disc", "relaxed", "halton"])
def test_a_longer_table_begins_with_the_shorter(shorter, longer, kind):
    np.testing.assert_array_equal(points(longer, kind)[:shorter], points(shorter, kind))


@pytest.mark.parametrize("kind", ["disc", "relaxed", "halton"])
def test_points_lie_inside_the_square_and_apart(kind):
    table = points(3000, kind)
    assert ((table > 0) & (table < 1)).all()
    assert len(np.unique(table, axis=0)) == 3000


def test_points_cannot_be_changed_by_their_users():
    with pytest.raises(ValueError):
        points(10, "relaxed")[0, 0] = 0.0


def edge_error(table: np.ndarray) -> float:
    """RMS over random half-planes of the share of points in it less its area in the unit square (by a fine grid)."""
    generator = np.random.default_rng(1)
    angles, centres = generator.random(1000) * 2 * np.pi, generator.random((1000, 2))
    normals = np.stack([np.cos(angles), np.sin(angles)])
    fine = (np.arange(64) + 0.5) / 64
    grid = np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)
    offsets = (centres.T * normals).sum(axis=0)
    return float(np.sqrt(np.mean(((table @ normals > offsets).mean(axis=0) - (grid @ normals > offsets).mean(axis=0)) ** 2)))


@pytest.mark.parametrize("length", [16, 32, 64, 72, 128, 216, 300, 512])
def test_every_prefix_is_spread_more_evenly_than_haltons(length):
    # What shadows see is the number of points on either side of an edge: relaxed prefixes miss it by a fifth less.
    assert edge_error(points(length, "relaxed")) < edge_error(points(length, "halton"))


@pytest.mark.parametrize("length", [8, 16, 32, 64, 72, 100, 216, 300, 512])
def test_no_two_points_of_a_prefix_are_close(length):
    # In units of the hexagonal lattice's distance; 0.45 is the worst that the multi-prefix relaxation should leave.
    distance, _ = KDTree(points(length, "relaxed")).query(points(length, "relaxed"), k=2)
    assert distance[:, 1].min() / np.sqrt(2 / (np.sqrt(3) * length)) > 0.4


def crowd(values: np.ndarray) -> float:
    """By how many points the share below some limit differs from the limit (n times the star discrepancy)."""
    n = len(values)
    return n * float(stats.kstest(values, "uniform").statistic)


@pytest.mark.parametrize("length", [16, 72, 216, 512, 3000])
def test_on_the_disc_no_radius_and_no_azimuth_is_crowded(length):
    # A radical inverse in base b has at most about b / (4 log b) log n points too many: 0.68 log n in base 3, 5.4 at n = 3000.
    a, w = np.array([disc_from_square(*point) for point in points(length, "disc")]).T
    assert crowd(a) <= 0.7 * np.log(length) + 1
    assert crowd(w) <= 0.7 * np.log(length) + 1


def test_relaxed_points_crowd_the_disc():
    # What makes them worse than plain Halton points for the warps that go through the disc.
    radii = {kind: np.array([disc_from_square(*point)[0] for point in points(512, kind)]) for kind in ("disc", "halton", "relaxed")}
    assert crowd(radii["relaxed"]) > 4 * crowd(radii["halton"])
    assert crowd(radii["relaxed"]) > 8 * crowd(radii["disc"])


def scenes() -> list[np.ndarray]:
    """Skies with clouds, a sun low or high, and windows: polar maps of 45 x 180."""
    generator, made = np.random.default_rng(4), []
    theta, phi = (np.arange(45) + 0.5) / 45, np.arange(180) * np.pi / 90
    for k in range(10):
        gray = (1 + theta[:, None] ** 2) * (1.2 + np.cos(phi - k)[None]) * generator.lognormal(0, 0.5, (45, 180))
        if k % 2:
            gray[4 * k + 2 : 4 * k + 4, 17 * k : 17 * k + 2] += 2e3
        if k % 3 == 0:
            gray[20:35, 10 * k : 10 * k + 30] *= 20
        made.append(np.repeat(gray[..., None], 3, axis=2).astype(np.float32))
    return made


@pytest.mark.parametrize(
    ("method", "other", "most"),
    [
        ("havran-azimuth", "halton", 0.8),
        ("havran-azimuth", "relaxed", 0.95),
        ("havran-radius", "halton", 0.9),
        ("havran-radius", "relaxed", 0.85),
    ],
)
def test_warps_through_the_disc_are_truer_with_points_even_on_the_disc(method, other, most):
    """Irradiance at the probes, geometric mean over scenes and numbers of lights: at most `most` times the other points' error."""
    at, ratios = probes(256, "hemisphere"), []
    for radiance in scenes():
        light = light_map(radiance, "hemisphere")
        truth, warp, errors = irradiance_of_map(at, radiance, "hemisphere"), warp_from_map(light, method), {}
        for name in ("disc", other):
            samples = warp.sample(points(216, name))
            tint = samples.radiance / samples.density[:, None]
            for count in (32, 72, 216):
                irradiance = tint[:count] / tint[:count].sum(axis=0) * light.irradiance
                errors[name, count] = np.linalg.norm(irradiance_of_lights(at, samples.directions[:count], irradiance) - truth)
        ratios += [errors["disc", count] / errors[other, count] for count in (32, 72, 216)]
    assert np.exp(np.mean(np.log(ratios))) < most
