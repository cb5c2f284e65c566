"""The table of the warps of the unit square onto the sky: each with its sample, density and inverse."""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from vemlight.sampler.light_map import LightMap
from vemlight.sampler.warps import havran, standard
from vemlight.sampler.warps.points import Kind

WarpName = Literal["havran-azimuth", "havran-radius", "standard"]


class Samples(NamedTuple):
    """directions: (n, 3) unit vectors. radiance: (n, 3), of the map there. density: (n,), per sr. All float64."""

    directions: np.ndarray
    radiance: np.ndarray
    density: np.ndarray


class WarpKernels(NamedTuple):
    """tables: of a map. sample, density, inverse: compiled, with those tables. points: that suit the warp best."""

    tables: Callable[[LightMap], Any]
    sample: Callable[..., None]
    density: Callable[..., None]
    inverse: Callable[..., None]
    points: Kind


WARPS: dict[WarpName, WarpKernels] = {
    "havran-azimuth": WarpKernels(
        havran.azimuth_tables, havran.azimuth_sample, havran.azimuth_density, havran.azimuth_inverse, points="disc"
    ),
    "havran-radius": WarpKernels(
        havran.radius_tables, havran.radius_sample, havran.radius_density, havran.radius_inverse, points="disc"
    ),
    "standard": WarpKernels(
        standard.standard_tables, standard.standard_sample, standard.standard_density, standard.standard_inverse, points="relaxed"
    ),
}


class Warp(NamedTuple):
    """The warp for one map."""

    name: WarpName
    tables: Any

    def sample(self, points: np.ndarray) -> Samples:
        """The directions of points (n, 2) in [0, 1]^2, with the map's radiance and the density there."""
        n = len(points)
        block = np.empty(7 * n)  # one allocation: several large ones would be returned to the system and mapped again on each call
        samples = Samples(block[: 3 * n].reshape(n, 3), block[3 * n : 6 * n].reshape(n, 3), block[6 * n :])
        WARPS[self.name].sample(self.tables, points, *samples)
        return samples

    def density(self, directions: np.ndarray) -> np.ndarray:
        """Density per sr, (n,) float64, with which the samples of even points fall on unit directions (n, 3); 0 outside the map."""
        density = np.empty(len(directions))
        WARPS[self.name].density(self.tables, np.ascontiguousarray(directions, np.float64), density)
        return density

    def inverse(self, directions: np.ndarray) -> np.ndarray:
        """The points (n, 2) float64 that `sample` sends to unit directions (n, 3)."""
        points = np.empty((len(directions), 2))
        WARPS[self.name].inverse(self.tables, np.ascontiguousarray(directions, np.float64), points)
        return points


def warp_from_map(light: LightMap, name: WarpName) -> Warp:
    """The warp of that name for a map."""
    return Warp(name, WARPS[name].tables(light))


class Anchor(NamedTuple):
    """An azimuth (rad) with little light and the disc's azimuth (turns) that it belonged to."""

    azimuth: float
    turn: float


def steadied(warp: Warp, anchor: Anchor | None, gain: float) -> tuple[Warp, Anchor | None]:
    """The warp with its offset moved only by `gain` in [0, 1] of the way from the last frame's to its own, and this frame's anchor.

    Pixel noise moves the offset and with it all lights at once. An offset counts from phi = 0 and jumps by the power that crosses it, so
    it cannot be smoothed; the place on the disc of a dark azimuth can. Only for the azimuth-first order, whose offset is one for the map.
    """
    if warp.name != "havran-azimuth":
        return warp, None
    tables: havran.AzimuthTables = warp.tables
    if anchor is not None:
        away = (havran.turn_from_azimuth(tables, anchor.azimuth) - anchor.turn + 0.5) % 1.0 - 0.5
        tables = tables._replace(offset=tables.offset + (1 - gain) * away)
    azimuth = havran.dimmest_azimuth(tables)
    return Warp(warp.name, tables), Anchor(azimuth, havran.turn_from_azimuth(tables, azimuth))
