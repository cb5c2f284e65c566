"""Goniometric diagram mapping (Havran et al. 2005, section 3.1): a continuous map of the square onto the sky that follows its light.

Square -> disc (Shirley and Chiu) -> two one-dimensional inversions, one over the area coordinate a = 1 - cos(theta), one over
the azimuth phi, the second in a mixture of two neighbouring tables. Since d omega = da d phi, a density over (a, phi) is a density
per steradian. The paper leaves open which comes first. "azimuth" does phi first (density linear in phi between the centres of
columns, constant in a within a cell), "radius" a first (linear in a between the centres of rings, constant in phi). The tables that
are mixed are not normalised, or a one-pixel sun would be smeared along its ring (59 % instead of 77 % of its light within 3 x 3 pixels).

The sphere is the same code with a up to 2: the rim of the disc, and so the square's edge, is then the nadir.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.sphere import SPAN, ring_edges
from vemlight.sampler.light_map import LightMap
from vemlight.sampler.warps.square import (
    BLOCK,
    area_from_direction,
    last_at_most,
    load_cells,
    load_disc,
    square_from_disc,
    store_directions,
)

TURN = 2 * np.pi
_ring_edges = lru_cache(maxsize=8)(ring_edges)


class AzimuthTables(NamedTuple):
    """Of the azimuth-first order, unnormalised float64.

    edges: (rows + 1,) area coordinates. importance: (rows, cols). columns: (rows + 1, cols), integral over a up to each edge.
    turn: (cols + 1,), integral over azimuth from the centre of column 0. offset: what is added to the disc's azimuth, in turns.
    radiance: (rows, cols, 3) float32.
    """

    edges: np.ndarray
    importance: np.ndarray
    columns: np.ndarray
    turn: np.ndarray
    offset: float
    radiance: np.ndarray


class RadiusTables(NamedTuple):
    """Of the radius-first order, unnormalised float64.

    edges: as above. importance: (rows, cols). rings: (cols + 1, rows), integral over azimuth up to each column's left side.
    moments: (rows,), integral of azimuth x importance. knots: (rows + 2,) area coordinates 0, the rings' centres, the rim;
    density: (rows + 2,) there. outward: (rows + 2,), integral over a up to each knot. radiance: (rows, cols, 3) float32.
    """

    edges: np.ndarray
    importance: np.ndarray
    rings: np.ndarray
    moments: np.ndarray
    knots: np.ndarray
    density: np.ndarray
    outward: np.ndarray
    radiance: np.ndarray


class Mixture(NamedTuple):
    """Of each sample of a block, the two neighbouring tables and the weight of the second; (BLOCK,) each."""

    first: np.ndarray
    second: np.ndarray
    weight: np.ndarray


def azimuth_tables(light: LightMap) -> AzimuthTables:
    """The tables of a map, with the offset that keeps samples still when light crosses phi = 0.

    Without it every sample after the crossing light would sweep once round the sky. The offset 1/2 - E[phi] / 2 pi is the circular optimal
    transport of the marginal to the even one, in closed form.
    """
    rows, cols = light.importance.shape
    edges, columns, turn = _ring_edges(rows, light.coverage), np.empty((rows + 1, cols)), np.empty(cols + 1)
    offset = _fill_azimuth(light.importance, edges, columns, turn)
    return AzimuthTables(edges, light.importance, columns, turn, offset, light.radiance)


@kernel
def _fill_azimuth(importance, edges, columns, turn):
    rows, cols = importance.shape
    columns[0] = 0.0
    for i in range(rows):
        height = edges[i + 1] - edges[i]
        for j in range(cols):
            columns[i + 1, j] = columns[i, j] + height * importance[i, j]
    h, moment = TURN / cols, 0.0
    turn[0] = 0.0
    for j in range(cols):
        d0, d1 = columns[rows, j], columns[rows, (j + 1) % cols]
        turn[j + 1] = turn[j] + 0.5 * h * (d0 + d1)
        moment += 0.5 * h * (d0 + d1) * j * h + h * h * (d0 / 6 + d1 / 3)
    return 0.5 - moment / (TURN * turn[cols])


def radius_tables(light: LightMap) -> RadiusTables:
    """The tables of a map; the offset of the azimuth follows from them ring by ring."""
    rows, cols = light.importance.shape
    edges, rings, moments = _ring_edges(rows, light.coverage), np.empty((cols + 1, rows)), np.empty(rows)
    centres = 2 * np.sin((np.arange(rows) + 0.5) * (SPAN[light.coverage] / rows) / 2) ** 2
    knots = np.concatenate([[0.0], centres, edges[-1:]])
    _fill_radius(light.importance, rings, moments)
    density = np.concatenate([rings[-1, :1], rings[-1], rings[-1, -1:]])
    outward = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(knots))])
    return RadiusTables(edges, light.importance, rings, moments, knots, density, outward, light.radiance)


@kernel
def _fill_radius(importance, rings, moments):
    rows, cols = importance.shape
    h = TURN / cols
    for i in range(rows):
        total, moment = 0.0, 0.0
        rings[0, i] = 0.0
        for j in range(cols):
            total += importance[i, j] * h
            moment += importance[i, j] * (j + 0.5)
            rings[j + 1, i] = total
        moments[i] = moment * h * h


def turn_from_azimuth(tables: AzimuthTables, azimuth: float) -> float:
    """Azimuth on the disc, in turns in [0, 1), of the azimuth (rad) on the sky."""
    j, y, _ = _segment(azimuth / TURN % 1.0, tables.turn.size - 1)
    return float((_turn_at(tables.turn, tables.columns[-1], j, y) / tables.turn[-1] - tables.offset) % 1.0)


def dimmest_azimuth(tables: AzimuthTables) -> float:
    """The azimuth (rad) in the middle of the quarter turn with the least light."""
    return _dimmest_azimuth(tables.turn)


@kernel
def _dimmest_azimuth(turn):
    cols = turn.size - 1
    wide, best, least = max(cols // 4, 1), 0, np.inf
    for j in range(cols):
        end = j + wide
        light = turn[end] - turn[j] if end <= cols else turn[cols] - turn[j] + turn[end - cols]
        if light < least:
            best, least = j, light
    return (best + 0.5 * wide + 0.5) % cols * TURN / cols


@subroutine
def _step_inverse(d0, d1, h, x):
    """How far into a segment of length h, with density > 0 linear from d0 to d1, the integral reaches x (stable for d0 = d1)."""
    root = d0 + np.sqrt(max(d0 * d0 + (d1 - d0) * x * (2 / h), 0.0))
    return min(max(2 * x / root, 0.0), h)


@kernel
def _turn_at(turn, density, j, y):
    """Integral over azimuth from the centre of column 0 to `y` rad past the centre of column j."""
    cols = turn.size - 1
    d0, d1 = density[j], density[(j + 1) % cols]
    return turn[j] + y * (d0 + 0.5 * y * (d1 - d0) * cols / TURN)


@kernel
def _segment(w, cols):
    """(j, y, t): the column whose centre precedes the azimuth of w turns, the distance past it in rad and as a fraction of a column."""
    psi = w * cols - 0.5
    if psi < 0:
        psi += cols
    j = min(int(psi), cols - 1)
    t = min(max(psi - j, 0.0), 1.0)
    return j, t * TURN / cols, t


@kernel
def azimuth_sample(tables, points, directions, radiance, density):
    """Fills directions (n, 3), the map's radiance there (n, 3) and the density per sr (n,) for points (n, 2); all float64."""
    rows, cols = tables.importance.shape
    total, marginal, zero = tables.turn[cols], tables.columns[rows], np.uint64(0)
    a, w, t, d0, d1 = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    j, right, i = np.empty(BLOCK, np.uint64), np.empty(BLOCK, np.uint64), np.empty(BLOCK, np.uint64)
    for first in range(0, points.shape[0], BLOCK):
        n = min(BLOCK, points.shape[0] - first)
        # Azimuth of the disc, turned by the offset, through the marginal.
        load_disc(points[first : first + n], a, w)
        for k in range(n):
            w[k] += tables.offset
            w[k] = (w[k] - np.floor(w[k])) * total
        load_cells(tables.turn, w, j, n)
        for k in range(n):
            right[k] = j[k] + np.uint64(1) if j[k] + np.uint64(1) < np.uint64(cols) else zero
            d0[k], d1[k], t[k] = marginal[j[k]], marginal[right[k]], tables.turn[j[k]]
        for k in range(n):
            t[k] = _step_inverse(d0[k], d1[k], TURN / cols, w[k] - t[k]) * (cols / TURN)
            a[k] *= (1 - t[k]) * d0[k] + t[k] * d1[k]
            w[k] = (t[k] + 0.5 + j[k]) / cols
        # Radius through the mixture of two columns.
        columns = Mixture(j, right, t)
        _load_mixed(tables.columns, columns, a, i, n)
        _azimuth_store(tables, i, columns, a, radiance[first : first + n], density[first : first + n])
        store_directions(a, w, directions[first : first + n])


