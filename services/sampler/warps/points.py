"""The points of the unit square from which lights are drawn, in an order whose every prefix is well spread.

Light number i always belongs to point number i, so raising or lowering the number of lights moves none of the others.

"halton" is even in the square's own coordinates. "relaxed", after the 2005 paper, has its points pushed apart: better in the square, and
under the standard inversion up to some 200 points. But points that stay away from the square's edges lie in bands along them, and the
concentric map turns these into bands of one radius: of 512 points, 24 too many or too few lie within some radius ("halton": 4). Havran's
warps invert one cumulative function over the squared radius and one over the azimuth, so "disc" is even in those two (2 of 512).
Irradiance under half-space occluders on eleven real maps, 16 to 512 lights, geometric mean against "halton":
azimuth first .67 disc, .87 relaxed; radius first .90, 1.32; standard inversion .94 relaxed (above 1 under strong suns of one cell).
"""

from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from vemlight.kernels import kernel
from vemlight.sampler.warps.square import square_from_disc

RELAXED = 512  # points in the stored table, which bench/relaxed_points.py makes; those beyond it are plain Halton points
TABLE = Path(__file__).with_name("points.npy")
Kind = Literal["disc", "relaxed", "halton"]


def halton(count: int) -> np.ndarray:
    """The first `count` points of the Halton sequence in bases 2 and 3, from index 1 (index 0 is a corner), (count, 2) float64."""
    from scipy.stats.qmc import Halton  # here, since it takes half a second to import and the default method needs no points

    return Halton(2, scramble=False).fast_forward(1).random(count)


def disc_halton(count: int) -> np.ndarray:
    """Points of the square, (count, 2) float64, whose squared radii and azimuths on the disc are Halton's, in bases 3 and 2."""
    result = np.empty((count, 2))
    _fill_square(halton(count), result)
    return result


@kernel
def _fill_square(halton, points):
    for k in range(points.shape[0]):
        points[k, 0], points[k, 1] = square_from_disc(halton[k, 1], halton[k, 0])


@lru_cache(maxsize=4)
def points(count: int, kind: Kind) -> np.ndarray:
    """The first `count` points, (count, 2) float64, read-only. "relaxed": the stored table, then plain Halton."""
    table = disc_halton(count) if kind == "disc" else halton(count)
    if kind == "relaxed":
        table[:RELAXED] = np.load(TABLE)[:count]
    table.setflags(write=False)
    return table
