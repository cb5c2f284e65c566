"""A polar map as a list of small parts of the sphere, each with direction, solid angle and radiance: what a meter sums over."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vemlight.light.bright_cells import SUBCELLS
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.sphere import SPAN, Coverage, cell_solid_angles, direction_from_angles

MAX_ROWS = 360  # of the map that is summed: half a degree of a sphere. Finer ones are averaged down, which keeps every sum


class MapElements(NamedTuple):
    """The parts of a map, darkness included: its cells, and in place of each bright cell its sub-cell samples.

    directions: (n, 3) float32 unit vectors. solid_angles: (n,) float32, sr; of a sample that of a sub-cell. radiance: (n, 3) float32.
    cells: (n,) int64, row * cols + column. rows, cols: of the map that the cells are of, which may be coarser than the map given.
    """

    directions: np.ndarray
    solid_angles: np.ndarray
    radiance: np.ndarray
    cells: np.ndarray
    rows: int
    cols: int


def elements_from_map(environment: EnvironmentMap) -> MapElements:
    """The parts of an environment map. Sums of radiance over solid angle are the map's."""
    radiance, coverage, bright = environment
    rows, cols, _ = radiance.shape
    factor = -(-rows // MAX_ROWS)
    directions, solid_angles = _grid(rows, cols, coverage, factor)
    if factor > 1:
        light = radiance * cell_solid_angles(rows, cols, coverage)[:, None, None].astype(np.float32)
        for axis, side in enumerate((rows, cols)):
            light = np.add.reduceat(light, np.arange(0, side, factor), axis=axis)
        flat = light.reshape(-1, 3) / solid_angles[:, None]
        return MapElements(directions, solid_angles, flat, np.arange(len(flat)), *light.shape[:2])
    flat, cells = radiance.reshape(-1, 3), np.arange(rows * cols)
    if not len(bright.cells):
        return MapElements(directions, solid_angles, flat, cells, rows, cols)

    # Each bright cell gives way to its samples, whose light is the cell's on a sub-cell's solid angle.
    whole = np.ones(len(flat), bool)
    whole[bright.cells] = False
    part = 1 / SUBCELLS**2
    return MapElements(
        np.concatenate([directions[whole], bright.directions]),
        np.concatenate([solid_angles[whole], solid_angles[bright.cells] * np.float32(part)]),
        np.concatenate([flat[whole], flat[bright.cells] * (bright.weights / part)[:, None].astype(np.float32)]),
        np.concatenate([cells[whole], bright.cells]),
        rows,
        cols,
    )


def plane_irradiance(elements: MapElements, normal: np.ndarray) -> np.ndarray:
    """Irradiance (3,) float64, radiance x sr, of a plane by the half of the sphere that its unit normal (3,) points into."""
    weights = np.maximum(elements.directions @ normal.astype(np.float32), 0) * elements.solid_angles
    return (weights @ elements.radiance).astype(np.float64)


@lru_cache(maxsize=2)
def _grid(rows: int, cols: int, coverage: Coverage, factor: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) and solid angles (n,) of blocks of `factor` rows and columns of a map; the last ones may be smaller."""
    edges_row, edges_col = (np.append(np.arange(0, side, factor), side) for side in (rows, cols))
    theta = (edges_row[:-1] + edges_row[1:]) / 2 * (SPAN[coverage] / rows)
    phi = (edges_col[:-1] + edges_col[1:]) * (np.pi / cols)
    ring = np.add.reduceat(cell_solid_angles(rows, cols, coverage), edges_row[:-1])
    solid_angles = np.outer(ring, np.diff(edges_col))
    return direction_from_angles(theta[:, None], phi).reshape(-1, 3).astype(np.float32), solid_angles.ravel().astype(np.float32)
