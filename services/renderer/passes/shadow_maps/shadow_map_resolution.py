"""How many texels the shadow map of each light deserves, and where maps of different sizes lie in one texture.

The edge of a shadow is blurred by a texel: with lights of shares p of the power and maps of s texels a side the square error goes as the
sum of p^2 / s. Of all maps with as many texels in total, the sum of s^2, the least has s^3 as p^2: s grows as p^(2/3). A little faster, for
the light of a small share of a sky stands for a cell that blurs its shadow anyway.
"""

import math
from typing import NamedTuple

import numpy as np

LARGEST = 1024  # texels, of a light with SHARE of the power: beyond that a sun of half a degree blurs its shadow more than they do
SHARE = 0.4  # suns have more of a clear sky: with less a low one has 512 texels, and half as much error again as exact shadows
GROWTH = 3 / 4  # with 2/3 an even sky of 72 lights would have 128 texels, for a sixth more time and a twelfth more error
STEPS = 4  # halvings down to 64 texels: with 32 the error of an overcast sky is no less, and lamps lose a third more
NEAR = 4  # texels: lights nearer to each other than that throw the same shadow, and deserve what one of their power would
COARSER = 2  # halvings of maps of a given size, where time is short
LEAST = 16  # texels of a map that is halved
SPARED = 1 / 8  # share of the power from which on a light's map is halved one step later than the others
WAVER = 0.2  # of a step, beyond the middle between two: a share that changes by less than a quarter keeps its size


class Sizing(NamedTuple):
    """Sizes of maps: `largest` texels a side, halved up to `steps` times; by_power: by the light's share, or all alike."""

    largest: int
    steps: int
    by_power: bool

    @property
    def sizes(self) -> tuple[int, ...]:
        """All of them, largest first."""
        return tuple(self.largest >> k for k in range(self.steps + 1))


def sizing(texels: int | None) -> Sizing:
    """How maps are sized: each light's by its power when `texels` is None."""
    if texels is None:
        return Sizing(LARGEST, STEPS, True)
    return Sizing(texels, sum(texels >> k >= LEAST for k in range(1, COARSER + 1)), False)


def map_steps(
    sizing: Sizing, directions: np.ndarray, power: np.ndarray, halved: int = 0, before: np.ndarray | None = None
) -> np.ndarray:
    """How often each light's map is halved, (n,) int64, for lights from `directions` (n, 3) of `power` (n,), all above 0.

    halved: by how many steps more, where time is short. before: as it was in the last frame, -1 for new lights.
    """
    light, share = directions.astype(np.float32), (power / power.sum()).astype(np.float32)
    cosines = light @ light.T  # rounded by 1e-7, where NEAR texels of 1024 are 8e-6 away from 1
    near = np.stack([np.maximum((cosines > 1 - (NEAR / size) ** 2 / 2) @ share, 1e-9) for size in sizing.sizes]).astype(np.float64)
    exact = np.zeros(len(power))
    if sizing.by_power:  # the largest size that those deserve who are near to each other at it
        deserved = -GROWTH * np.log2(near / SHARE)
        exact = np.min(np.maximum(deserved, np.arange(len(near))[:, None]), axis=0)
    spared = np.clip(1 + np.log2(near[-1] / SPARED), 0, 1)
    exact = np.clip(exact + np.maximum(halved - spared, 0), 0, sizing.steps)
    nearest = np.floor(exact + 0.5).astype(np.int64)
    return nearest if before is None else np.where((before >= 0) & (np.abs(exact - before) <= 0.5 + WAVER), before, nearest)


class Packing(NamedTuple):
    """Where square tiles lie in a texture: their first texels (n, 2) int64, x and y; its width and height."""

    corners: np.ndarray
    width: int
    height: int


def packed(sizes: np.ndarray, most: int) -> Packing | None:
    """Tiles of `sizes` (n,) in rows of like size, the largest first, in a texture of at most `most` texels a side.

    It follows from the sizes alone. None when there is no room.
    """
    if len(sizes) == 0:
        return Packing(np.zeros((0, 2), np.int64), 1, 1)
    width = 1 << max(int(sizes.max()) - 1, math.isqrt(int(np.sum(sizes**2)) - 1)).bit_length()
    while width <= most:
        corners, y = np.zeros((len(sizes), 2), np.int64), 0
        for size in np.unique(sizes)[::-1].tolist():
            own = np.flatnonzero(sizes == size)
            row, column = np.divmod(np.arange(len(own)), width // size)
            corners[own] = np.stack([column * size, y + row * size], axis=-1)
            y += size * (int(row[-1]) + 1)
        part = max(width // 4, 1)  # of which heights are multiples: hardly ever another texture when sizes change
        if y <= most:
            return Packing(corners, width, min(-(-y // part) * part, most))
        width *= 2
    return None