@subroutine
def _load_mixed(table, mixture, x, cell, n):
    """Fills the first n of cell (BLOCK,) with the last row of the mixture (1 - t) table[:, j0] + t table[:, j1] that is <= x."""
    j0, j1, t = mixture
    cell[:n] = 0
    left = np.uint64(table.shape[0] - 1)
    while left > 1:
        half = left >> np.uint64(1)
        for k in range(n):
            at = cell[k] + half
            cell[k] = at if (1 - t[k]) * table[at, j0[k]] + t[k] * table[at, j1[k]] <= x[k] else cell[k]
        left -= half


@subroutine
def _azimuth_store(tables, i, mixture, x, radiance, density):
    """Fills radiance and density in the cells found and puts the area coordinate in the place of x (BLOCK,)."""
    edges, importance, columns, total = tables.edges, tables.importance, tables.columns, tables.turn[-1]
    for k in range(density.size):
        row, j0, j1, mix = i[k], mixture.first[k], mixture.second[k], mixture.weight[k]
        f = (1 - mix) * importance[row, j0] + mix * importance[row, j1]
        below = (1 - mix) * columns[row, j0] + mix * columns[row, j1]
        x[k] = min(edges[row] + max(x[k] - below, 0.0) / f, edges[row + np.uint64(1)])
        density[k] = f / total
        for c in range(3):
            radiance[k, c] = (1 - mix) * tables.radiance[row, j0, c] + mix * tables.radiance[row, j1, c]


