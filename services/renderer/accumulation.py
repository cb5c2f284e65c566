"""Progressive refinement of a still scene: each pass has other lights of the same map and another sample of each pixel.

Each pass is a whole picture under PASS_LIGHTS lights drawn from the map by its luminance, none of which another pass has, with all their
shadow maps; the mean of the passes converges to the map's exact integral over each pixel's area.
"""

from typing import NamedTuple

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.extent import Extents
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage, cell_directions, cell_solid_angles, ring_edges
from vemlight.light.virtual_lamp import is_virtual

PASS_LIGHTS = 64  # of a pass: it takes about as long as a live picture; any value in 32..128 does
PASSES = 64  # 4096 lights; the error left is below 1 % (tests), and one code of 255 is 0.4 to 4 %; more only take longer
PLASTIC = 1.32471795724474602596  # the root of x^3 = x + 1: its powers give the most even sequence in the plane (Roberts 2018)


def spread_points(first: int, count: int) -> np.ndarray:
    """Points first .. first + count - 1 of an even sequence in the unit square, (count, 2); the first is its middle."""
    return (0.5 + np.arange(first, first + count)[:, None] * np.array([1 / PLASTIC, 1 / PLASTIC**2])) % 1.0


class Accumulation(NamedTuple):
    """A picture that is the mean of `passes` passes.

    total: (height, width, 4) float64, their sum. doubling: the mean's luminance when their number was last a power of two. error: how
    wrong the mean was then, the mean of its absolute error over its mean luminance, estimated by how much it had changed since half as
    many. On three maps that is 0.8 to 1.2 times the error against 192 passes, and 1.3 to 2 times after 64. 0: not known yet.
    """

    total: np.ndarray | float
    passes: int
    doubling: np.ndarray | None = None
    error: float = 0.0

    @staticmethod
    def empty() -> "Accumulation":
        return Accumulation(0.0, 0)

    @property
    def picture(self) -> np.ndarray:
        """(height, width, 4) float32, the mean; at least one pass must be in it."""
        return np.asarray(self.total / self.passes, np.float32)

    @property
    def lights(self) -> int:
        """How many lights its passes have together."""
        return self.passes * PASS_LIGHTS

    @property
    def converged(self) -> bool:
        return self.passes >= PASSES

    def with_pass(self, picture: np.ndarray) -> "Accumulation":
        """The same with one pass more."""
        after = self._replace(total=self.total + picture, passes=self.passes + 1)
        if after.passes & self.passes:  # not a power of two
            return after
        mean = luminance_from_rgb(after.picture[..., :3].astype(np.float64))
        if self.doubling is None or not mean.mean() > 0:
            return after._replace(doubling=mean)
        return after._replace(doubling=mean, error=float(np.abs(mean - self.doubling).mean() / mean.mean()))


class MapLights:
    """A polar map (rows, cols, 3) as an endless supply of lights, with the virtual lamps among `lights`."""

    def __init__(self, radiance: np.ndarray, coverage: Coverage, lights: LightSet | None = None) -> None:
        self.radiance, self.lamps = radiance, virtual_lamps(LightSet.none() if lights is None else lights)
        self.coverage: Coverage = coverage
        rows, cols, _ = radiance.shape
        power = luminance_from_rgb(radiance.astype(np.float64)) * cell_solid_angles(rows, cols, coverage)[:, None]
        self._total = float(power.sum())
        self._rows = np.concatenate([[0.0], np.cumsum(power.sum(axis=1))])
        self._cols = np.concatenate([np.zeros((rows, 1)), np.cumsum(power, axis=1)], axis=1)

    def same_as(self, other: "MapLights") -> bool:
        """Whether both are the same light."""
        lamps = (self.lamps.directions, self.lamps.irradiance, Extents.of(self.lamps).axes)
        others = (other.lamps.directions, other.lamps.irradiance, Extents.of(other.lamps).axes)
        return np.array_equal(self.radiance, other.radiance) and all(map(np.array_equal, lamps, others))

    def of_pass(self, number: int) -> LightSet:
        """The PASS_LIGHTS lights of a pass, none of a black map, and a point of each lamp. Their irradiance's mean over passes is the map's
        and the lamps', in each channel.
        """
        lit = self._total > 0
        return joined(self.lights(spread_points(number * PASS_LIGHTS, PASS_LIGHTS)) if lit else LightSet.none(), self._points(number))

    def _points(self, number: int) -> LightSet:
        """One point of each lamp for a pass: places of an ellipse with the lamp's covariance, that fill it evenly over the passes."""
        extents = Extents.of(self.lamps)
        along, about = spread_points(number, 1)[0]
        across = 2 * np.sqrt(along) * np.array([np.cos(2 * np.pi * about), np.sin(2 * np.pi * about)])
        places = self.lamps.directions * extents.concentrations[:, None] + np.einsum("a,nai->ni", across, extents.axes)
        return LightSet.of(self.lamps.ids, places / np.linalg.norm(places, axis=1, keepdims=True), self.lamps.irradiance)

    def lights(self, points: np.ndarray) -> LightSet:
        """The light at each of (n, 2) points of the unit square, by the map's luminance: rows first, then the cells of a row."""
        rows, cols, _ = self.radiance.shape
        row, down = _inverse(self._rows, points[:, 0])
        col, along = np.empty_like(row), np.empty(len(points))
        for i in np.unique(row):
            here = row == i
            col[here], along[here] = _inverse(self._cols[i], points[here, 1])
        edges = ring_edges(rows, self.coverage)
        height = 1 - (edges[row] + down * (edges[row + 1] - edges[row]))
        phi = 2 * np.pi * (col + along) / cols
        level = np.sqrt(np.maximum(1 - height * height, 0))
        directions = np.stack([level * np.cos(phi), level * np.sin(phi), height], axis=-1)
        colour = self.radiance[row, col].astype(np.float64)
        irradiance = colour * (self._total / (len(points) * luminance_from_rgb(colour)))[:, None]
        return LightSet.of(np.arange(len(points)), directions, irradiance)

    def cells(self) -> LightSet:
        """The map exactly: a light for each cell that is not black; and the lamps as points."""
        rows, cols, _ = self.radiance.shape
        irradiance = (self.radiance.astype(np.float64) * cell_solid_angles(rows, cols, self.coverage)[:, None, None]).reshape(-1, 3)
        lit = np.flatnonzero(irradiance.any(axis=1))
        own = LightSet.of(lit, cell_directions(rows, cols, self.coverage).reshape(-1, 3)[lit], irradiance[lit])
        return joined(own, self.lamps)


def virtual_lamps(lights: LightSet) -> LightSet:
    """Those of the lights that are virtual lamps."""
    chosen = is_virtual(lights)
    extents = None if lights.covariances is None else lights.covariances[chosen]
    return LightSet(lights.ids[chosen], lights.directions[chosen], lights.irradiance[chosen], extents)


def joined(a: LightSet, b: LightSet) -> LightSet:
    """Two sets as points."""
    return LightSet.of(*(np.concatenate([x, y]) for x, y in zip(a[:3], b[:3], strict=True)))


def _inverse(sums: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverts running sums at fractions u (n,) of the last: the interval, never an empty one, and how far inside it, 0 to 1."""
    at = u * sums[-1]
    k = np.searchsorted(sums, at, side="right") - 1
    last = int(np.flatnonzero(np.diff(sums) > 0)[-1])
    k = np.minimum(k, last)
    return k, np.clip((at - sums[k]) / (sums[k + 1] - sums[k]), 0, 1)
