"""The laws of the three warps: sample, density and inverse belong together, light lands where it shines, Havran's maps are continuous."""

import numpy as np
import pytest
from scipy import stats

from vemlight.light.sphere import Coverage, angle_between, angles_from_direction, direction_from_angles
from vemlight.sampler.light_map import FLOOR, light_map
from vemlight.sampler.warps.havran import turn_from_azimuth
from vemlight.sampler.warps.points import halton
from vemlight.sampler.warps.warp import WarpName, steadied, warp_from_map

NAMES: list[WarpName] = ["havran-azimuth", "havran-radius", "standard"]
HAVRAN = NAMES[:2]
SPANS: dict[Coverage, float] = {"hemisphere": 1.0, "sphere": 2.0}  # largest area coordinate a = 1 - cos(theta)


def sky(rows=90, cols=360, sun=0.0, at=(40, 250)):
    """A smooth sky, brighter towards the horizon and one side, with a sun of one pixel."""
    theta = (np.arange(rows) + 0.5) / rows
    phi = (np.arange(cols) + 0.5) / cols * 2 * np.pi
    gray = (1 + theta[:, None] ** 2) * (1.2 + np.cos(phi)[None, :])
    gray[at] += sun
    return (gray[..., None] * [0.8, 1.0, 1.3]).astype(np.float32)


