"""Kollig and Keller 2003: one direction, relaxed; then a new one near that of the cell with the largest flux, relaxed again; until N.

The paper's text could not be had; that cells are relaxed to their flux centroids, ROUNDS times after each insertion, is our assumption.
A light has its cell's flux and stands at its site. All cells of the map are searched each time: quality, not speed.
"""

import numpy as np
from numba import njit

from bench.rivals.cells import cells, lights_of_groups
from services.lights import Lights
from services.sphere import Coverage

ROUNDS = 2
LAST_ROUNDS = 8
NEAR = np.radians(1.0)  # a new site's distance from the old one: about a cell of the map


def kollig_keller(radiance: np.ndarray, coverage: Coverage, count: int, seed: int = 0) -> Lights:
    """At most `count` lights of a polar map (rows, cols, 3); the same ones for the same seed."""
    of = cells(radiance, coverage)
    lit = of.power.ravel() > 0
    places, power = of.directions.reshape(-1, 3)[lit], of.power.ravel()[lit]
    label = np.full(of.power.size, -1)
    if not lit.any():
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


@njit(cache=True, fastmath=True)
def _relaxed(places, power, sites, rounds):
    """Moves the sites in place; returns the nearest site of each place and each site's moment: power x direction, power."""
    nearest, moment = np.empty(power.size, np.int64), np.empty((sites.shape[0], 4))
    for _ in range(rounds):
        moment[:] = 0.0
        for k in range(power.size):
            x, y, z = places[k]
            best, at = -2.0, 0
            for s in range(sites.shape[0]):
                cosine = sites[s, 0] * x + sites[s, 1] * y + sites[s, 2] * z
                if cosine > best:
                    best, at = cosine, s
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
