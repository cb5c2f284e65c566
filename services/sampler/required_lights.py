"""How many lights a scene needs: the smallest number whose irradiance stays within an error of the map's own over a fixed set of probes.

The error is relative to what each probe itself receives (and to 5 % of the mean, in the dark): in the shadow of a strong sun the few lights
left for the sky must do, which is why a sunlit yard needs more lights than an overcast sky.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel
from vemlight.light.colour import LUMINANCE_BLUE, LUMINANCE_GREEN, LUMINANCE_RED, LUMINANCE_WEIGHTS
from vemlight.light.sphere import Coverage, cell_directions, cell_solid_angles
from vemlight.sampler.light_map import LightMap
from vemlight.sampler.probes import Probes, irradiance_of_unit_light, probes

REQUIRED_PROBES = 96  # the error's own uncertainty is 1 / sqrt(2 x 96) = 7 %, about a third of a step of the ladder
BLOCK_ROWS, BLOCK_COLS = 30, 120  # the map is judged in blocks of 3 degrees, but for its hot cells; 6 degrees do as well
HOT_CELL = 1 / 512  # of the power: cells above it are judged where they are; up to 1 / 32 the error changes by less than 3 %
DARK_PROBE = 0.05  # of the mean irradiance, below which an error is no longer relative to the probe's own
ERROR_MARGIN = 0.85  # of the error that is aimed at, so that the number chosen lasts while the scene changes a little
LADDER_START, LADDER_STEPS = 4, 4  # the smallest number of lights that is tried, and numbers an octave


class MapBlocks(NamedTuple):
    """Geometry of a map in blocks of cells.

    responses: (blocks, probes), mean response of the probes to a block. directions: (rows, cols, 3), of the cells. solid_angles: (rows,),
    of a cell, sr. block_row: (rows,), block_col: (cols,), the block's row and column.
    """

    responses: np.ndarray
    directions: np.ndarray
    solid_angles: np.ndarray
    block_row: np.ndarray
    block_col: np.ndarray


def ladder(max_count: int) -> np.ndarray:
    """The numbers of lights that are tried: steps of a fourth of an octave (19 %) from 4, and `max_count` itself."""
    steps = LADDER_START * 2 ** (np.arange(64) / LADDER_STEPS)
    return np.append(np.unique(np.rint(steps[steps < max_count - 0.5]).astype(np.int64)), max_count)


def required_lights(light: LightMap, directions: np.ndarray, tint: np.ndarray, error: float, before: int = 0) -> int:
    """The number of lights that keeps within `error` (0.1: ten per cent): the smallest on the ladder within ERROR_MARGIN of it, or all.

    directions, tint: (n, 3), the lights of this map before filtering, in their order. before: the number in use, which is preferred to
    a larger one as long as it is within the error itself. Each number counts as bad as the worst of those above it.
    """
    if light.power <= 0:
        return 1
    sizes, errors = ladder(len(directions)), prefix_errors(light, directions, tint)
    errors = np.maximum.accumulate(errors[::-1])[::-1]
    good = errors <= ERROR_MARGIN * error
    count = int(sizes[good.argmax()] if good.any() else sizes[-1])
    suffices = 0 < before < count and errors[np.searchsorted(sizes, before, side="right") - 1] <= error
    return before if suffices else count


def prefix_errors(light: LightMap, directions: np.ndarray, tint: np.ndarray) -> np.ndarray:
    """Relative error of the irradiance at the probes for each number of lights on the ladder, RMS over the probes."""
    rows, cols = light.importance.shape
    blocks = _map_blocks(rows, cols, light.coverage)
    at = probes(REQUIRED_PROBES, light.coverage)
    truth = np.zeros(REQUIRED_PROBES)
    block_power = np.zeros(blocks.responses.shape[0])
    _gather_map(light.radiance, blocks, HOT_CELL * light.power, at, block_power, truth)
    truth += block_power @ blocks.responses
    power = tint * light.irradiance @ LUMINANCE_WEIGHTS
    return _prefix_errors(directions, power, light.power, at, truth, ladder(len(directions)))


@lru_cache(maxsize=2)
def _map_blocks(rows: int, cols: int, coverage: Coverage) -> MapBlocks:
    block_row = np.arange(rows) * min(BLOCK_ROWS, rows) // rows
    block_col = np.arange(cols) * min(BLOCK_COLS, cols) // cols
    directions, solid_angles = cell_directions(rows, cols, coverage), cell_solid_angles(rows, cols, coverage)
    count = min(BLOCK_ROWS, rows) * min(BLOCK_COLS, cols)
    blocks = MapBlocks(np.zeros((count, REQUIRED_PROBES)), directions, solid_angles, block_row, block_col)
    area = np.zeros(count)
    _fill_responses(blocks, probes(REQUIRED_PROBES, coverage), area)
    return blocks._replace(responses=blocks.responses / area[:, None])


@kernel
def _fill_responses(blocks: MapBlocks, at: Probes, area):
    """Adds solid angle x response of each cell to blocks.responses (blocks, probes), and its solid angle to area (blocks,)."""
    across = blocks.block_col[-1] + 1
    for i in range(blocks.directions.shape[0]):
        for j in range(blocks.directions.shape[1]):
            block = blocks.block_row[i] * across + blocks.block_col[j]
            area[block] += blocks.solid_angles[i]
            for k in range(at.normals.shape[0]):
                response = irradiance_of_unit_light(at.normals[k], at.occluders[k], blocks.directions[i, j])
                blocks.responses[block, k] += blocks.solid_angles[i] * response


@kernel
def _gather_map(radiance, blocks: MapBlocks, hot_power, at: Probes, block_power, truth):
    """Adds each cell's power to block_power (blocks,), or when it is hot the irradiance from it to truth (probes,)."""
    across = blocks.block_col[-1] + 1
    for i in range(radiance.shape[0]):
        for j in range(radiance.shape[1]):
            luminance = LUMINANCE_RED * radiance[i, j, 0] + LUMINANCE_GREEN * radiance[i, j, 1] + LUMINANCE_BLUE * radiance[i, j, 2]
            power = luminance * blocks.solid_angles[i]
            if power <= hot_power:
                block_power[blocks.block_row[i] * across + blocks.block_col[j]] += power
            else:
                for k in range(at.normals.shape[0]):
                    truth[k] += power * irradiance_of_unit_light(at.normals[k], at.occluders[k], blocks.directions[i, j])


@kernel
def _prefix_errors(directions, power, total, at: Probes, truth, sizes):
    """Errors (sizes,) of the first lights, scaled to the `total` power, against the irradiance `truth` (probes,)."""
    irradiance, used, last = np.zeros(truth.size), 0.0, 0
    errors, dark = np.empty(sizes.size), DARK_PROBE * truth.mean()
    for s in range(sizes.size):
        for n in range(last, sizes[s]):
            used += power[n]
            for k in range(truth.size):
                irradiance[k] += power[n] * irradiance_of_unit_light(at.normals[k], at.occluders[k], directions[n])
        last = sizes[s]
        squares = 0.0
        for k in range(truth.size):
            squares += ((irradiance[k] * (total / used if used > 0 else 0.0) - truth[k]) / (truth[k] + dark)) ** 2
        errors[s] = np.sqrt(squares / truth.size)
    return errors
