"""What glossy lobes reflect: the environment map, and as lights of their own the sources in it that are as small as its cells.

A lobe looks the prefiltered map up by a few Gaussians: true enough for what is as wide as the lobe, not for a sun, whose highlight shows
the lobe's own shape. So a light that is such a source keeps its exact lobe, widened by the source's variance, and the map loses what that
light has.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vemlight.light.bright_cells import SUBCELLS, BrightCells
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.extent import POINTS, Extents
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import SPAN, Coverage, cell_directions, cell_from_direction, cell_solid_angles, map_irradiance
from vemlight.light.virtual_lamp import VIRTUAL_IDS_FROM, is_virtual

SOURCE_RADIUS = 1.5  # cells of the map: a source in the corner of four cells reaches into all of them
SURROUNDING_RADIUS = 3.0  # cells: the ring from SOURCE_RADIUS on is what a source has to stand out of
COMPACT = (0.25, 0.5)  # of a light's power in such a source: none or all of that is reflected as a light. At half, most of it is the source
ISOLATED = (0.1, 0.3)  # power in the ring over the source's: up to it a source, from it on a part of something wider
# Cells from a light to its neighbours: up to it one of many on a lamp, whose lights together are as fine as the map; from it on not.
DENSE = (1.5, 2.5)
GAUSSIAN_SPACING = 0.5  # standard deviation of such a light over that distance: Gaussians on a lattice then sum to 1 within 2 %
EVERY_PAIR = 256  # lights, up to which each pair is measured, in 3 ms: a tree takes less, but a third of a second to load
NEIGHBOURS = 4  # of a light, whose distance gives its spread: those of a square lattice
CELL_VARIANCE = 1 / 12  # of a square cell along an axis, over its side^2


class ReflectedLight(NamedTuple):
    """radiance: (rows, cols, 3) float32, the map without what lights reflect themselves; None: there is no map. scale: (3,) float64, of it,
    by which it has the power of the lights.

    For each light, (n,) float64: direct, the fraction that lobes reflect as a light; spread, the variance along an axis in rad^2 by which
    it widens them; least_width, the variance to which it widens narrower ones.
    """

    radiance: np.ndarray | None
    coverage: Coverage
    scale: np.ndarray
    direct: np.ndarray
    spread: np.ndarray
    least_width: np.ndarray


class _Taken(NamedTuple):
    """A source that a light reflects itself, a fraction of the light; the others as in ReflectedLight."""

    fraction: float
    spread: float
    least_width: float


class _Cells(NamedTuple):
    directions: np.ndarray  # (rows, cols, 3) float64
    solid_angles: np.ndarray  # (rows,) float64, sr
    size_rad: float


@lru_cache(maxsize=4)
def _cells(rows: int, cols: int, coverage: Coverage) -> _Cells:
    size_rad = max(SPAN[coverage] / rows, 2 * np.pi / cols)
    return _Cells(cell_directions(rows, cols, coverage), cell_solid_angles(rows, cols, coverage), size_rad)


def reflected_light(lights: LightSet, environment: EnvironmentMap | None) -> ReflectedLight:
    """What lobes reflect under `lights`, of the same moment as the map; without one, the lights, widened by their extent where it is known.
    Virtual lamps are not in the map: lobes reflect them so, too.
    """
    count = len(lights.ids)
    if environment is None or count == 0:
        spread = np.zeros(count) if lights.covariances is None else Extents.of(lights).spreads ** 2
        return ReflectedLight(None, "hemisphere", np.ones(3), np.ones(count), spread, np.zeros(count))
    radiance = np.where(np.isfinite(environment.radiance), environment.radiance, 0).clip(0)
    total = map_irradiance(radiance, environment.coverage)
    sources = _Sources(radiance, environment.coverage, environment.bright_cells)
    virtual = is_virtual(lights)
    own = np.flatnonzero(~virtual)
    apart = np.zeros(count)
    apart[own] = neighbour_distance(lights.directions[own])
    direct, spread, least_width = np.zeros(count), CELL_VARIANCE * apart**2, (GAUSSIAN_SPACING * apart) ** 2
    power = luminance_from_rgb(lights.irradiance.astype(np.float64))
    direct[virtual], spread[virtual], least_width[virtual] = 1.0, _lamp_variances(lights)[virtual], 0.0
    for light in own[sources.candidates(lights.directions[own], power[own])].tolist():
        source = sources.take(lights.directions[light].astype(np.float64), float(power[light]), float(apart[light]))
        if source.fraction > 0:
            direct[light], spread[light], least_width[light] = source
    lit = lights.irradiance[own].sum(axis=0, dtype=np.float64)
    scale = np.divide(lit, total, out=np.zeros(3), where=total > 0)
    return ReflectedLight(sources.rest, environment.coverage, scale, direct, spread, least_width)


def _lamp_variances(lights: LightSet) -> np.ndarray:
    """Variance along an axis in rad^2, (n,) float64, of each virtual lamp's light; of a point of several, of those of its lamp."""
    if lights.covariances is not None:
        return Extents.of(lights).spreads ** 2
    variances, lamp = np.zeros(len(lights.ids)), lights.ids // POINTS
    for each in np.unique(lamp[lights.ids >= POINTS * VIRTUAL_IDS_FROM]).tolist():
        points = lights.directions[lamp == each].astype(np.float64)
        variances[lamp == each] = ((points - points.mean(axis=0)) ** 2).sum(axis=1) / 2
    return variances


