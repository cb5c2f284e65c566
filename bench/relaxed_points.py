"""Makes the relaxed Halton points after Havran et al. 2005, section 4.1: `python -m bench.relaxed_points` writes points.npy."""

import numpy as np
from scipy.spatial import Voronoi

from vemlight.sampler.warps.points import RELAXED, TABLE, halton

FAVOURED = (72, 216)  # prefixes of the 2005 paper, weighted FAVOUR times
FAVOUR = 4.0


def relaxed_halton(count: int, rounds: int = 60) -> np.ndarray:
    """Halton points moved by Lloyd's relaxation of many prefixes at once, so that each of them is spread more evenly, (count, 2) float64.

    In each round every prefix of 8, 8 sqrt(2), 16, ... and the favoured ones draws its points towards the centroids of its Voronoi cells in
    the bounded square, with a weight proportional to its length; a point moves 0.7 of the weighted mean.
    """
    points = halton(count)
    lengths = {round(8 * 2 ** (k / 2)) for k in range(64) if 8 * 2 ** (k / 2) < count} | {count} | {n for n in FAVOURED if n <= count}
    for _ in range(rounds):
        moved, weights = np.zeros((count, 2)), np.zeros((count, 1))
        for length in sorted(lengths):
            weight = length * (FAVOUR if length in FAVOURED else 1.0)
            moved[:length] += weight * (_centroids(points[:length]) - points[:length])
            weights[:length] += weight
        points = np.clip(points + 0.7 * moved / weights, 1e-6, 1 - 1e-6)
    return points


def _centroids(sites: np.ndarray) -> np.ndarray:
    """Centroids (n, 2) of the sites' Voronoi cells in the unit square; mirror images of the sites bound the cells by its edges."""
    mirrored = [sites, *(np.where(np.arange(2) == axis, 2.0 * edge - sites, sites) for axis in (0, 1) for edge in (0, 1))]
    diagram = Voronoi(np.concatenate(mirrored))
    centroids = np.empty_like(sites)
    for n in range(len(sites)):
        x, y = diagram.vertices[diagram.regions[diagram.point_region[n]]].T
        right, up = np.roll(x, -1), np.roll(y, -1)
        cross = x * up - right * y
        centroids[n] = ((x + right) @ cross, (y + up) @ cross) / (3 * cross.sum())
    return centroids


if __name__ == "__main__":
    np.save(TABLE, relaxed_halton(RELAXED))