MAPS = {
    "uniform": np.ones((90, 360, 3), np.float32),
    "sky": sky(),
    "sun 1e5": sky(sun=1e5),
    "sun 1e6": sky(sun=1e6),
    "half black and sun": sky(sun=1e5) * (np.arange(360) < 300)[None, :, None].astype(np.float32) * (np.arange(360) > 120)[None, :, None],
    "black": np.zeros((90, 360, 3), np.float32),
    "one pixel": np.eye(90 * 360, dtype=np.float32)[40 * 360 + 250].reshape(90, 360, 1).repeat(3, axis=2),
}


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("scene", MAPS)
def test_round_trip_and_reported_density(scene, name, coverage):
    warp = warp_from_map(light_map(MAPS[scene], coverage), name)
    points = np.random.default_rng(3).random((20_000, 2))
    samples = warp.sample(points)
    assert np.isfinite(samples.directions).all()
    np.testing.assert_allclose(np.linalg.norm(samples.directions, axis=1), 1, atol=1e-14)
    # methods: 2e-15 for a sky, 1e-13 for a sun of 1e6; one lit pixel holds 99.9 % of the square, so its neighbours lose four digits more.
    back = warp.inverse(samples.directions)
    apart = np.abs(back - points).max(axis=1)
    assert np.quantile(apart, 0.999) < 1e-9
    np.testing.assert_allclose(np.quantile(np.abs(warp.density(samples.directions) / samples.density - 1), 0.999), 0, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("scene", ["sky", "sun 1e5", "sun 1e6", "half black and sun"])
def test_directions_come_back_also_from_the_dark(scene, name):
    # Even directions over the hemisphere: half of "half black" lies on the floor (expected 1.2e-9 degrees at a floor of 1e-3).
    generator = np.random.default_rng(4)
    z, phi = generator.random(20_000), generator.random(20_000) * 2 * np.pi
    directions = direction_from_angles(np.arccos(z), phi)
    warp = warp_from_map(light_map(MAPS[scene], "hemisphere"), name)
    back = warp.sample(warp.inverse(directions)).directions
    assert np.degrees(np.quantile(angle_between(back, directions), 0.999)) < 1e-8


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("scene", ["uniform", "sky", "sun 1e5", "half black and sun"])
def test_samples_fall_as_the_density_says(scene, name, coverage):
    # Chi-square over 30 x 36 bins: expected counts are the density integrated over each bin by midpoints, on a grid that has the kinks of
    # the density (borders and centres of rings and columns, 3 and 10 a bin) between its cells.
    n, rows, cols, high, wide = 400_000, 30, 36, 24, 20
    warp = warp_from_map(light_map(MAPS[scene], coverage), name)
    directions = warp.sample(np.random.default_rng(5).random((n, 2))).directions
    theta, phi = angles_from_direction(directions)
    span = np.arccos(1 - SPANS[coverage])
    counts, _, _ = np.histogram2d(theta, phi, bins=(rows, cols), range=[[0, span], [0, 2 * np.pi]])
    edges = np.linspace(0, span, rows * high + 1)
    centres, area = (edges[1:] + edges[:-1]) / 2, -np.diff(np.cos(edges))
    azimuths = (np.arange(cols * wide) + 0.5) * 2 * np.pi / (cols * wide)
    density = warp.density(direction_from_angles(centres[:, None], azimuths[None, :]).reshape(-1, 3))
    expected = n * density.reshape(rows * high, -1) * area[:, None] * (2 * np.pi / (cols * wide))
    assert expected.sum() == pytest.approx(n, rel=2e-3)
    expected = expected.reshape(rows, high, cols, wide).sum(axis=(1, 3))
    expected *= n / expected.sum()
    enough = expected >= 5
    chi2 = ((counts - expected)[enough] ** 2 / expected[enough]).sum()
    assert stats.chi2.sf(chi2, enough.sum() - 1) > 1e-3


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("scene", ["uniform", "sky", "sun 1e5"])
def test_the_inverse_density_averages_to_the_solid_angle(scene, name, coverage):
    # E[1 / density] = solid angle; stratified points, so far better than 1 / sqrt(n). Floor pixels under a 1e5 sun spread it to 0.5 %.
    samples = warp_from_map(light_map(MAPS[scene], coverage), name).sample(halton(400_000))
    assert (1 / samples.density).mean() == pytest.approx(2 * np.pi * SPANS[coverage], rel=5e-3)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("scene", ["sky", "sun 1e5"])
def test_the_jacobian_is_the_inverse_of_the_density(scene, name):
    warp, step = warp_from_map(light_map(MAPS[scene], "hemisphere"), name), 1e-7
    points = 0.01 + 0.98 * np.random.default_rng(6).random((5000, 2))
    right, left = (warp.sample(points + np.array([sign * step, 0])).directions for sign in (1, -1))
    up, down = (warp.sample(points + np.array([0, sign * step])).directions for sign in (1, -1))
    area = np.linalg.norm(np.cross(right - left, up - down), axis=1) / (2 * step) ** 2
    product = area * warp.sample(points).density
    assert np.median(product) == pytest.approx(1, abs=1e-5)
    assert np.quantile(np.abs(product - 1), 0.98) < 1e-3  # the rest straddles a border between cells


@pytest.mark.parametrize("name", HAVRAN)
@pytest.mark.parametrize("scene", ["sky", "sun 1e5"])
def test_havran_is_continuous_across_the_squares_cut(scene, name):
    warp = warp_from_map(light_map(MAPS[scene], "hemisphere"), name)
    r = 0.5 + 0.499 * np.linspace(0.05, 1, 200)
    for h, bound in ((1e-5, 5.0), (1e-7, 5e-2), (1e-9, 5e-4)):  # Lipschitz: a hundredth of h, a hundredth of the angle
        above = warp.sample(np.stack([r, np.full(200, 0.5 + h)], axis=1)).directions
        below = warp.sample(np.stack([r, np.full(200, 0.5 - h)], axis=1)).directions
        assert np.degrees(angle_between(above, below)).max() < bound


@pytest.mark.parametrize("name", HAVRAN)
def test_neighbours_across_azimuth_zero_are_neighbours_in_the_square(name):
    warp = warp_from_map(light_map(MAPS["sky"], "hemisphere"), name)
    theta = np.linspace(0.1, 1.5, 100)
    before, after = (warp.inverse(direction_from_angles(theta, np.radians(sign * 0.005) % (2 * np.pi))) for sign in (-1, 1))
    assert np.abs(before - after).max() < 2e-4  # methods: 1.1e-4 for directions 0.01 degrees apart


@pytest.mark.parametrize("name", HAVRAN)
def test_the_squares_centre_is_the_zenith_and_its_edge_the_rim(name):
    for coverage, span in SPANS.items():
        warp = warp_from_map(light_map(MAPS["sun 1e5"], coverage), name)
        assert warp.sample(np.array([[0.5, 0.5]])).directions[0, 2] == 1
        edge = np.stack([np.ones(50), np.linspace(0, 1, 50)], axis=1)
        np.testing.assert_allclose(warp.sample(edge).directions[:, 2], 1 - span, atol=1e-12)


def test_only_the_standard_inversion_jumps_between_rings():
    # The square's u at which the standard inversion changes rings; a step of 1e-12 there is a jump over the sky.
    light = light_map(MAPS["sun 1e5"], "hemisphere")
    warp = warp_from_map(light, "standard")
    border = warp.tables.outward[38:44] / warp.tables.outward[-1]
    around = [warp.sample(np.stack([border + h, np.full(6, 0.3)], axis=1)).directions for h in (-1e-12, 1e-12)]
    assert np.degrees(angle_between(*around)).max() > 10
    for name in HAVRAN:
        warp = warp_from_map(light, name)
        points = np.random.default_rng(7).random((20_000, 2))
        points = points[(points > 1e-6).all(axis=1) & (points < 1 - 1e-6).all(axis=1)]
        apart = angle_between(warp.sample(points).directions, warp.sample(points + np.array([1e-12, 0])).directions)
        assert np.degrees(apart).max() < 1e-4


def test_a_small_sun_keeps_its_light():
    # Share of the samples within 3 x 3 pixels of a sun of 1e5 against the share of the power there; 0.59 for normalised tables.
    light = light_map(MAPS["sun 1e5"], "hemisphere")
    areas = -np.diff(np.cos(np.arange(91) * np.pi / 180))
    power = light.importance * areas[:, None]
    truth = power[39:42, 249:252].sum() / power.sum()
    for name in NAMES:
        theta, phi = angles_from_direction(warp_from_map(light, name).sample(halton(100_000)).directions)
        near = (theta >= np.radians(39)) & (theta < np.radians(42)) & (phi >= np.radians(249)) & (phi < np.radians(252))
        assert near.mean() == pytest.approx(truth, abs=0.005)


def test_one_lit_pixel_draws_all_but_the_floor():
    for coverage, row in SPANS.items():  # degrees a row
        for name in NAMES:
            warp = warp_from_map(light_map(MAPS["one pixel"], coverage), name)
            theta, phi = angles_from_direction(warp.sample(halton(50_000)).directions)
            near = (np.abs(np.degrees(theta) - 40.5 * row) < 1.5 * row) & (np.abs(np.degrees(phi) - 250.5) < 1.5)
            assert near.mean() == pytest.approx(1 - FLOOR, abs=2e-3)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("row", [0, 89])
def test_light_at_the_pole_and_on_the_horizon(name, row):
    ring = np.zeros((90, 360, 3), np.float32)
    ring[row] = 1.0
    directions = warp_from_map(light_map(ring, "hemisphere"), name).sample(halton(20_000)).directions
    theta = np.degrees(np.arccos(np.clip(directions[:, 2], -1, 1)))
    # The tables are linear between the centres of rings, which leaks a little into the neighbouring ring.
    assert (np.abs(theta - row - 0.5) < 1.5).mean() > 0.99
    assert np.abs(directions[:, :2].mean(axis=0)).max() < 0.01


def test_a_rotating_sun_does_not_sweep_the_others_round_the_sky():
    # Sun of 1e4 at 0.5 degrees a frame through phi = 0, 216 lights; without the offset the worst frame moves all by 7 degrees on average.
    points, last = halton(216), {}
    worst = dict.fromkeys(HAVRAN, 0.0)
    for step in range(-20, 21):
        radiance = sky(rows=90, cols=720) * 0 + 1
        radiance[50, step % 720] += 1e4
        light = light_map(radiance, "hemisphere")
        for name in HAVRAN:
            directions = warp_from_map(light, name).sample(points).directions
            if name in last:
                worst[name] = max(worst[name], np.degrees(angle_between(directions, last[name])).mean())
            last[name] = directions
    assert worst["havran-azimuth"] < 0.6
    assert worst["havran-radius"] < 0.6


def test_the_anchor_steadies_the_offset_and_outlives_light_that_crosses_azimuth_zero():
    points = halton(216)
    still, anchor = steadied(warp_from_map(light_map(MAPS["sky"], "hemisphere"), "havran-azimuth"), None, 0.3)
    assert anchor is not None
    again, _ = steadied(warp_from_map(light_map(MAPS["sky"], "hemisphere"), "havran-azimuth"), anchor, 0.3)
    np.testing.assert_allclose(again.sample(points).directions, still.sample(points).directions, atol=1e-12)
    # Noise of 20 % on a coarse map: the azimuth on the disc of a fixed azimuth shakes less than with the offset of each frame alone.
    shaken = {}
    for gain in (0.3, 1.0):
        generator, anchor, turns = np.random.default_rng(8), None, []
        for _ in range(60):
            radiance = sky(12, 24, at=(5, 3)) * (1 + 0.2 * generator.standard_normal((12, 24, 1))).astype(np.float32)
            warp, anchor = steadied(warp_from_map(light_map(radiance, "hemisphere"), "havran-azimuth"), anchor, gain)
            turns.append(turn_from_azimuth(warp.tables, 3.0))
        shaken[gain] = np.abs(np.diff(turns)).mean()
    assert shaken[0.3] < 0.7 * shaken[1.0]
    # A sun through azimuth zero: the smoothed offset does not sweep the lights round either.
    anchor, last, worst = None, None, 0.0
    for step in range(-20, 21):
        radiance = np.ones((90, 720, 3), np.float32)
        radiance[50, step % 720] += 1e4
        warp, anchor = steadied(warp_from_map(light_map(radiance, "hemisphere"), "havran-azimuth"), anchor, 0.3)
        now = warp.sample(points).directions
        worst = worst if last is None else max(worst, float(np.degrees(angle_between(now, last)).mean()))
        last = now
    assert worst < 0.6


def test_the_plain_form_of_the_tables_gives_the_same():
    # Numpy by hand for the azimuth-first order, one sample at a time, searching the whole table.
    light = light_map(sky(12, 24, sun=50.0, at=(5, 3)), "hemisphere")
    tables = warp_from_map(light, "havran-azimuth").tables
    edges = 1 - np.cos(np.linspace(0, np.pi / 2, 13))
    columns = np.concatenate([np.zeros((1, 24)), np.cumsum(light.importance * np.diff(edges)[:, None], axis=0)])
    np.testing.assert_allclose(tables.edges, edges, atol=1e-15)
    np.testing.assert_allclose(tables.columns, columns, rtol=1e-12)
    marginal = columns[-1]
    turn = np.concatenate([[0], np.cumsum((marginal + np.roll(marginal, -1)) / 2 * 2 * np.pi / 24)])
    np.testing.assert_allclose(tables.turn, turn, rtol=1e-12)
    fine = (np.arange(240_000) + 0.5) * 2 * np.pi / 240_000
    density = np.interp(fine / (2 * np.pi / 24), np.arange(25), np.append(marginal, marginal[0]))
    assert tables.offset == pytest.approx(0.5 - (fine * density).sum() / density.sum() / (2 * np.pi), abs=1e-8)


def disc(points):
    """Squared radius and turns of points (n, 2): Shirley and Chiu's map, quarter by quarter."""
    x, y = 2 * points.T - 1
    r = np.maximum(np.abs(x), np.abs(y))
    quarters = [(x >= np.abs(y), y), (y > np.abs(x), -x), (-x >= np.abs(y), -y), (-y > np.abs(x), x)]
    w = np.select([inside for inside, _ in quarters], [k / 4 + way / np.where(r > 0, r, 1) / 8 for k, (_, way) in enumerate(quarters)])
    return r * r, w % 1.0


def linear_inverse(knots, density, x):
    """Where the integral of a density, linear between knots, reaches x, by halving each interval fifty times."""
    integral = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(knots))])
    i = np.clip(np.searchsorted(integral, x, "right") - 1, 0, len(knots) - 2)
    h, rest, low, high = knots[i + 1] - knots[i], x - integral[i], np.zeros(len(x)), np.ones(len(x))
    for _ in range(50):
        t = (low + high) / 2
        over = h * t * (density[i] + t / 2 * (density[i + 1] - density[i])) > rest
        low, high = np.where(over, low, t), np.where(over, t, high)
    return i, (low + high) / 2


