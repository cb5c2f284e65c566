import numpy as np
import pytest

from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.sampler.tracking.cells import root, shares_of_sites
from vemlight.sampler.tracking.split_merge import best_splits, cheapest_pair, exchanged, split
from vemlight.sampler.tracking.tiles import tiles_from_map

COUNT = 24


def cells(lamp=0.0):
    """Tiles of a sky with a lamp, sites, and their shares; the sites know nothing of the light."""
    generator = np.random.default_rng(0)
    radiance = generator.lognormal(0, 1, (36, 90, 3)).astype(np.float32)
    radiance[10:14, 30:34] += lamp
    sites = generator.normal(size=(COUNT, 3)) * [1, 1, 0.5] + [0, 0, 1]
    sites /= np.linalg.norm(sites, axis=1, keepdims=True)
    tiles = tiles_from_map(radiance, "hemisphere", COUNT, NO_BRIGHT_CELLS)
    return tiles, sites, shares_of_sites(tiles, sites)


@pytest.mark.parametrize("sudden", [False, True])
def test_the_best_splits_are_those_of_all_cells_tried(sudden):
    tiles, sites, (_, _, unease, first, *_) = cells(50.0)
    halves = np.empty((2, 3))
    every = np.sort([split(tiles, first, cell, sites[cell], sudden, halves) for cell in range(COUNT)])[::-1]
    for most in (1, 5, COUNT):
        gains, chosen, sides = best_splits(tiles, first, sites, unease, most, sudden)
        np.testing.assert_array_equal(gains, every[: len(gains)])
        assert len(gains) == min(most, np.count_nonzero(every))
        assert len(set(chosen)) == len(chosen)
        np.testing.assert_allclose(np.linalg.norm(sides, axis=-1), 1)


def test_a_cell_of_one_tile_has_no_split():
    radiance = np.zeros((36, 90, 3), np.float32)
    radiance[10, 20] = radiance[30, 60] = 1
    tiles = tiles_from_map(radiance, "hemisphere", 2, NO_BRIGHT_CELLS)
    sites = np.ascontiguousarray(tiles.direction.T)
    _, _, unease, first, *_ = shares_of_sites(tiles, sites)
    assert len(best_splits(tiles, first, sites, unease, 1, False)[0]) == 0


def test_the_cheapest_pair_is_that_of_all_neighbours_tried():
    _, sites, (moment, _, unease, first, second, _) = cells()
    assert (moment[:, 3] > 0).all()
    cost, kept, lost = cheapest_pair(first, second, moment, sites, unease)
    power, centre = moment[:, 3], moment[:, :3] / np.linalg.norm(moment[:, :3], axis=1, keepdims=True)

    def joint(a, b):
        share, chord = power[b] / (power[a] + power[b]), np.linalg.norm(centre[a] - centre[b])
        one = np.hypot(unease[a], power[a] * root(chord * share))
        other = np.hypot(unease[b], power[b] * root(chord * (1 - share)))
        return (one + other) ** 2 - unease[a] ** 2 - unease[b] ** 2

    costs = {(a, b): joint(a, b) for a, b in zip(first, second, strict=True)}
    best = min(costs, key=lambda pair: costs[pair])
    assert cost == pytest.approx(costs[best], rel=1e-9)
    assert {kept, lost} == set(best)
    assert power[kept] >= power[lost]


def test_a_dark_cell_is_given_up_first():
    _, sites, (moment, _, unease, first, second, _) = cells()
    moment[7] = 0
    assert cheapest_pair(first, second, moment, sites, unease) == (0.0, 0, 7)


@pytest.mark.parametrize("sudden", [False, True])
def test_exchanges_lower_the_unrest_and_leave_the_others(sudden):
    tiles, sites, held = cells(50.0)
    ids, offset, old = np.arange(COUNT), np.zeros((COUNT, 3)), sites.copy()
    moment, pull, unease, *whose = held
    first, second, share = (array.copy() for array in whose)
    made, born, moved, shown, after = exchanged(
        tiles, ids, sites, offset, 100, moment, pull, unease, first, second, share, 4, sudden
    )
    assert 1 <= made <= 4
    np.testing.assert_array_equal(sites, old)
    assert (ids < 100).all()
    assert (offset == 0).all()
    # Each exchange gains CHURN = 2 times what it costs.
    assert (after[2] ** 2).sum() < (unease**2).sum()
    assert len(np.unique(born)) == COUNT
    assert set(born[born >= 100]) <= set(range(100, 100 + made))
    assert ((moved != old).any(axis=1)).sum() <= 3 * made
    assert (shown[born < 100] == 0).all()
    assert (shown[born >= 100] != 0).any() == (not sudden)
    for one, other in zip(after, shares_of_sites(tiles, moved), strict=True):
        np.testing.assert_array_equal(one, other)
