"""The points of the unit square from which lights are drawn, in an order whose every prefix is well spread.

Light number i always belongs to point number i, so raising or lowering the number of lights moves none of the others.
"""

from functools import lru_cache

import numpy as np


def halton(count: int) -> np.ndarray:
    """The first `count` points of the Halton sequence in bases 2 and 3, from index 1 (index 0 is a corner), (count, 2) float64."""
    return np.stack([_radical_inverse(2, count), _radical_inverse(3, count)], axis=-1)


def _radical_inverse(base: int, count: int) -> np.ndarray:
    digits, value, scale = np.arange(1, count + 1), np.zeros(count), 1.0 / base
    while digits.any():
        digits, digit = np.divmod(digits, base)
        value += digit * scale
        scale /= base
    return value


@lru_cache(maxsize=4)
def points(count: int) -> np.ndarray:
    """The first `count` points, (count, 2) float64, read-only."""
    table = halton(count)
    table.setflags(write=False)
    return table
