import numpy as np
import pytest

from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.sampler.tracking.split_merge import URGENT, Sites, best_splits, cheapest_pair, split, split_and_merge
from vemlight.sampler.tracking.tiles import tiles_from_map
from vemlight.sampler.tracking.voronoi import cells_from_sites, relax, root

COUNT = 24


def sky_cells(lamp=0.0, count=COUNT):
    """Tiles of a sky with a lamp, sites that do not depend on the light, and their cells."""
    generator = np.random.default_rng(0)
    radiance = generator.lognormal(0, 1, (36, 90, 3)).astype(np.float32)
    radiance[10:14, 30:34] += lamp
    sites = generator.normal(size=(count, 3)) * [1, 1, 0.5] + [0, 0, 1]
    sites /= np.linalg.norm(sites, axis=1, keepdims=True)
    tiles = tiles_from_map(radiance, "hemisphere", count, NO_BRIGHT_CELLS)
    return tiles, sites, cells_from_sites(tiles, sites)


@pytest.mark.parametrize("scene_change", [False, True])
def test_the_best_splits_are_those_of_all_cells_tried(scene_change):
    tiles, sites, cells = sky_cells(50.0)
    halves, nearest = np.empty((2, 3)), cells.assignment.nearest
    every = np.sort([split(tiles, nearest, cell, sites[cell], scene_change, halves) for cell in range(COUNT)])[::-1]
    for most in (1, 5, COUNT):
        gains, chosen, sides = best_splits(tiles, sites, cells, most, scene_change)
        np.testing.assert_array_equal(gains, every[: len(gains)])
        assert len(gains) == min(most, np.count_nonzero(every))
        assert len(set(chosen)) == len(chosen)
        np.testing.assert_allclose(np.linalg.norm(sides, axis=-1), 1)


def test_a_cell_of_one_tile_has_no_split():
    radiance = np.zeros((36, 90, 3), np.float32)
    radiance[10, 20] = radiance[30, 60] = 1
    tiles = tiles_from_map(radiance, "hemisphere", 2, NO_BRIGHT_CELLS)
    sites = np.ascontiguousarray(tiles.direction.T)
    assert len(best_splits(tiles, sites, cells_from_sites(tiles, sites), 1, False)[0]) == 0


def test_the_cheapest_pair_is_that_of_all_neighbours_tried():
    _, sites, cells = sky_cells()
    moment, root_energy = cells.moment, cells.root_energy
    assert (moment[:, 3] > 0).all()
    cost, larger, smaller = cheapest_pair(sites, cells)
    power, centre = moment[:, 3], moment[:, :3] / np.linalg.norm(moment[:, :3], axis=1, keepdims=True)

    def joint(a, b):
        weight, chord = power[b] / (power[a] + power[b]), np.linalg.norm(centre[a] - centre[b])
        one = np.hypot(root_energy[a], power[a] * root(chord * weight))
        other = np.hypot(root_energy[b], power[b] * root(chord * (1 - weight)))
        return (one + other) ** 2 - root_energy[a] ** 2 - root_energy[b] ** 2

    costs = {(a, b): joint(a, b) for a, b in zip(cells.assignment.nearest, cells.assignment.second, strict=True)}
    best = min(costs, key=lambda pair: costs[pair])
    assert cost == pytest.approx(costs[best], rel=1e-9)
    assert {larger, smaller} == set(best)
    assert power[larger] >= power[smaller]


def test_a_dark_cell_is_given_up_first():
    _, sites, cells = sky_cells()
    cells.moment[7] = 0
    assert cheapest_pair(sites, cells) == (0.0, 0, 7)


@pytest.mark.parametrize("scene_change", [False, True])
def test_exchanges_lower_the_energy_and_leave_the_others(scene_change):
    tiles, directions, cells = sky_cells(50.0)
    before, old, energy = Sites(np.arange(COUNT), directions, np.zeros((COUNT, 3)), 100), directions.copy(), (cells.root_energy**2).sum()
    count, sites, after = split_and_merge(tiles, before, cells, 4, URGENT, scene_change)
    assert 1 <= count <= 6
    assert sites.next_id == 100 + count
    np.testing.assert_array_equal(directions, old)
    assert (before.ids < 100).all()
    assert (before.offsets == 0).all()
    # Each exchange gains GAIN_OVER_COST = 2 times what it costs.
    assert (after.root_energy**2).sum() < energy
    assert len(np.unique(sites.ids)) == COUNT
    assert set(sites.ids[sites.ids >= 100]) <= set(range(100, 100 + count))
    assert ((sites.directions != old).any(axis=1)).sum() <= 3 * count
    assert (sites.offsets[sites.ids < 100] == 0).all()
    assert (sites.offsets[sites.ids >= 100] != 0).any() == (not scene_change)
    again = cells_from_sites(tiles, sites.directions)
    for one, other in zip((*after[:3], *after.assignment), (*again[:3], *again.assignment), strict=True):
        np.testing.assert_array_equal(one, other)


def test_urgent_exchanges_save_two_per_cent_each_and_others_are_counted():
    seen = []
    for spare in (0, 1, 6):
        tiles, directions, cells = sky_cells(5.0, 120)
        directions, cells = relax(tiles, directions, cells.site_moment, 30)
        energy = (cells.root_energy**2).sum()
        count, _, after = split_and_merge(tiles, Sites(np.arange(120), directions, np.zeros((120, 3)), 200), cells, spare, URGENT, False)
        if spare == 0:
            assert (after.root_energy**2).sum() < energy * (1 - 0.02) ** count
        seen.append(count)
    assert seen == sorted(seen)
    assert seen[0] < seen[2] <= 6
