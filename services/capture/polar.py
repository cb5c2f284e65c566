"""Lat-long images resampled to the polar map, with the power of each channel conserved.

A lat-long pixel is a box in (1 - cos theta, phi), where solid angle is plain area, and so is a cell of the polar map: their overlaps are
exact products of two one-dimensional overlaps, and a cell is the mean of the pixels it overlaps, weighted by solid angle.

Values are not cleaned: nan and inf reach the cells that their pixel overlaps and no others; negative pixels count in the mean.
"""

from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells, bright_cells_from_light
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.sphere import SPAN, Coverage, direction_from_angles, ring_edges

# Thinner overlaps, as a fraction of the target interval, are rounding of edges that coincide: float64 leaves 1e-13, and they would carry
# a nan into the neighbouring cell. Any value from 1e-12 to 1e-7, the precision of the map's float32, does.
MIN_OVERLAP = 1e-9


class Overlaps(NamedTuple):
    """Mean over intervals, sparse: target i = sum of weight[k] * source[index[k]] for start[i] <= k < start[i + 1]."""

    start: np.ndarray  # (n + 1,) int64
    index: np.ndarray  # (entries,) int64
    weight: np.ndarray  # (entries,) float64, adding up to 1 for each target


WHOLE_SPHERE = (360.0, 180.0)


class LatlongToPolar(NamedTuple):
    """Weights from a lat-long image to a polar map. span: degrees across and down that it covers, the middle of the sphere."""

    height: int
    width: int
    span: tuple[float, float]
    rows: Overlaps
    cols: Overlaps


def overlaps(low: np.ndarray, high: np.ndarray, edges: np.ndarray) -> Overlaps:
    """Overlaps of the target intervals [low[i], high[i]] with the source intervals [edges[k], edges[k + 1]], ascending."""
    start, index, weight = [0], [], []
    for a, b in zip(low, high, strict=True):
        first = max(int(np.searchsorted(edges, a, side="right")) - 1, 0)
        last = min(int(np.searchsorted(edges, b, side="left")), len(edges) - 1)
        k = np.arange(first, last)
        fraction = (np.minimum(edges[k + 1], b) - np.maximum(edges[k], a)) / (b - a)
        index.append(k[fraction > MIN_OVERLAP])
        weight.append(fraction[fraction > MIN_OVERLAP])
        start.append(start[-1] + len(index[-1]))
    return Overlaps(np.array(start), np.concatenate(index), np.concatenate(weight))


