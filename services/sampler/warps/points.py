"""The points of the unit square from which lights are drawn, in an order whose every prefix is well spread.

Light number i always belongs to point number i, so raising or lowering the number of lights moves none of the others.

"halton" is even in the square's own coordinates. "relaxed", after the 2005 paper, has its points pushed apart: better in the square, and
under the standard inversion up to some 200 points. But points that keep their distance from the square's edges lie in bands along them, and
the concentric map makes bands of one radius of these: of 512 points, 24 too many or too few lie within some radius ("halton": 4). Havran's
warps invert one cumulative function over the squared radius and one over the azimuth, so "disc" is even in those two (2 of 512).
Irradiance under half-space occluders on eleven real maps, 16 to 512 lights, geometric mean against "halton":
azimuth first .67 disc, .87 relaxed; radius first .90, 1.32; standard inversion .94 relaxed (above 1 under strong suns of one cell).
"""

from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from numba import njit
from scipy.spatial import Voronoi

from vemlight.sampler.warps.square import square_from_disc

RELAXED = 512  # points in the stored table; those beyond it are plain Halton points
FAVOURED = (72, 216)  # prefixes of the 2005 paper (4.1), weighted FAVOUR times
FAVOUR = 4.0
_TABLE = Path(__file__).with_name("points.npy")
Kind = Literal["disc", "relaxed", "halton"]


def halton(count: int) -> np.ndarray:
    """The first `count` points of the Halton sequence in bases 2 and 3, from index 1 (index 0 is a corner), (count, 2) float64."""
    return np.stack([_radical_inverse(2, count), _radical_inverse(3, count)], axis=-1)


def _radical_inverse(base: int, count: int) -> np.ndarray:
    digits, value, scale = np.arange(1, count + 1), np.zeros(count), 1.0 / base
    while digits.any():
        digits, digit = np.divmod(digits, base)
        value += digit * scale
        scale /= base
    return value


def disc_halton(count: int) -> np.ndarray:
    """Points of the square, (count, 2) float64, whose squared radii and azimuths on the disc are Halton's, in bases 3 and 2."""
    result = np.empty((count, 2))
    _fill_square(_radical_inverse(3, count), _radical_inverse(2, count), result)
    return result


@njit(cache=True)
def _fill_square(a, w, points):
    for k in range(a.size):
        points[k, 0], points[k, 1] = square_from_disc(a[k], w[k])


def relaxed_halton(count: int, rounds: int = 60) -> np.ndarray:
    """Halton points moved by Lloyd's relaxation of many prefixes at once, so that each of them is spread more evenly, (count, 2) float64.

    Each round every prefix of 8, 8 sqrt(2), 16, ... and the favoured ones pulls its points to the centroids of its Voronoi cells in the
    bounded square, with a weight proportional to its length; a point goes 0.7 of the mean pull.
    """
    points = halton(count)
    lengths = {round(8 * 2 ** (k / 2)) for k in range(64) if 8 * 2 ** (k / 2) < count} | {count} | {n for n in FAVOURED if n <= count}
    for _ in range(rounds):
        pull, weights = np.zeros((count, 2)), np.zeros((count, 1))
        for length in sorted(lengths):
            weight = length * (FAVOUR if length in FAVOURED else 1.0)
            pull[:length] += weight * (_centroids(points[:length]) - points[:length])
            weights[:length] += weight
        points = np.clip(points + 0.7 * pull / weights, 1e-6, 1 - 1e-6)
    return points


def _centroids(sites: np.ndarray) -> np.ndarray:
    """Centroids (n, 2) of the sites' Voronoi cells in the unit square; the sites mirrored at its edges keep the cells inside."""
    mirrored = [sites, *(np.where(np.arange(2) == axis, 2.0 * edge - sites, sites) for axis in (0, 1) for edge in (0, 1))]
    diagram = Voronoi(np.concatenate(mirrored))
    centroids = np.empty_like(sites)
    for n in range(len(sites)):
        x, y = diagram.vertices[diagram.regions[diagram.point_region[n]]].T
        right, up = np.roll(x, -1), np.roll(y, -1)
        cross = x * up - right * y
        centroids[n] = ((x + right) @ cross, (y + up) @ cross) / (3 * cross.sum())
    return centroids


@lru_cache(maxsize=4)
def points(count: int, kind: Kind) -> np.ndarray:
    """The first `count` points, (count, 2) float64, read-only. "relaxed": the stored `relaxed_halton(RELAXED)`, then plain Halton."""
    table = disc_halton(count) if kind == "disc" else halton(count)
    if kind == "relaxed":
        table[:RELAXED] = np.load(_TABLE)[:count]
    table.setflags(write=False)
    return table
