"""Lights with extent: exact light, exact second moments, and shadows nearer to the map's than those of points."""

import numpy as np
import pytest
from scipy.special import ndtr

from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.light.light_set import are_covariances
from vemlight.light.sphere import Coverage, cell_directions, cell_solid_angles, direction_from_angles, map_irradiance
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.score import score
from vemlight.sampler.tracking.extents import soft_lights
from vemlight.sampler.tracking.sources import SourceTiles
from vemlight.sampler.tracking.tiles import Tiles
from vemlight.sampler.tracking.tracked import initial_tracked, tracked_step
from vemlight.sampler.tracking.voronoi import cells_from_sites

ROWS, COLS = 45, 180


def disc_map(degrees, radiance, theta=40.0, phi=100.0, sky=1.0):
    """A sky with an even round source."""
    directions = cell_directions(ROWS, COLS, "hemisphere")
    inside = directions @ direction_from_angles(np.radians(theta), np.radians(phi)) > np.cos(np.radians(degrees / 2))
    gray = np.where(inside, radiance, sky * (1.2 + directions[..., 0]))
    return (gray[..., None] * [0.9, 1.0, 1.3]).astype(np.float32)


def soft(radiance, count=32, frames=1, coverage: Coverage = "hemisphere"):
    state, lights = initial_tracked(), None
    for k in range(frames):
        state, lights, _ = tracked_step(count, state, SamplerInput(radiance, coverage, k / 25, NO_BRIGHT_CELLS), False, soft=True)
    assert lights is not None
    assert lights.covariances is not None
    return lights, lights.covariances


def full(covariances):
    return covariances.astype(float)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]


MAPS = {
    "sky": disc_map(0, 0),
    "sun": disc_map(4, 5e4),
    "lamps": disc_map(8, 300) + disc_map(8, 300, 60, 280, 0),
    "noise": np.random.default_rng(0).lognormal(0, 2, (ROWS, COLS, 3)).astype(np.float32),
    "one cell": np.zeros((ROWS, COLS, 3), np.float32),
}
MAPS["one cell"][20, 30] = 7.0


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("count", [1, 2, 8, 64])
def test_the_light_is_the_maps_in_every_channel_and_every_covariance_can_be(name, count):
    lights, covariances = soft(MAPS[name], count, 3)
    assert len(lights.ids) <= count
    assert len(set(lights.ids.tolist())) == len(lights.ids)
    np.testing.assert_allclose(lights.irradiance.sum(axis=0, dtype=float), map_irradiance(MAPS[name], "hemisphere"), rtol=1e-5)
    assert (lights.irradiance >= 0).all()
    assert are_covariances(covariances)
    np.testing.assert_allclose(np.linalg.norm(lights.directions, axis=1), 1, atol=1e-6)


def test_one_light_has_the_maps_own_moments():
    radiance = disc_map(0, 0)
    lights, covariances = soft(radiance, 1)
    directions = cell_directions(ROWS, COLS, "hemisphere").reshape(-1, 3)
    power = (radiance[..., 1] * cell_solid_angles(ROWS, COLS, "hemisphere")[:, None]).reshape(-1)
    mean = power @ directions / power.sum()
    covariance = np.einsum("n,ni,nj->ij", power, directions, directions) / power.sum() - np.outer(mean, mean)
    np.testing.assert_allclose(lights.directions[0], mean / np.linalg.norm(mean), atol=1e-3)
    # The mean needs no field of its own: its square and the covariance's trace are 1.
    assert 1 - np.trace(full(covariances)[0]) == pytest.approx(mean @ mean, rel=5e-3)
    # Tiles of 8 degrees are taken as even across, which moves light by a thousandth between the axes.
    np.testing.assert_allclose(full(covariances)[0], covariance, atol=2e-3)


def _tiles(directions, power):
    """Tiles without an extent of their own."""
    n = len(power)
    return Tiles(np.repeat(power[None], 3, axis=0), power, np.ascontiguousarray(directions.T), np.ones(n), np.full(n, 1e-4), np.ones(n))


