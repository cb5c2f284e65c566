"""The resolution of each light's shadow map, and where maps of several resolutions lie in one texture.

The edge of a shadow is blurred by a texel: with lights of fractions p of the power and maps of s x s texels the square error goes as the
sum of p^2 / s. For a given total of texels, the sum of s^2, it is least with s^3 proportional to p^2: s grows as p^(2/3). A little faster
is better, because a light with a small fraction of a sky stands for a cell that blurs its shadow anyway.
"""

import math
from typing import NamedTuple

import numpy as np

MAX_RESOLUTION = 1024  # of a light with FULL_FRACTION of the power: beyond it a sun of half a degree blurs its shadow more than texels do
FULL_FRACTION = 0.4  # a sun has more in a clear sky; with less a low one has 512 texels and half as much error again as exact shadows
EXPONENT = 3 / 4  # with 2/3 an even sky of 72 lights has 128 texels, for a sixth more time and a twelfth more error
MAX_HALVINGS = 4  # down to 64 texels: with 32 the error of an overcast sky is no less, and lamps lose a third more
SAME_SHADOW_TEXELS = 4  # lights nearer to each other than that cast the same shadow, and deserve what one light of their power would
MAX_COARSENING = 2  # halvings where time is short
MIN_RESOLUTION = 16  # of a map that is halved because time is short
STRONG_FRACTION = 1 / 8  # of the power: from it on a light's map is coarsened one halving later than the others
HYSTERESIS = 0.2  # of a halving beyond the middle between two: power that changes by less than 2^(0.2 / EXPONENT), a fifth, changes none


class MapResolutions(NamedTuple):
    """Resolutions of maps: `largest` texels a side, halved up to `halvings` times; by_power: by the light's power, or all alike."""

    largest: int
    halvings: int
    by_power: bool

    @property
    def choices(self) -> tuple[int, ...]:
        """All resolutions, the largest first."""
        return tuple(self.largest >> k for k in range(self.halvings + 1))


def map_resolutions(given: int | None) -> MapResolutions:
    """The resolutions for the setting `shadow_map`: None gives each light's map one that follows from the light's power."""
    if given is None:
        return MapResolutions(MAX_RESOLUTION, MAX_HALVINGS, True)
    return MapResolutions(given, sum(given >> k >= MIN_RESOLUTION for k in range(1, MAX_COARSENING + 1)), False)


def map_halvings(
    resolutions: MapResolutions, directions: np.ndarray, power: np.ndarray, coarsening: int = 0, previous: np.ndarray | None = None
) -> np.ndarray:
    """How often each light's map is halved, (n,) int64, for lights from `directions` (n, 3) of `power` (n,), all above 0.

    coarsening: how many halvings more, because time is short. previous: (n,) int64, those of the last frame, -1 for new lights.
    """
    light, fraction = directions.astype(np.float32), (power / power.sum()).astype(np.float32)
    cosines = light @ light.T  # rounded by 1e-7; lights SAME_SHADOW_TEXELS of 1024 apart have 1 - 8e-6
    within = [cosines > 1 - (SAME_SHADOW_TEXELS / size) ** 2 / 2 for size in resolutions.choices]
    near = np.stack([np.maximum(each @ fraction, 1e-9) for each in within]).astype(np.float64)
    exact = np.zeros(len(power))
    if resolutions.by_power:  # the largest resolution deserved by the lights that cast the same shadow at it
        deserved = -EXPONENT * np.log2(near / FULL_FRACTION)
        exact = np.min(np.maximum(deserved, np.arange(len(near))[:, None]), axis=0)
    exempt = np.clip(1 + np.log2(near[-1] / STRONG_FRACTION), 0, 1)
    exact = np.clip(exact + np.maximum(coarsening - exempt, 0), 0, resolutions.halvings)
    nearest = np.floor(exact + 0.5).astype(np.int64)
    if previous is None:
        return nearest
    return np.where((previous >= 0) & (np.abs(exact - previous) <= 0.5 + HYSTERESIS), previous, nearest)


class Packing(NamedTuple):
    """Where square tiles lie in a texture: their first texels (n, 2) int64, x and y; its width and height."""

    corners: np.ndarray
    width: int
    height: int


def packed(resolutions: np.ndarray, max_side: int) -> Packing | None:
    """Tiles of `resolutions` (n,) in rows of equal ones, the largest first, in a texture of at most `max_side` texels a side.

    It follows from the resolutions alone. None if they do not fit.
    """
    if len(resolutions) == 0:
        return Packing(np.zeros((0, 2), np.int64), 1, 1)
    width = 1 << max(int(resolutions.max()) - 1, math.isqrt(int(np.sum(resolutions**2)) - 1)).bit_length()
    while width <= max_side:
        corners, y = np.zeros((len(resolutions), 2), np.int64), 0
        for size in np.unique(resolutions)[::-1].tolist():
            own = np.flatnonzero(resolutions == size)
            row, column = np.divmod(np.arange(len(own)), width // size)
            corners[own] = np.stack([column * size, y + row * size], axis=-1)
            y += size * (int(row[-1]) + 1)
        part = max(width // 4, 1)  # heights are multiples of it: the texture is seldom replaced (an eighth or a half of the width do, too)
        if y <= max_side:
            return Packing(corners, width, min(-(-y // part) * part, max_side))
        width *= 2
    return None
