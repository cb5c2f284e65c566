"""Where light sits inside the strong cells of a polar map.

A cell of one degree that holds a sun is too coarse for hard shadows. It travels cut into PARTS x PARTS parts, each with the centre of its
light and its share of the cell's.
"""

from typing import NamedTuple

import numpy as np

from vemlight.light.sphere import Coverage, cell_from_direction

PARTS = 3  # to a side of a cell: a third of a degree is a pixel of a 1024-pixel lat-long map, and less than the sun


class BrightCells(NamedTuple):
    """cells: (n,) int64, row * cols + column, ascending; a cell stands there once for each of its parts with light.

    centres: (n, 3) float32, unit vectors to the centre of the light in a part. shares: (n,) float32, of the cell's light; a cell's sum
    to 1.
    """

    cells: np.ndarray
    centres: np.ndarray
    shares: np.ndarray


NONE = BrightCells(np.empty(0, np.int64), np.empty((0, 3), np.float32), np.empty(0, np.float32))


def strong_light(cells: np.ndarray, directions: np.ndarray, flux: np.ndarray, rows: int, cols: int, coverage: Coverage) -> BrightCells:
    """The parts of the cells that `cells` (m,) names, each time with light of the direction (m, 3) and luminous flux (m,) that it holds.

    A direction a little outside its cell (a pixel that reaches into it) counts for the nearest part. Flux that is negative or not finite
    counts as none.
    """
    flux = np.where(np.isfinite(flux) & (flux > 0), flux, 0).astype(np.float64)
    row, col = np.divmod(cells, cols)
    i, j = cell_from_direction(directions, rows, cols, coverage)
    down = np.clip((PARTS * (i - row)).astype(np.int64), 0, PARTS - 1)
    over = (j - col + cols / 2) % cols - cols / 2  # beside phi = 0 too
    across = np.clip((PARTS * over).astype(np.int64), 0, PARTS - 1)
    parts, at = np.unique((cells * PARTS + down) * PARTS + across, return_inverse=True)
    power = np.bincount(at, flux)
    moment = np.stack([np.bincount(at, flux * directions[:, c]) for c in range(3)], axis=-1)
    lit = power > 0
    owner, power, moment = parts[lit] // PARTS**2, power[lit], moment[lit]
    _, which = np.unique(owner, return_inverse=True)
    centres = moment / np.linalg.norm(moment, axis=1, keepdims=True)
    return BrightCells(owner, centres.astype(np.float32), (power / np.bincount(which, power)[which]).astype(np.float32))
