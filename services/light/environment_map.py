"""The environment map as the services hand it on."""

from typing import NamedTuple

import numpy as np

from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.light.sphere import Coverage


class EnvironmentMap(NamedTuple):
    """A polar map (rows, cols, 3) float32 of radiance, laid out as in sphere.py, and where the light is in its bright cells."""

    radiance: np.ndarray
    coverage: Coverage
    bright_cells: BrightCells = NO_BRIGHT_CELLS