def inside(cumulative, x):
    """Cell and way through it where each row of cumulative (n, cells + 1) reaches x (n,)."""
    i = np.clip((cumulative <= x[:, None]).sum(axis=1) - 1, 0, cumulative.shape[1] - 2)
    each = np.arange(len(x))
    return i, (x - cumulative[each, i]) / (cumulative[each, i + 1] - cumulative[each, i])


def plain_directions(name, importance, points):
    """The three ways in numpy, on the hemisphere, whole tables at a time."""
    rows, cols = importance.shape
    edges, h = 1 - np.cos(np.linspace(0, np.pi / 2, rows + 1)), 2 * np.pi / cols
    rings = np.concatenate([np.zeros((rows, 1)), np.cumsum(importance * h, axis=1)], axis=1)
    columns = np.concatenate([np.zeros((1, cols)), np.cumsum(importance * np.diff(edges)[:, None], axis=0)])
    if name == "standard":
        outward = np.concatenate([[0], np.cumsum(rings[:, -1] * np.diff(edges))])
        i, share = inside(np.tile(outward, (len(points), 1)), points[:, 0] * outward[-1])
        j, way = inside(rings[i], points[:, 1] * rings[i, -1])
        return direction_from_angles(np.arccos(1 - edges[i] - share * np.diff(edges)[i]), (j + way) * h)
    a, w = disc(points)
    if name == "havran-azimuth":
        marginal = np.append(columns[-1], columns[-1, 0])
        knots = np.arange(cols + 1) * h
        middle, between = (knots[1:] + knots[:-1]) / 2, (marginal[1:] + marginal[:-1]) / 2
        parts = knots[:-1] * marginal[:-1] + 4 * middle * between + knots[1:] * marginal[1:]
        mean = parts.sum() * h / 6 / np.trapezoid(marginal, knots)  # Simpson's rule, exact for a linear density times the azimuth
        total = np.trapezoid(marginal, knots)
        j, t = linear_inverse(knots, marginal, (w + 0.5 - mean / (2 * np.pi)) % 1.0 * total)
        mixed = ((1 - t) * columns[:, j] + t * columns[:, (j + 1) % cols]).T
        i, share = inside(mixed, a * mixed[:, -1])
        return direction_from_angles(np.arccos(1 - edges[i] - share * np.diff(edges)[i]), (j + t + 0.5) * h)
    centres = 1 - np.cos((np.arange(rows) + 0.5) * np.pi / 2 / rows)
    knots, which = np.concatenate([[0], centres, [1]]), np.concatenate([[0], np.arange(rows), [rows - 1]])
    total = np.trapezoid(rings[which, -1], knots)
    s, t = linear_inverse(knots, rings[which, -1], a * total)
    mixed = (1 - t)[:, None] * rings[which[s]] + t[:, None] * rings[which[s + 1]]
    mean = (np.diff(mixed, axis=1) * (np.arange(cols) + 0.5)).sum(axis=1) / cols / mixed[:, -1]
    j, way = inside(mixed, (w + 0.5 - mean) % 1.0 * mixed[:, -1])
    return direction_from_angles(np.arccos(1 - knots[s] - t * np.diff(knots)[s]), (j + way) * h)


@pytest.mark.parametrize("count", [1, 64, 1000])
@pytest.mark.parametrize("name", NAMES)
def test_samples_are_those_of_the_plain_form(name, count):
    radiance = sky(12, 24, sun=50.0, at=(5, 3)) * np.random.default_rng(8).lognormal(0, 1, (12, 24, 1)).astype(np.float32)
    light, points = light_map(radiance, "hemisphere"), np.random.default_rng(9).random((count, 2))
    directions = warp_from_map(light, name).sample(points).directions
    np.testing.assert_allclose(directions, plain_directions(name, light.importance, points), atol=1e-8)  # arccos near the zenith
