"""Standard inversion: the first coordinate picks the area coordinate, the second the azimuth in that row; density constant in each cell.

What most path tracers do with an environment map (Pharr, Jakob and Humphreys 2016, section 14.2.4). Neighbours in the square are not always
neighbours on the sky: lights jump at the borders of rows.
"""

from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.sphere import ring_edges
from vemlight.sampler.light_map import LightMap
from vemlight.sampler.warps.square import BLOCK, area_from_direction, last_at_most, load_cells, store_directions

TURN = 2 * np.pi


class StandardTables(NamedTuple):
    """Unnormalised float64.

    edges: (rows + 1,) area coordinates. importance: (rows, cols). rings: (rows, cols + 1), integral over azimuth up to each
    column's left side. outward: (rows + 1,), integral over the sphere up to each edge. radiance: (rows, cols, 3) float32.
    """

    edges: np.ndarray
    importance: np.ndarray
    rings: np.ndarray
    outward: np.ndarray
    radiance: np.ndarray


def standard_tables(light: LightMap) -> StandardTables:
    """The tables of a map."""
    rows, cols = light.importance.shape
    edges, rings, outward = ring_edges(rows, light.coverage), np.empty((rows, cols + 1)), np.empty(rows + 1)
    _fill(light.importance, edges, rings, outward)
    return StandardTables(edges, light.importance, rings, outward, light.radiance)


@kernel
def _fill(importance, edges, rings, outward):
    rows, cols = importance.shape
    outward[0] = 0.0
    for i in range(rows):
        total = 0.0
        rings[i, 0] = 0.0
        for j in range(cols):
            total += importance[i, j] * (TURN / cols)
            rings[i, j + 1] = total
        outward[i + 1] = outward[i] + total * (edges[i + 1] - edges[i])


@kernel
def standard_sample(tables, points, directions, radiance, density):
    """Fills directions (n, 3), the map's radiance there (n, 3) and the density per sr (n,) for points (n, 2); all float64."""
    edges, importance, rings, outward = tables.edges, tables.importance, tables.rings, tables.outward
    rows, cols = importance.shape
    h, per_total = TURN / cols, 1 / outward[rows]
    a, w, i, j = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK, np.uint64), np.empty(BLOCK, np.uint64)
    for first in range(0, points.shape[0], BLOCK):
        n = min(BLOCK, points.shape[0] - first)
        for k in range(n):
            a[k] = points[first + k, 0] * outward[rows]
        load_cells(outward, a, i, n)
        for k in range(n):
            w[k] = points[first + k, 1] * rings[i[k], cols]
        _load_cols(rings, i, w, j, n)
        for k in range(n):
            row, col, after = i[k], j[k], i[k] + np.uint64(1)
            f = importance[row, col]
            part = min(max((a[k] - outward[row]) / (outward[after] - outward[row]), 0.0), 1.0)
            a[k] = edges[row] + part * (edges[after] - edges[row])
            w[k] = (col + min(max((w[k] - rings[row, col]) / (f * h), 0.0), 1.0)) / cols
            density[first + k] = f * per_total
            for c in range(3):
                radiance[first + k, c] = tables.radiance[row, col, c]
        store_directions(a, w, directions[first : first + n])


@subroutine
def _load_cols(table, rows, x, cols, n):
    """Fills the first n of cols (BLOCK,) with the last column of each sample's row of the table that is <= x."""
    cols[:n] = 0
    left = np.uint64(table.shape[1] - 1)
    while left > 1:
        half = left >> np.uint64(1)
        for k in range(n):
            at = cols[k] + half
            cols[k] = at if table[rows[k], at] <= x[k] else cols[k]
        left -= half


@kernel
def standard_density(tables, directions, density):
    """Fills the density per sr (n,) of unit directions (n, 3); 0 outside the map."""
    edges, importance = tables.edges, tables.importance
    rows, cols = importance.shape
    for n in range(directions.shape[0]):
        a, w = area_from_direction(directions[n, 0], directions[n, 1], directions[n, 2])
        j = min(int(w * cols), cols - 1)
        density[n] = importance[last_at_most(edges, a), j] / tables.outward[rows] if a <= edges[rows] else 0.0


@kernel
def standard_inverse(tables, directions, points):
    """Fills the points (n, 2) that `standard_sample` sends to the unit directions (n, 3); directions below the map go to its rim."""
    edges, importance, rings, outward = tables.edges, tables.importance, tables.rings, tables.outward
    rows, cols = importance.shape
    h = TURN / cols
    for n in range(directions.shape[0]):
        a, w = area_from_direction(directions[n, 0], directions[n, 1], directions[n, 2])
        a = min(a, edges[rows])
        i, j = last_at_most(edges, a), min(int(w * cols), cols - 1)
        part = (a - edges[i]) / (edges[i + 1] - edges[i])
        points[n, 0] = (outward[i] + part * (outward[i + 1] - outward[i])) / outward[rows]
        points[n, 1] = (rings[i, j] + (w * cols - j) * h * importance[i, j]) / rings[i, cols]
