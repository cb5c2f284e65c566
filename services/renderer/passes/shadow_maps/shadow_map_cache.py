"""Which shadow maps are redrawn: each light reads the cached map that fits it best, and a frame's budget redraws the worst."""

from typing import NamedTuple

import numpy as np

from vemlight.renderer.gl.constants import GUTTER
from vemlight.renderer.passes.shadow_maps.casters import PlacedCasters


class Slots(NamedTuple):
    """Places for maps in the atlas and what each holds, a row for each of m.

    resolutions: (m,) int64 texels a side. directions: (m, 3) float32, for which the map was drawn; nan in an empty slot.
    drift_rad: (m,) float64, by how much a light would turn to move a shadow as far as its casters have moved since the map was drawn.
    lookups: (m, 3) float32, direction of the light whose lookups in this map the visibility cache holds; nan where it holds none.
    casters: (m,) what is in the map, where it stood; None in an empty slot.
    """

    resolutions: np.ndarray
    directions: np.ndarray
    drift_rad: np.ndarray
    lookups: np.ndarray
    casters: tuple[PlacedCasters | None, ...]

    @staticmethod
    def empty(resolutions: np.ndarray) -> "Slots":
        count = len(resolutions)
        none = np.full((count, 3), np.nan, np.float32)
        return Slots(resolutions, none, np.zeros(count), none, (None,) * count)

    @property
    def filled(self) -> np.ndarray:
        """(m,) bool, whether a map has been drawn into each."""
        return ~np.isnan(self.directions[:, 0])


class CacheMatch(NamedTuple):
    """slot: (n,) int64, the slot that serves each light best. stale: (k,) int64, the lights that it does not serve, the worst first."""

    slot: np.ndarray
    stale: np.ndarray


class CacheUpdate(NamedTuple):
    """slot: (n,) int64, the slot each light reads. redrawn: (k,) int64, slots to draw now, of the worst lights first.

    slots: as they are once that is done.
    """

    slot: np.ndarray
    redrawn: np.ndarray
    slots: Slots


def texel_rad(resolutions: np.ndarray) -> np.ndarray:
    """By how much a light turns to shift a shadow by a texel at the far end of a scene as deep as it is wide."""
    return 1 / (resolutions - 2 * GUTTER)


def match_lights(slots: Slots, directions: np.ndarray, strength: np.ndarray, resolutions: np.ndarray) -> CacheMatch:
    """Finds cached maps for lights from `directions` (n, 3) of `strength` (n,) that are to have maps of `resolutions` (n,).

    A light is served by a map of its resolution within a texel of it. The others are ordered by strength times error, largest first.
    """
    error = _errors(slots, directions, resolutions)
    own = np.where(slots.resolutions == resolutions[:, None], error, np.inf)
    served = own.min(axis=1) <= texel_rad(resolutions)
    slot = np.where(served, own.argmin(axis=1), error.argmin(axis=1))
    priority = strength * np.minimum(error[np.arange(len(resolutions)), slot], np.pi)  # no map at all counts as one behind the light
    stale = np.flatnonzero(~served)
    return CacheMatch(slot, stale[np.argsort(-priority[stale], kind="stable")])


def update_cache(
    slots: Slots, match: CacheMatch, directions: np.ndarray, resolutions: np.ndarray, budget: int, placed: PlacedCasters | None = None
) -> CacheUpdate:
    """Draws the maps of the first `budget` stale lights, at least one, each into a slot of its resolution that no light needs.

    The rest read the map that fits best until their turn comes. There must be a slot of its resolution for each light; either every map
    drawn serves a light or the budget covers all stale lights. placed: what is in the maps drawn now.
    """
    chosen, waiting = match.stale[:budget], match.stale[budget:]
    slot = match.slot.copy()
    needed, read = np.zeros(len(slots.resolutions), bool), np.zeros(len(slots.resolutions), bool)
    needed[np.delete(slot, match.stale)] = True
    read[slot[waiting]] = True
    loss = np.where(slots.filled, 1 + read, 0)  # of overwriting a slot: nothing, a map, a map that another light reads
    for resolution in np.unique(resolutions[chosen]):
        own, free = chosen[resolutions[chosen] == resolution], np.flatnonzero((slots.resolutions == resolution) & ~needed)
        slot[own] = free[np.argsort(loss[free], kind="stable")][: len(own)]
    redrawn, casters = slot[chosen], list(slots.casters)
    for k in redrawn.tolist():
        casters[k] = placed
    slots = Slots(slots.resolutions, slots.directions.copy(), slots.drift_rad.copy(), slots.lookups.copy(), tuple(casters))
    slots.directions[redrawn], slots.drift_rad[redrawn], slots.lookups[redrawn] = directions[chosen], 0.0, np.nan
    if len(waiting):
        slot[waiting] = _errors(slots, directions[waiting], resolutions[waiting]).argmin(axis=1)
    return CacheUpdate(slot, redrawn, slots)


def _errors(slots: Slots, directions: np.ndarray, resolutions: np.ndarray) -> np.ndarray:
    """How badly each slot serves each light, (n, m) rad: by its map's direction, drift and resolution; inf where there is no map."""
    # Chord lengths by (a - b)^2 = a^2 + b^2 - 2 a b: exact to 2e-8 in float64, where float32 resolves nothing below 0.02 degrees.
    light, drawn = directions.astype(np.float64), slots.directions.astype(np.float64)
    error = light @ (-2 * drawn.T)  # in place from here on: of 500 lights each array takes 2 MB
    error += np.sum(light**2, axis=1)[:, None]
    error += np.sum(drawn**2, axis=1)
    np.sqrt(np.maximum(error, 0, out=error), out=error)
    error += slots.drift_rad
    difference = texel_rad(slots.resolutions) - texel_rad(resolutions)[:, None]
    error += np.abs(difference, out=difference)
    error[:, ~slots.filled] = np.inf
    return error