def latlong_to_polar(
    height: int, width: int, rows: int, cols: int, coverage: Coverage, span: tuple[float, float] = WHOLE_SPHERE
) -> LatlongToPolar:
    """Weights from a lat-long image (height, width) to a polar map (rows, cols). What a narrower `span` leaves out is dark."""
    rings = ring_edges(rows, coverage)
    by_row = overlaps(rings[:-1], rings[1:], _row_edges(height, span[1]))
    # columns run against phi and the image's centre is phi = 0; negative columns lie at the image's right
    around = width * WHOLE_SPHERE[0] / span[0]
    ends = width / 2 - np.arange(cols + 1) * (around / cols)
    if span[0] == WHOLE_SPHERE[0]:
        by_col = overlaps(ends[1:], ends[:-1], np.arange(-(width // 2) - 1, width - width // 2 + 1, dtype=np.float64))
        columns = (by_col.index - (width // 2) - 1) % width
        return LatlongToPolar(height, width, span, by_row, by_col._replace(index=columns))
    # the image, once more a turn to the left, and the gap between the two, which has the index `width`
    pixels = np.arange(width + 1, dtype=np.float64)
    by_col = overlaps(ends[1:], ends[:-1], np.concatenate([pixels - around, pixels]))
    in_image = by_col.index != width
    start = np.concatenate([[0], np.cumsum(in_image)])[by_col.start]
    columns = by_col.index[in_image] % (width + 1)
    return LatlongToPolar(height, width, span, by_row, Overlaps(start, columns, by_col.weight[in_image]))


def _row_edges(height: int, span_deg: float) -> np.ndarray:
    """Area coordinates of the edges between an image's rows, (height + 1,); see `ring_edges`."""
    if span_deg == WHOLE_SPHERE[1]:
        return ring_edges(height, "sphere")
    return 2 * np.sin(np.radians(90 - span_deg / 2 + np.arange(height + 1) * (span_deg / height)) / 2) ** 2


def used_rows(weights: LatlongToPolar) -> int:
    """How many of an image's rows, from the top, the map needs."""
    return int(weights.rows.index.max()) + 1


def polar_from_latlong(image: np.ndarray, weights: LatlongToPolar) -> np.ndarray:
    """The polar map (rows, cols, 3) float32 of a lat-long image (height, width, 3) float32."""
    return _separable(image, weights.rows, weights.cols)


@kernel
def _separable(image, by_row, by_col):
    # columns first, in the rows of the image that the map needs
    rows, cols = len(by_row.start) - 1, len(by_col.start) - 1
    used = by_row.index.max() + 1  # see `used_rows`
    narrow = np.empty((used, cols, 3), np.float32)
    for y in range(used):
        for j in range(cols):
            r = g = b = 0.0
            for k in range(by_col.start[j], by_col.start[j + 1]):
                x, w = by_col.index[k], by_col.weight[k]
                r += w * image[y, x, 0]
                g += w * image[y, x, 1]
                b += w * image[y, x, 2]
            narrow[y, j, 0] = r
            narrow[y, j, 1] = g
            narrow[y, j, 2] = b
    polar = np.empty((rows, cols, 3), np.float32)
    for i in range(rows):
        for j in range(cols):
            r = g = b = 0.0
            for k in range(by_row.start[i], by_row.start[i + 1]):
                y, w = by_row.index[k], by_row.weight[k]
                r += w * narrow[y, j, 0]
                g += w * narrow[y, j, 1]
                b += w * narrow[y, j, 2]
            polar[i, j, 0] = r
            polar[i, j, 1] = g
            polar[i, j, 2] = b
    return polar


def latlong_bright_cells(image: np.ndarray, weights: LatlongToPolar, cells: np.ndarray, coverage: Coverage) -> BrightCells:
    """Where light lies inside each of the map's `cells` (n,), flat indices.

    A pixel's light counts from the middle of the area that pixel and cell have in common.
    """
    rows, cols = len(weights.rows.start) - 1, len(weights.cols.start) - 1
    half, high = np.radians(weights.span[0]) / 2, np.radians(weights.span[1])
    top = np.pi / 2 - high / 2
    owner, directions, flux = [], [], []
    for cell in cells.tolist():
        i, j = divmod(cell, cols)
        y = weights.rows.index[weights.rows.start[i] : weights.rows.start[i + 1]]
        x = weights.cols.index[weights.cols.start[j] : weights.cols.start[j + 1]]
        weight = weights.rows.weight[weights.rows.start[i] : weights.rows.start[i + 1], None]
        weight = weight * weights.cols.weight[weights.cols.start[j] : weights.cols.start[j + 1]]
        cell_theta, cell_phi = SPAN[coverage] / rows, 2 * np.pi / cols
        theta = _overlap_middles(top + y * high / weights.height, high / weights.height, i * cell_theta, cell_theta)
        # phi of a pixel's lower edge, brought next to the cell's across the seam
        low = (half - (x + 1) * 2 * half / weights.width - j * cell_phi + np.pi) % (2 * np.pi) - np.pi + j * cell_phi
        phi = _overlap_middles(low, 2 * half / weights.width, j * cell_phi, cell_phi)
        owner.append(np.full(weight.size, cell))
        directions.append(direction_from_angles(theta[:, None], phi[None, :]).reshape(-1, 3))
        flux.append((weight * luminance_from_rgb(image[np.ix_(y, x)])).ravel())
    if not owner:
        return NO_BRIGHT_CELLS
    return bright_cells_from_light(np.concatenate(owner), np.concatenate(directions), np.concatenate(flux), rows, cols, coverage)


def _overlap_middles(low: np.ndarray, size: float, cell: float, cell_size: float) -> np.ndarray:
    # middles of the overlaps of intervals from `low` on with the cell
    return (np.maximum(low, cell) + np.minimum(low + size, cell + cell_size)) / 2