def _shadow_error(x, power, variance):
    """Mean over four axes of the squared difference between the distributions of light at x (n, 2), in degrees, and of a Gaussian."""
    grid, total = np.linspace(-12, 12, 1201), 0.0
    for turn in np.radians([10, 55, 100, 145]):
        along = x @ [np.cos(turn), np.sin(turn)]
        light = (power[:, None] * (along[:, None] <= grid)).sum(axis=0) / power.sum()
        total += ((light - ndtr(grid / np.sqrt(variance))) ** 2).mean()
    return total


@pytest.mark.parametrize("name", ["disc", "ring", "core and halo", "bell"])
def test_a_source_has_the_extent_that_casts_the_truest_shadow(name):
    generator = np.random.default_rng(3)
    turn, radius = generator.uniform(0, 2 * np.pi, 400), np.sqrt(generator.uniform(0, 1, 400))
    radius = {"disc": 2 * radius, "ring": 1.5 + 0.3 * radius, "core and halo": np.where(radius < 0.75, 0.4, 2.0) * radius,
              "bell": np.sqrt(-2 * np.log(1 - 0.999 * radius**2))}[name]  # fmt: skip
    x = radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    directions = np.concatenate([np.radians(x), np.ones((400, 1))], axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    tiles, nothing = _tiles(directions, np.ones(400)), np.zeros(400, np.int64)
    sources = SourceTiles(np.array([[0.0, 0.0, 1.0]]), nothing, np.ones(400))
    sites = np.array([[0.0, 1.0, 0.0]])
    lights = soft_lights(tiles, np.arange(2), sites, cells_from_sites(tiles, sites).assignment, sources)
    assert lights.covariances is not None
    assert lights.irradiance[0, 0] == pytest.approx(400)
    found = _shadow_error(x, np.ones(400), np.degrees(1) ** 2 * lights.covariances[0, [0, 3]].mean())
    moments = np.mean(x**2)
    assert found < 1.05 * min(_shadow_error(x, np.ones(400), scale * moments) for scale in np.linspace(0.4, 1.6, 61))
    ratio = np.degrees(1) ** 2 * lights.covariances[0, [0, 3]].sum() / np.sum(np.mean(x**2, axis=0))
    low, high = {"disc": (1.1, 1.25), "ring": (1.2, 1.5), "core and halo": (0.5, 0.9), "bell": (0.93, 1.07)}[name]
    assert low < ratio <= high


def test_a_lamp_is_one_light_with_the_variance_of_a_disc():
    lights, covariances = soft(disc_map(5.0, 3000.0, sky=0.2), 16, 3)
    lamp = lights.irradiance[:, 1].argmax()
    # An even disc of radius r has the mean square r^2 / 4 along each axis; cells are 2 degrees.
    spread = np.degrees(np.sqrt(np.trace(full(covariances)[lamp]) / 2))
    assert spread == pytest.approx(2.5 / 2, rel=0.25)
    assert lights.directions[lamp] @ direction_from_angles(np.radians(40), np.radians(100)) > np.cos(np.radians(0.5))


def test_one_lit_cell_is_one_point():
    lights, covariances = soft(MAPS["one cell"], 8)
    assert (lights.irradiance[:, 1] > 0).sum() == 1
    assert np.abs(covariances[lights.irradiance[:, 1].argmax()]).max() < 1e-6


@pytest.mark.parametrize(("name", "times"), [("sky", 2.0), ("lamps", 2.0), ("noise", 1.5)])
def test_shadows_are_truer_than_those_of_points(name, times):
    _, points, _ = tracked_step(16, initial_tracked(), SamplerInput(MAPS[name], "hemisphere", 0.0, NO_BRIGHT_CELLS), False)
    errors = [score([(MAPS[name], lights)]).error for lights in (points, soft(MAPS[name], 16)[0])]
    assert errors[0] > times * errors[1]


def test_light_even_round_the_sphere_is_several_lights():
    lights, _ = soft(np.ones((90, 90, 3), np.float32), 16, coverage="sphere")
    assert (lights.irradiance[:, 1] > 0.02 * 4 * np.pi).all()
    assert np.linalg.norm(lights.irradiance[:, 1] @ lights.directions) < 0.05 * 4 * np.pi


def test_the_same_map_gives_the_same_bytes():
    (one, extents), (two, same) = soft(MAPS["noise"], 64, 2), soft(MAPS["noise"], 64, 2)
    assert [array.tobytes() for array in (*one[:3], extents)] == [array.tobytes() for array in (*two[:3], same)]
