"""Which shadow maps are drawn again: each light reads the drawn map that fits it best, and a frame's budget renews the worst."""

from typing import NamedTuple

import numpy as np

GUTTER = 2  # texels at a map's rim that stay empty, as in light.glsl


class Slots(NamedTuple):
    """Places for maps. sizes: (m,) int64 texels a side. drawn: (m, 3) float32, the direction of the map that is there; nan for none.

    stale: (m,) float64 rad by which a light would have to turn to move a shadow as far as what casts it has moved since the map was drawn.
    """

    sizes: np.ndarray
    drawn: np.ndarray
    stale: np.ndarray

    @staticmethod
    def empty(sizes: np.ndarray) -> "Slots":
        return Slots(sizes, np.full((len(sizes), 3), np.nan, np.float32), np.zeros(len(sizes)))


class Needs(NamedTuple):
    """tiles: (n,) int64, the slot that serves each light best. off: (k,) int64, the lights that it does not serve, the worst first."""

    tiles: np.ndarray
    off: np.ndarray


class MapPlan(NamedTuple):
    """tiles: (n,) int64, the slot each light reads. renewed: (k,) int64, slots to draw now, of the worst lights first.

    slots: as they are once that is done.
    """

    tiles: np.ndarray
    renewed: np.ndarray
    slots: Slots


def texel_rad(sizes: np.ndarray) -> np.ndarray:
    """By how much a light turns when it shifts a shadow by a texel at the far end of a scene as deep as wide."""
    return 1 / (sizes - 2 * GUTTER)


def map_needs(slots: Slots, directions: np.ndarray, strength: np.ndarray, sizes: np.ndarray) -> Needs:
    """What lights from `directions` (n, 3) of `strength` (n,) need that are to have maps of `sizes` (n,).

    A light is served by a map of its size within a texel of it. The others come by strength times error, the largest first.
    """
    error = _errors(slots, directions, sizes)
    own = np.where(slots.sizes == sizes[:, None], error, np.inf)
    served = own.min(axis=1) <= texel_rad(sizes)
    tiles = np.where(served, own.argmin(axis=1), error.argmin(axis=1))
    worth = strength * np.minimum(error[np.arange(len(sizes)), tiles], np.pi)
    off = np.flatnonzero(~served)
    return Needs(tiles, off[np.argsort(-worth[off], kind="stable")])


def planned_maps(slots: Slots, needs: Needs, directions: np.ndarray, sizes: np.ndarray, budget: int) -> MapPlan:
    """Draws the maps of the first `budget` lights of `needs.off`, at least one, each into a slot of its size that no light needs.

    What is left over reads the map that fits best until its turn comes. There must be a slot of its size for each light, and what is
    drawn must serve a light or the budget all of them.
    """
    chosen, waiting = needs.off[:budget], needs.off[budget:]
    tiles = needs.tiles.copy()
    held, read = np.zeros(len(slots.sizes), bool), np.zeros(len(slots.sizes), bool)
    held[np.delete(tiles, needs.off)] = True
    read[tiles[waiting]] = True
    cost = np.where(np.isnan(slots.drawn[:, 0]), 0, 1 + read)  # of losing what is there: nothing, something, what another light reads
    for size in np.unique(sizes[chosen]):
        own, free = chosen[sizes[chosen] == size], np.flatnonzero((slots.sizes == size) & ~held)
        tiles[own] = free[np.argsort(cost[free], kind="stable")][: len(own)]
    slots = Slots(slots.sizes, slots.drawn.copy(), slots.stale.copy())
    slots.drawn[tiles[chosen]], slots.stale[tiles[chosen]] = directions[chosen], 0.0
    if len(waiting):
        tiles[waiting] = _errors(slots, directions[waiting], sizes[waiting]).argmin(axis=1)
    return MapPlan(tiles, tiles[chosen], slots)


def _errors(slots: Slots, directions: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """How badly each slot serves each light, (n, m) rad: by its map's direction, its age and its texels; inf where there is none."""
    # Chord lengths by (a - b)^2 = a^2 + b^2 - 2 a b: float64 leaves them exact to 2e-8, float32 knew nothing below 0.02 degrees.
    light, drawn = directions.astype(np.float64), slots.drawn.astype(np.float64)
    error = light @ (-2 * drawn.T)  # and from here on in place: of 500 lights each array takes 2 MB
    error += np.sum(light**2, axis=1)[:, None]
    error += np.sum(drawn**2, axis=1)
    np.sqrt(np.maximum(error, 0, out=error), out=error)
    error += slots.stale
    differ = texel_rad(slots.sizes) - texel_rad(sizes)[:, None]
    error += np.abs(differ, out=differ)
    error[:, np.isnan(drawn[:, 0])] = np.inf
    return error
