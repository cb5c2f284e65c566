"""Irradiance at probes with hard edges, against the sums written out."""

from typing import get_args

import numpy as np
import pytest
from scipy.special import ndtr

from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage, cell_directions, cell_solid_angles
from vemlight.sampler.hard_probes import (
    DARK_PROBE,
    HARD_PROBES,
    SLICES,
    dark_irradiance,
    hard_probes,
    lights_irradiance_at,
    map_irradiance_at,
    prefix_errors,
    relative_squares,
    slice_of_probes,
)
from vemlight.sampler.tracking.tiles import tiles_from_map

COVERAGES: tuple[Coverage, ...] = get_args(Coverage)


def lights(count, covariances=None, seed=1):
    generator = np.random.default_rng(seed)
    directions = generator.standard_normal((count, 3))
    directions[:, 2] = abs(directions[:, 2])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return LightSet.of(np.arange(count), directions, generator.random((count, 3)), covariances)


def tiles_of(radiance, coverage: Coverage = "hemisphere", count=100_000):
    return tiles_from_map(radiance.astype(np.float32), coverage, count, NO_BRIGHT_CELLS)


def sky(rows=45, cols=180, coverage: Coverage = "hemisphere"):
    directions = cell_directions(rows, cols, coverage)
    return (1.3 + directions[..., [0]] + np.exp(20 * (directions[..., [1]] - 0.9))) * [0.8, 1.0, 1.2]


def test_points_have_hard_edges():
    at, points = hard_probes("hemisphere"), lights(30)
    n, h, d = at.normals.T.astype(float), at.occluders.T.astype(float), points.directions.astype(float)
    power = points.irradiance @ [0.2126, 0.7152, 0.0722]
    expected = (np.maximum(n @ d.T, 0) * (h @ d.T > 0)) @ power
    np.testing.assert_allclose(lights_irradiance_at(at, points), expected, atol=1e-3 * expected.mean())


@pytest.mark.parametrize("size", [1e-4, 1e-2, 0.1])
def test_soft_lights_follow_the_formula_of_the_protocol(size):
    generator = np.random.default_rng(3)
    root = size * generator.standard_normal((20, 3, 3))
    full = root @ root.transpose(0, 2, 1)
    full /= np.maximum(np.trace(full, axis1=1, axis2=2) / 0.9, 1)[:, None, None]
    soft = lights(20, full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]])
    at = hard_probes("hemisphere")
    n, h = at.normals.T.astype(float), at.occluders.T.astype(float)
    means = np.sqrt(1 - np.trace(full, axis1=1, axis2=2))[:, None] * soft.directions
    u, v = (np.sqrt(np.maximum(np.einsum("ki,nij,kj->kn", axis, full, axis), np.radians(0.06) ** 2)) for axis in (n, h))
    a, s = n @ means.T, h @ means.T
    facing = a * ndtr(a / u) + u * np.exp(-0.5 * (a / u) ** 2) / np.sqrt(2 * np.pi)
    expected = (facing * ndtr(s / v)) @ (soft.irradiance @ [0.2126, 0.7152, 0.0722])
    np.testing.assert_allclose(lights_irradiance_at(at, soft), expected, atol=2e-3 * expected.mean())


@pytest.mark.parametrize("coverage", COVERAGES)
def test_tiles_give_what_the_maps_cells_give(coverage: Coverage):
    at, radiance = hard_probes(coverage), sky(coverage=coverage)
    d, weights = cell_directions(45, 180, coverage).reshape(-1, 3), cell_solid_angles(45, 180, coverage).repeat(180)
    power = weights * (radiance @ [0.2126, 0.7152, 0.0722]).ravel()
    expected = (np.maximum(at.normals.T @ d.T, 0) * (at.occluders.T @ d.T > 0)) @ power
    for count, off in ((100_000, 0.006), (64, 0.01)):  # of cells, whose edges are hard here and as wide as the cell there
        got = map_irradiance_at(at, tiles_of(radiance, coverage, count))
        assert np.sqrt(np.mean((got - expected) ** 2)) < off * expected.mean()


@pytest.mark.parametrize("coverage", COVERAGES)
def test_the_dark_part_is_of_the_mean_over_all_probes(coverage: Coverage):
    tiles = tiles_of(sky(coverage=coverage), coverage)
    many = hard_probes(coverage, 0, 20_000)
    assert dark_irradiance(many, tiles) == pytest.approx(DARK_PROBE * map_irradiance_at(many, tiles).mean(), rel=0.01)


def test_an_error_is_relative_to_the_probe_and_to_a_twentieth_of_the_mean():
    tiles, at, few = tiles_of(sky()), hard_probes("hemisphere"), lights(9)
    truth, got = map_irradiance_at(at, tiles), lights_irradiance_at(at, few)
    expected = ((got - truth) / (truth + 0.05 * dark_irradiance(at, tiles) / DARK_PROBE)) ** 2
    np.testing.assert_allclose(relative_squares(at, tiles, few), expected, rtol=1e-4)
    assert not relative_squares(at, tiles_of(0 * sky()), few).any()


def test_slices_part_the_probes():
    whole = hard_probes("hemisphere")
    assert whole.normals.shape == (3, HARD_PROBES)
    normals = np.concatenate([slice_of_probes("hemisphere", part).normals for part in range(SLICES)], axis=1)
    np.testing.assert_array_equal(np.sort(normals), np.sort(whole.normals))


def test_prefixes_are_scaled_to_the_maps_power():
    at, tiles, drawn = hard_probes("hemisphere"), tiles_of(sky()), lights(16)
    power, sizes = drawn.irradiance @ [0.2126, 0.7152, 0.0722], np.array([4, 9, 16])
    errors = prefix_errors(at, tiles, drawn.directions, power, sizes)
    for size, error in zip(sizes, errors, strict=True):
        scale = tiles.power.sum() / power[:size].sum()
        prefix = LightSet.of(drawn.ids[:size], drawn.directions[:size], scale * drawn.irradiance[:size])
        squares = relative_squares(at, tiles, prefix)
        assert error == pytest.approx(np.sqrt(squares.mean() + squares.std() / np.sqrt(squares.size)), rel=1e-3)
