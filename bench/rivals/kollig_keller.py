"""Kollig and Keller 2003: one direction, relaxed; then a new one near that of the cell with the largest flux, relaxed again; until N.

The paper's text could not be had; that cells are relaxed to their flux centroids, ROUNDS times after each insertion, is our assumption.
A light has its cell's flux and stands at its site. Cells are searched in blocks, each among the sites that can be nearest to it.
"""

import numpy as np
from numba import njit

from bench.rivals.cells import cells, lights_of_groups
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage

ROUNDS = 2
LAST_ROUNDS = 8
SIDE = 8  # cells of a block that is searched together
NEAR = np.radians(1.0)  # a new site's distance from the old one: about a cell of the map


def kollig_keller(radiance: np.ndarray, coverage: Coverage, count: int, seed: int = 0) -> LightSet:
    """At most `count` lights of a polar map (rows, cols, 3); the same ones for the same seed."""
    of = cells(radiance, coverage)
    lit = _by_blocks(of.power)
    places, power = of.directions.reshape(-1, 3)[lit], of.power.ravel()[lit]
    label = np.full(of.power.size, -1)
    if not len(lit):
        return lights_of_groups(of, label.reshape(of.power.shape), 1, np.zeros((1, 3)))
    generator = np.random.default_rng(seed)
    sites = np.array([[0.0, 0.0, 1.0]])
    nearest, moment = _relaxed(places, power, sites, ROUNDS)
    while len(sites) < min(count, len(power)):
        near = sites[moment[:, 3].argmax()] + NEAR * generator.standard_normal(3)
        sites = np.concatenate([sites, near[None] / np.linalg.norm(near)])
        nearest, moment = _relaxed(places, power, sites, LAST_ROUNDS if len(sites) == count else ROUNDS)
    label[lit] = nearest
    return lights_of_groups(of, label.reshape(of.power.shape), len(sites), sites)


def _by_blocks(power: np.ndarray) -> np.ndarray:
    """Indices (n,) of the lit cells, neighbours together."""
    row, col = np.divmod(np.flatnonzero(power), power.shape[1])
    order = np.lexsort((col, row, col // SIDE, row // SIDE))
    return (row * power.shape[1] + col)[order]


@njit(cache=True, fastmath=True)
def _relaxed(places, power, sites, rounds):
    """Moves the sites in place; returns the nearest site of each place and each site's moment: power x direction, power.

    Of SIDE x SIDE places in a row those sites are searched that can be nearest to one of them, as seen from the first.
    """
    nearest, moment = np.empty(power.size, np.int64), np.empty((sites.shape[0], 4))
    chords, near = np.empty(sites.shape[0]), np.empty(sites.shape[0], np.int64)
    for _ in range(rounds):
        moment[:] = 0.0
        for begin in range(0, power.size, SIDE * SIDE):
            end = min(begin + SIDE * SIDE, power.size)
            x0, y0, z0 = places[begin]
            reach, least = 0.0, 4.0
            for k in range(begin, end):
                reach = max(reach, (places[k, 0] - x0) ** 2 + (places[k, 1] - y0) ** 2 + (places[k, 2] - z0) ** 2)
            for s in range(sites.shape[0]):
                chords[s] = (sites[s, 0] - x0) ** 2 + (sites[s, 1] - y0) ** 2 + (sites[s, 2] - z0) ** 2
                least = min(least, chords[s])
            limit, count = (np.sqrt(least) + 2 * np.sqrt(reach) + 1e-6) ** 2, 0
            for s in range(sites.shape[0]):
                if chords[s] <= limit:
                    near[count] = s
                    count += 1
            for k in range(begin, end):
                x, y, z = places[k]
                best, at = -2.0, 0
                for n in range(count):
                    cosine = sites[near[n], 0] * x + sites[near[n], 1] * y + sites[near[n], 2] * z
                    if cosine > best:
                        best, at = cosine, near[n]
                nearest[k] = at
                moment[at, 0] += power[k] * x
                moment[at, 1] += power[k] * y
                moment[at, 2] += power[k] * z
                moment[at, 3] += power[k]
        for s in range(sites.shape[0]):
            length = np.sqrt(moment[s, 0] ** 2 + moment[s, 1] ** 2 + moment[s, 2] ** 2)
            if length > 0:
                for c in range(3):
                    sites[s, c] = moment[s, c] / length
    return nearest, moment