@kernel
def azimuth_density(tables, directions, density):
    """Fills the density per sr (n,) of unit directions (n, 3); 0 outside the map."""
    edges, importance = tables.edges, tables.importance
    rows, cols = importance.shape
    for n in range(directions.shape[0]):
        a, w = area_from_direction(directions[n, 0], directions[n, 1], directions[n, 2])
        j, _, t = _segment(w, cols)
        i = last_at_most(edges, a)
        inside = a <= edges[rows]
        density[n] = ((1 - t) * importance[i, j] + t * importance[i, (j + 1) % cols]) / tables.turn[cols] if inside else 0.0


@kernel
def azimuth_inverse(tables, directions, points):
    """Fills the points (n, 2) that `azimuth_sample` sends to the unit directions (n, 3); directions below the map go to its rim."""
    edges, importance, columns = tables.edges, tables.importance, tables.columns
    rows, cols = importance.shape
    marginal = columns[rows]
    for n in range(directions.shape[0]):
        a, w = area_from_direction(directions[n, 0], directions[n, 1], directions[n, 2])
        j, y, t = _segment(w, cols)
        k, a = (j + 1) % cols, min(a, edges[rows])
        i = last_at_most(edges, a)
        before = (1 - t) * columns[i, j] + t * columns[i, k]
        before += (a - edges[i]) * ((1 - t) * importance[i, j] + t * importance[i, k])
        w0 = _turn_at(tables.turn, marginal, j, y) / tables.turn[cols] - tables.offset
        points[n] = square_from_disc(min(before / ((1 - t) * marginal[j] + t * marginal[k]), 1.0), w0 - np.floor(w0))


@subroutine
def _ring_pair(s, y, knots, rows):
    """(ring below, ring above, weight of the upper one) at the distance y into the segment s between knots."""
    if s == 0 or s == rows:
        i = 0 if s == 0 else rows - 1
        return i, i, 0.0
    return s - 1, s, y / (knots[s + 1] - knots[s])


