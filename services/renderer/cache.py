"""Which shadow maps are drawn again: each light reads the drawn map whose direction is nearest, and a frame's budget renews the worst."""

from typing import NamedTuple

import numpy as np


class MapPlan(NamedTuple):
    """tiles: (n,) int64, the map each light reads. renewed: (k,) int64 tiles to draw now, above all others in worth.

    drawn: (m, 3) float32, the direction of each tile's map once that is done; nan where there is none. off: how many lights needed a map.
    """

    tiles: np.ndarray
    renewed: np.ndarray
    drawn: np.ndarray
    off: int


def no_maps(tiles: int) -> np.ndarray:
    """The state `drawn` of an atlas of so many tiles in which nothing is drawn."""
    return np.full((tiles, 3), np.nan, np.float32)


def planned_maps(
    drawn: np.ndarray, directions: np.ndarray, strength: np.ndarray, budget: int, tolerance: float, stale: np.ndarray | float = 0.0
) -> MapPlan:
    """A plan for lights from `directions` (n, 3) of `strength` (n,) with at least n tiles in `drawn`.

    stale: (m,) rad by which a light would have to turn to move a shadow as far as what casts it has moved since the tile was drawn.
    A light keeps a map within `tolerance` rad of it. The others are served by strength times angle, the largest error first, as many as
    the budget allows, into tiles that no other light reads; what is left over reads the nearest map until its turn comes. While nothing
    is drawn the budget does not count. Raises ValueError when the tiles are too few.
    """
    count = len(directions)
    if len(drawn) < count:
        raise ValueError(f"{len(drawn)} tiles are too few for {count} lights")
    have = np.flatnonzero(~np.isnan(drawn[:, 0]))
    if len(have) == 0:
        after = drawn.copy()
        after[:count] = directions
        return MapPlan(np.arange(count), np.arange(count), after, count)
    # Chord lengths by (a - b)^2 = a^2 + b^2 - 2 a b: float64 leaves them exact to 2e-8, float32 knew nothing below 0.02 degrees.
    light, tile = directions.astype(np.float64), drawn[have].astype(np.float64)
    square = np.sum(light**2, axis=1)[:, None] + np.sum(tile**2, axis=1) - 2 * (light @ tile.T)
    chord = np.sqrt(np.maximum(square, 0)) + np.broadcast_to(stale, len(drawn))[have]
    nearest = np.argmin(chord, axis=1)
    off = chord[np.arange(count), nearest]
    error = np.where(off > tolerance, strength * off, 0.0)
    order = np.argsort(-error, kind="stable")
    wanted = int(np.count_nonzero(error > 0))
    chosen = order[: min(budget, wanted)]
    tiles = have[nearest]
    kept = np.ones(count, bool)
    kept[chosen] = False
    free = np.setdiff1d(np.arange(len(drawn)), tiles[kept])
    empty_first = free[np.argsort(~np.isnan(drawn[free, 0]), kind="stable")]
    tiles[chosen] = empty_first[: len(chosen)]
    after = drawn.copy()
    after[tiles[chosen]] = directions[chosen]
    return MapPlan(tiles, tiles[chosen], after, wanted)
