"""What the sampler gets of one frame."""

from typing import NamedTuple

import numpy as np

from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.light.sphere import Coverage

MAX_GAP_S = 1.0  # between frames: what was seen longer ago says nothing about now; a slower sequence is one of stills, each by itself


class SamplerInput(NamedTuple):
    """A polar map and what travels with it.

    radiance: (rows, cols, 3) float32, may hold nan, infinite and negative values. time_s: of the capture. bright_cells: used by the method
    "tracked" alone. light_budget: lights that the renderer can draw in its time, 0 where that is no limit.
    """

    radiance: np.ndarray
    coverage: Coverage
    time_s: float
    bright_cells: BrightCells = NO_BRIGHT_CELLS
    light_budget: int = 0