@kernel
def radius_sample(tables, points, directions, radiance, density):
    """As `azimuth_sample`, radius first."""
    rings, knots, d, outward = tables.rings, tables.knots, tables.density, tables.outward
    rows, cols = tables.importance.shape
    a, w, t, h, d0, d1 = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    segment, i, upper, j = np.empty(BLOCK, np.uint64), np.empty(BLOCK, np.uint64), np.empty(BLOCK, np.uint64), np.empty(BLOCK, np.uint64)
    for first in range(0, points.shape[0], BLOCK):
        n = min(BLOCK, points.shape[0] - first)
        # Radius through the marginal.
        load_disc(points[first : first + n], a, w)
        for k in range(n):
            a[k] *= outward[rows + 1]
        load_cells(outward, a, segment, n)
        for k in range(n):
            s = segment[k]
            after = s + np.uint64(1)
            d0[k], d1[k], h[k], t[k] = d[s], d[after], knots[after] - knots[s], a[k] - outward[s]
            a[k], i[k], upper[k] = knots[s], max(s, np.uint64(1)) - np.uint64(1), min(s, np.uint64(rows - 1))
        for k in range(n):
            distance = _step_inverse(d0[k], d1[k], h[k], t[k])
            a[k], t[k] = a[k] + distance, distance / h[k]
        # The azimuth, turned by the offset of this radius, through the mixture of two rings.
        for k in range(n):
            h[k] = (1 - t[k]) * tables.moments[i[k]] + t[k] * tables.moments[upper[k]]
            d0[k] = (1 - t[k]) * rings[cols, i[k]] + t[k] * rings[cols, upper[k]]
        for k in range(n):
            w[k] += 0.5 - h[k] / (TURN * d0[k])
            w[k] = (w[k] - np.floor(w[k])) * d0[k]
        rows_mixed = Mixture(i, upper, t)
        _load_mixed(rings, rows_mixed, w, j, n)
        _radius_store(tables, rows_mixed, j, w, radiance[first : first + n], density[first : first + n])
        store_directions(a, w, directions[first : first + n])


@subroutine
def _radius_store(tables, mixture, j, x, radiance, density):
    """Fills radiance and density in the cells found and puts the azimuth in turns in the place of x (BLOCK,)."""
    importance, rings = tables.importance, tables.rings
    rows, cols = importance.shape
    h, per_total = TURN / cols, 1 / tables.outward[rows + 1]
    for k in range(density.size):
        i0, i1, col, mix = mixture.first[k], mixture.second[k], j[k], mixture.weight[k]
        f = (1 - mix) * importance[i0, col] + mix * importance[i1, col]
        before = (1 - mix) * rings[col, i0] + mix * rings[col, i1]
        x[k] = (col + min(max(x[k] - before, 0.0) / (f * h), 1.0)) / cols
        density[k] = f * per_total
        for c in range(3):
            radiance[k, c] = (1 - mix) * tables.radiance[i0, col, c] + mix * tables.radiance[i1, col, c]


@kernel
def radius_density(tables, directions, density):
    """As `azimuth_density`, radius first."""
    importance, knots = tables.importance, tables.knots
    rows, cols = importance.shape
    for n in range(directions.shape[0]):
        a, w = area_from_direction(directions[n, 0], directions[n, 1], directions[n, 2])
        s = last_at_most(knots, a)
        i, k, t = _ring_pair(s, a - knots[s], knots, rows)
        j = min(int(w * cols), cols - 1)
        inside = a <= knots[rows + 1]
        density[n] = ((1 - t) * importance[i, j] + t * importance[k, j]) / tables.outward[rows + 1] if inside else 0.0


@kernel
def radius_inverse(tables, directions, points):
    """As `azimuth_inverse`, radius first."""
    importance, rings, knots, d, outward = tables.importance, tables.rings, tables.knots, tables.density, tables.outward
    rows, cols = importance.shape
    h = TURN / cols
    for n in range(directions.shape[0]):
        a, w = area_from_direction(directions[n, 0], directions[n, 1], directions[n, 2])
        a = min(a, knots[rows + 1])
        s = last_at_most(knots, a)
        y, length = a - knots[s], knots[s + 1] - knots[s]
        i, k, t = _ring_pair(s, y, knots, rows)
        a0 = (outward[s] + y * (d[s] + 0.5 * y * (d[s + 1] - d[s]) / length)) / outward[rows + 1]
        j = min(int(w * cols), cols - 1)
        ring = (1 - t) * rings[cols, i] + t * rings[cols, k]
        before = (1 - t) * rings[j, i] + t * rings[j, k] + (w * cols - j) * h * ((1 - t) * importance[i, j] + t * importance[k, j])
        w0 = before / ring - 0.5 + ((1 - t) * tables.moments[i] + t * tables.moments[k]) / (TURN * ring)
        points[n] = square_from_disc(min(a0, 1.0), w0 - np.floor(w0))
