"""Where rays go on a soft light: points of a Gaussian, another few of them in each of 4 x 4 pixels and at each sample of a pixel.

Nothing is random and nothing changes from frame to frame, so a still picture is still.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

POINT, FEW = 0, 4  # rays of a pixel to a light: one to its middle, and some
GOLDEN = (np.sqrt(5) - 1) / 2  # turns that are multiples of it are spread most evenly
STRATA = 16  # of a light: the rays of a pixel over its samples, or of 4 x 4 pixels with one sample
# The order in which 4 x 4 pixels take them (Bayer 1973): neighbours are far apart.
PLACES = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]])

# Where the rays of a pixel's only sample begin, (k, 2) float32, right and down from its middle: of STRATA and of FEW. Each four
# that follow each other are in all columns and rows of 4 x 4 places, the first two far apart: they tell whether there is an edge.
LATIN = np.array([[0, 1], [3, 2], [1, 3], [2, 0]])
WITHIN = (np.concatenate([(LATIN + np.array([0, shift])) % 4 for shift in range(4)]) / 4 - 0.375).astype(np.float32)
WITHIN_FEW = np.array([[-0.25, -0.25], [0.25, 0.25], [0.25, -0.25], [-0.25, 0.25]], np.float32)


class SoftPattern(NamedTuple):
    """Offsets (k, 2, 16) float32 in standard deviations along a light's axes, of each pixel of 4 x 4 row by row.

    one: k = 1, and 4 x 4 pixels have all strata together. few: k = FEW, and 2 x 2 pixels have. many: a pixel has, with its other samples.
    within_few, within: (k, 2) float32, where those rays begin, from the middle of the pixel; of one of several samples they begin there.
    """

    one: np.ndarray
    few: np.ndarray
    many: np.ndarray
    within_few: np.ndarray
    within: np.ndarray


@cache
def soft_pattern(sample: int, samples: int) -> SoftPattern:
    """The pattern at a sample of each pixel's `samples`."""
    place = PLACES.reshape(-1, 1)
    one, few, many = _gaussian(place, np.full_like(place, STRATA // 2)), _shared(place % FEW, FEW), _shared(sample, samples)
    spread = np.float32(samples == 1)
    return SoftPattern(one, few, many, spread * WITHIN_FEW, spread * WITHIN[: len(many)])


@cache
def ball_pattern(sample: int, samples: int) -> np.ndarray:
    """Offsets (k, 2, 16) float32 evenly over a disc of radius 1, likewise: where rays go on a ball, a pixel's with its other samples.

    Of samples that have one ray each, each STRATA that follow each other have all strata, turned about the middle against those before, and
    so have 4 x 4 pixels with each sample.
    """
    if samples < STRATA:
        return _shared(sample, samples, _disc)
    place = PLACES.reshape(-1, 1)
    return _disc((place + sample) % STRATA, (place + sample // STRATA * FEW) % STRATA, sample // STRATA * GOLDEN)


@cache
def live_ball_pattern() -> np.ndarray:
    """The same of FEW rays of each pixel: 2 x 2 pixels have all strata together, and so have 4 x 4 with each of their rays."""
    place = np.broadcast_to(PLACES.reshape(-1, 1), (STRATA, FEW))
    return _disc((place // FEW + FEW * (np.arange(FEW) + place)) % STRATA, place)


def _shared(part: np.ndarray | int, parts: int, spread: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None) -> np.ndarray:
    """The offsets of a pixel that has one part of the strata."""
    k = np.arange(-(-STRATA // parts))[::-1]
    k[1:] = np.roll(k[1:], 1)  # the outermost, the innermost, the others from the outside in: what the first agree on mostly holds for all
    stratum = (k * parts + (k + part) % parts) % STRATA
    shape = (STRATA, len(k))
    return (spread or _gaussian)(np.broadcast_to(stratum, shape), np.broadcast_to(PLACES.reshape(-1, 1), shape))


def _gaussian(stratum: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Points (k, 2, 16) float32 in strata (16, k), each at one of 16 places: radius by the one, angle by the other's mirrored digits."""
    radial, angle = _radial_and_angle(stratum, place)
    return _points(np.sqrt(-2 * np.log(1 - radial)) / np.sqrt(_variance()), angle)


def _disc(stratum: np.ndarray, place: np.ndarray, turns: float = 0.0) -> np.ndarray:
    """Points likewise of a disc of radius 1, turned so often about its middle."""
    radial, angle = _radial_and_angle(stratum, place)
    return _points(np.sqrt(radial), angle + 2 * np.pi * turns)


def _radial_and_angle(stratum: np.ndarray, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The fraction of all points that lie further in, and the angle."""
    radial = (stratum + (place + 0.5) / STRATA) / STRATA
    return radial, 2 * np.pi * (_mirrored(stratum) + _mirrored(place) / STRATA)


def _points(radius: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).transpose(1, 2, 0).astype(np.float32, order="C")


def _mirrored(numbers: np.ndarray) -> np.ndarray:
    """The four binary digits of whole numbers mirrored at the point (van der Corput 1935)."""
    return np.sum([((numbers >> bit) & 1) / 2 ** (bit + 1) for bit in range(4)], axis=0)


def _variance() -> float:
    """Of the points along an axis, in place of 1: the last stratum ends at its middle."""
    radial = (np.arange(STRATA * STRATA) + 0.5) / STRATA**2
    return float(np.mean(-np.log(1 - radial)))
