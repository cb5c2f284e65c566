"""Sub-cell samples: where light sits inside the brightest cells of a polar map.

A cell of one degree that holds a sun is too coarse for hard shadows. It travels as up to SUBCELLS x SUBCELLS samples, each with the
direction of its light and its weight, the fraction that it is of the cell's light.
"""

from typing import NamedTuple

import numpy as np

from vemlight.light.sphere import Coverage, cell_from_direction

SUBCELLS = 3  # on a side of a cell: a third of a degree is a pixel of a 1024-pixel lat-long map, and less than the sun


class BrightCells(NamedTuple):
    """The sub-cell samples of a map's bright cells.

    cells: (n,) int64, row * cols + column, ascending; a cell is listed once for each of its samples. directions: (n, 3) float32, unit
    vectors to the centre of the light in a sub-cell. weights: (n,) float32, fractions of the cell's light, which sum to 1 in a cell.
    """

    cells: np.ndarray
    directions: np.ndarray
    weights: np.ndarray


NO_BRIGHT_CELLS = BrightCells(np.empty(0, np.int64), np.empty((0, 3), np.float32), np.empty(0, np.float32))


def bright_cells_from_light(
    cells: np.ndarray, directions: np.ndarray, flux: np.ndarray, rows: int, cols: int, coverage: Coverage
) -> BrightCells:
    """The samples of the cells in `cells` (m,), each entry with direction (m, 3) and luminous flux (m,) of some of the light that it holds.

    A direction a little outside its cell, that of a pixel which reaches into it, counts for the nearest sub-cell. Flux that is negative
    or not finite counts as none.
    """
    flux = np.where(np.isfinite(flux) & (flux > 0), flux, 0).astype(np.float64)
    row, col = np.divmod(cells, cols)
    i, j = cell_from_direction(directions, rows, cols, coverage)
    down = np.clip((SUBCELLS * (i - row)).astype(np.int64), 0, SUBCELLS - 1)
    offset = (j - col + cols / 2) % cols - cols / 2  # the short way round, across phi = 0 too
    across = np.clip((SUBCELLS * offset).astype(np.int64), 0, SUBCELLS - 1)

    # Power and first moment of each sub-cell.
    subcells, sample = np.unique((cells * SUBCELLS + down) * SUBCELLS + across, return_inverse=True)
    power = np.bincount(sample, flux)
    moment = np.stack([np.bincount(sample, flux * directions[:, c]) for c in range(3)], axis=-1)
    lit = power > 0
    owner, power, moment = subcells[lit] // SUBCELLS**2, power[lit], moment[lit]
    _, cell = np.unique(owner, return_inverse=True)
    centres = moment / np.linalg.norm(moment, axis=1, keepdims=True)
    return BrightCells(owner, centres.astype(np.float32), (power / np.bincount(cell, power)[cell]).astype(np.float32))
