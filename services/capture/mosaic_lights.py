"""Lights on a mosaic that are sharper than its pixels: then each colour sees another part of them, and none knows how much it missed."""

from collections.abc import Callable

import numpy as np

HALF_WINDOW = 2  # pixels around the brightest: a lens blurs a point over less
# Of a light's excess over its surroundings in one pixel. A point blurred by a Gaussian of sigma 0.7 pixels leaves 0.28 there at most, and
# each colour is then right within 30 %; at 0.5, 0.47, and a colour may be off 1.6 times. On the corner of four pixels, where each colour
# has its part, no more than a quarter is in one.
SHARP_SHARE = 0.3


def is_sharper_than_mosaic(brightness: Callable[[np.ndarray], np.ndarray], pixel: int, shape: tuple[int, int]) -> bool:
    """Whether the light around a pixel is. brightness: radiance of flat indices of any shape. shape: height, width of the image."""
    row, column = divmod(pixel, shape[1])
    rows = np.arange(max(row - HALF_WINDOW, 0), min(row + HALF_WINDOW + 1, shape[0]))
    columns = np.arange(max(column - HALF_WINDOW, 0), min(column + HALF_WINDOW + 1, shape[1]))
    near = brightness(rows[:, None] * shape[1] + columns)
    return share_of_one_pixel(near, row - int(rows[0]), column - int(columns[0])) > SHARP_SHARE


def share_of_one_pixel(radiance: np.ndarray, row: int, column: int) -> float:
    """How much of the light around a pixel, beyond that of its surroundings, the brightest pixel there holds, 0 to 1.

    radiance: (height, width) of a mosaic's pixels, whatever their colours.
    """
    top, left = max(row - HALF_WINDOW, 0), max(column - HALF_WINDOW, 0)
    window = radiance[top : row + HALF_WINDOW + 1, left : column + HALF_WINDOW + 1].astype(np.float64)
    excess = np.maximum(window - np.median(window), 0)
    total = float(excess.sum())
    return float(excess.max()) / total if total > 0 else 0.0