class _Sources:
    """The sources in a map, which loses those that are taken."""

    def __init__(self, radiance: np.ndarray, coverage: Coverage, bright: BrightCells) -> None:
        self._radiance, self._bright = radiance, bright
        self._coverage: Coverage = coverage
        self._left = np.ones(radiance.shape[:2])  # of the light in each cell, a fraction
        self._cells = _cells(*radiance.shape[:2], coverage)
        self._luminance = luminance_from_rgb(radiance.astype(np.float64))

    def candidates(self, directions: np.ndarray, power: np.ndarray) -> list[int]:
        """The lights that may be sources, the strongest first: of a fourth of its power one of nine cells has at least a ninth."""
        rows, cols, _ = self._radiance.shape
        row, col = self._cell_of(directions)
        near = np.arange(-1, 2)
        around = (np.clip(row[:, None, None] + near[:, None], 0, rows - 1), (col[:, None, None] + near) % cols)
        brightest = (self._luminance * self._cells.solid_angles[:, None])[around].max(axis=(1, 2))
        return [k for k in np.argsort(-power, kind="stable").tolist() if power[k] > 0 and brightest[k] * 9 >= COMPACT[0] * power[k]]

    def take(self, direction: np.ndarray, power: float, apart_rad: float) -> _Taken:
        """Takes from the map what of a light of this power, so far from its neighbours, is a source."""
        row, col = self._window(direction)
        cells, solid_angles, size = self._cells.directions[row, col], self._cells.solid_angles[row], self._cells.size_rad
        distance = np.linalg.norm(cells - direction, axis=-1) / size
        inside, ring = distance < SOURCE_RADIUS, (distance >= SOURCE_RADIUS) & (distance < SURROUNDING_RADIUS)
        flux = self._luminance[row, col] * solid_angles
        left = flux * self._left[row, col]
        dense = 1 - _ramp(apart_rad / size, DENSE)
        around = (1 - dense) * flux[ring].sum() / max(solid_angles[ring].sum(), 1e-30)
        excess = np.where(inside, np.minimum(np.maximum(flux - around * solid_angles, 0), left), 0)
        found = float(excess.sum())
        alone = 1 - _ramp(flux[ring].sum() / max(flux[inside].sum(), 1e-30), ISOLATED)
        gate = _ramp(found / power, COMPACT) * max(alone, dense)
        if gate == 0:
            return _Taken(0.0, 0.0, 0.0)
        # The nearest of it, as much as the light has.
        wanted, order = gate * min(found, power), np.argsort(distance, axis=None)
        before = np.cumsum(excess.ravel()[order]) - excess.ravel()[order]
        taken = np.zeros(excess.size)
        taken[order] = np.clip(wanted - before, 0, excess.ravel()[order])
        taken = taken.reshape(excess.shape)
        self._left[row, col] -= np.divide(taken, flux, out=np.zeros_like(taken), where=flux > 0)
        variance = float((taken * self._variances(row, col, direction)).sum() / wanted)
        return _Taken(wanted / power, variance, dense * (1 - alone) * (GAUSSIAN_SPACING * apart_rad) ** 2)

    @property
    def rest(self) -> np.ndarray:
        """The map without what was taken, (rows, cols, 3) float32."""
        return self._radiance * np.maximum(self._left, 0).astype(np.float32)[..., None]

    def _variances(self, row: np.ndarray, col: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Mean square along an axis of the distance of each cell's light from a direction; of bright cells, that of their samples."""
        size = self._cells.size_rad
        variance = ((self._cells.directions[row, col] - direction) ** 2).sum(axis=-1) / 2 + size**2 / 12
        if len(self._bright.cells):
            number = row * self._radiance.shape[1] + col
            squares = ((self._bright.directions - direction) ** 2).sum(axis=-1) / 2 + (size / SUBCELLS) ** 2 / 12
            cells, sample = np.unique(self._bright.cells, return_inverse=True)
            means = np.bincount(sample, self._bright.weights * squares)
            at = np.searchsorted(cells, number).clip(0, len(cells) - 1)
            variance = np.where(cells[at] == number, means[at], variance)
        return variance

    def _cell_of(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows, cols, _ = self._radiance.shape
        row, col = cell_from_direction(directions, rows, cols, self._coverage)
        return np.minimum(row.astype(np.int64), rows - 1), col.astype(np.int64) % cols

    def _window(self, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The cells (h, w) about a direction that SURROUNDING_RADIUS reaches."""
        rows, cols, _ = self._radiance.shape
        row, col = (int(each) for each in self._cell_of(direction))
        reach = int(np.ceil(SURROUNDING_RADIUS)) + 1
        low, high = max(row - reach, 0), min(row + reach + 1, rows)
        ends = min(low, rows - high) if self._coverage == "sphere" else low  # rows from the nearer pole
        narrowest = np.sin(ends * SPAN[self._coverage] / rows)
        across = int(np.ceil(reach * self._cells.size_rad / max(narrowest, 1e-9) * cols / (2 * np.pi)))
        columns = np.arange(cols) if 2 * across + 1 >= cols else (col + np.arange(-across, across + 1)) % cols
        return np.broadcast_arrays(np.arange(low, high)[:, None], columns)  # type: ignore[return-value]


def _ramp(value: float, span: tuple[float, float]) -> float:
    """0 up to the start of a span, 1 from its end on."""
    return min(max((value - span[0]) / (span[1] - span[0]), 0.0), 1.0)


def neighbour_distance(directions: np.ndarray) -> np.ndarray:
    """The mean distance, in rad, from each light of the directions (n, 3) to its NEIGHBOURS nearest, (n,) float64; 0 of a single light."""
    neighbours = min(NEIGHBOURS, len(directions) - 1)
    if neighbours < 1:
        return np.zeros(len(directions))
    if len(directions) <= EVERY_PAIR:
        places = directions.astype(np.float64)
        squares = ((places[:, None] - places) ** 2).sum(axis=-1)
        return np.sqrt(np.partition(squares, np.arange(neighbours + 1), axis=1)[:, 1 : neighbours + 1]).mean(axis=1)
    from scipy.spatial import KDTree

    return KDTree(directions).query(directions, neighbours + 1)[0][:, 1:].mean(axis=1)
