"""Sequential sampling of dynamic environment maps (Ghosh, Doucet and Heidrich 2006): a population of samples that follows the map.

Built from the paper's published description: a sequential Monte Carlo sampler whose samples are weighted anew by the map's change, drawn
anew when few of them carry the weight, and moved by steps of Markov chains. The paper samples the product of map and BRDF at each pixel;
one set of lights for all pixels samples the map alone. Where the description is silent we chose: systematic resampling below half the
effective sample size, then MOVES Metropolis steps, by turns to a neighbouring cell within REACH and, for some samples, to a cell of the
whole map drawn from it. A sample that is drawn again keeps its id, its copies get new ones.
"""

from typing import NamedTuple

import numpy as np

from bench.rivals.cells import Cells, cells
from vemlight.light.light_set import LightSet
from vemlight.sampler.sampler_input import SamplerInput

MOVES = 4  # steps of each sample's chain in a frame
REACH = 3  # cells, rows and columns, of a local step: three degrees, as far as light moves between frames
ANEW = 0.25  # of the samples that a step draws from the whole map; with less they lose a sun that moves by its own size (error .65 at
# a tenth, .46 at a quarter, .16 at one), with more no light keeps its place (power in lights that jump: .25, .57, .99)
SEED = 0


class Population(NamedTuple):
    """cell: (count,) of the map. weight: (count,), sum 1. ids: (count,). next_id: the first that is free. power: the last map's."""

    count: int
    cell: np.ndarray
    weight: np.ndarray
    ids: np.ndarray
    next_id: int
    power: np.ndarray
    frame: int


def begun(count: int) -> Population:
    none = np.zeros(0, np.int64)
    return Population(count, none, np.zeros(0), none, 0, np.zeros(0), 0)


def sequential(population: Population, frame: SamplerInput) -> tuple[Population, LightSet]:
    """The population after a frame, and its samples as lights; a black map keeps the population and gives no light."""
    of, generator = cells(frame.radiance, frame.coverage), np.random.default_rng((SEED, population.frame))
    power = of.power.ravel()
    population = population._replace(frame=population.frame + 1)
    if not power.any():
        return population, LightSet.none()
    if len(population.cell):
        ratio = power[population.cell] / np.maximum(population.power[population.cell], 1e-30)
        weight = population.weight * ratio
    else:
        weight = np.zeros(0)
    if weight.sum() > 0:
        population = population._replace(weight=weight / weight.sum(), power=power)
        if 1 / np.sum(population.weight**2) < population.count / 2:
            population = _resampled(population, generator)
        population = population._replace(cell=_moved(population.cell, power, frame.radiance.shape[:2], generator))
    else:
        population = _drawn(population, power, generator)
    return population, _lights(population, of)


def _drawn(population: Population, power: np.ndarray, generator: np.random.Generator) -> Population:
    """A population of the map itself, one sample in each of equal parts of the power."""
    count = population.count
    cell = _by_power(power, (np.arange(count) + generator.random(count)) / count)
    ids = population.next_id + np.arange(count)
    return population._replace(cell=cell, weight=np.full(count, 1 / count), ids=ids, next_id=population.next_id + count, power=power)


def _resampled(population: Population, generator: np.random.Generator) -> Population:
    """Systematic resampling: equal weights, samples as often as their weights say."""
    count = population.count
    chosen = np.searchsorted(np.cumsum(population.weight), (np.arange(count) + generator.random()) / count)
    chosen = np.minimum(chosen, count - 1)
    first = np.diff(chosen, prepend=-1) > 0
    fresh = population.next_id + np.cumsum(~first) - 1
    ids = np.where(first, population.ids[chosen], fresh)
    next_id = population.next_id + int((~first).sum())
    return population._replace(cell=population.cell[chosen], weight=np.full(count, 1 / count), ids=ids, next_id=next_id)


def _moved(cell: np.ndarray, power: np.ndarray, shape: tuple[int, int], generator: np.random.Generator) -> np.ndarray:
    """Each sample after MOVES Metropolis steps that leave the map's distribution as it is."""
    rows, cols = shape
    for turn in range(MOVES):
        accepted = generator.random(len(cell))
        if turn % 2:
            proposed = _by_power(power, generator.random(len(cell)))  # drawn from the map: always accepted
            cell = np.where(accepted < ANEW, proposed, cell)
            continue
        row, col = np.divmod(cell, cols)
        row = row + generator.integers(-REACH, REACH + 1, len(cell))
        col = (col + generator.integers(-REACH, REACH + 1, len(cell))) % cols
        inside = (row >= 0) & (row < rows)
        proposed = np.where(inside, row * cols + col, cell)
        cell = np.where(accepted * power[cell] < power[proposed], proposed, cell)
    return cell


def _by_power(power: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Cells drawn in proportion to their power by numbers in [0, 1)."""
    total = np.cumsum(power)
    return np.minimum(np.searchsorted(total, numbers * total[-1], side="right"), len(power) - 1)


def _lights(population: Population, of: Cells) -> LightSet:
    """Samples as lights: each has its weight's fraction of the map's power, in the colour of its cell."""
    power, flux = of.power.ravel()[population.cell], of.flux.reshape(-1, 3)[population.cell]
    lit = power > 0
    irradiance = flux[lit] * (population.weight[lit] * of.power.sum() / power[lit])[:, None]
    return LightSet.of(population.ids[lit], of.directions.reshape(-1, 3)[population.cell[lit]], irradiance)
