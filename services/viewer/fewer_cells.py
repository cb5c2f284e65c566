"""A polar map with fewer cells, for pages: means over solid angle, so that the light stays."""

import numpy as np

from vemlight.light.sphere import Coverage, cell_solid_angles


def fewer_cells(values: np.ndarray, coverage: Coverage, most: int) -> np.ndarray:
    """The map (rows, cols, ...) float64, or the means of its cells in at most `most` of the same shape."""
    rows, cols, *_ = values.shape
    if rows * cols <= most:
        return values.astype(np.float64)
    side = float(np.sqrt(rows * cols / most))
    area = cell_solid_angles(rows, cols, coverage)
    down, across = _overlaps(rows, max(1, int(rows / side))) * area, _overlaps(cols, max(1, int(cols / side)))
    down, across = down / down.sum(axis=1, keepdims=True), across / across.sum(axis=1, keepdims=True)
    return np.einsum("ai,ij...,bj->ab...", down, values, across, optimize=True)


def _overlaps(count: int, fewer: int) -> np.ndarray:
    """How much of each of `count` intervals lies in each of `fewer` that span the same, (fewer, count)."""
    edges, own = np.linspace(0, count, fewer + 1), np.arange(count)
    return np.clip(np.minimum(edges[1:, None], own + 1) - np.maximum(edges[:-1, None], own), 0, None)
