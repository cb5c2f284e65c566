"""Goniometric diagram mapping (Havran et al. 2005, section 3.1): a continuous map of the square onto the sky that follows its light.

Square -> disc (Shirley and Chiu) -> two one-dimensional inversions, one over the area coordinate a = 1 - cos(theta), one over
the azimuth phi, the second in a mixture of two neighbouring tables. Since d omega = da d phi, a density over (a, phi) is a density
per steradian. The paper leaves open which comes first. "azimuth" does phi first (density linear in phi between the centres of
columns, constant in a within a cell), "radius" a first (linear in a between the centres of rings, constant in phi). The tables that
are mixed are not normalised, or a one-pixel sun would be smeared along its ring (59 % instead of 77 % of its light within 3 x 3 pixels).

The sphere is the same code with a up to 2: the rim of the disc, and so the square's edge, is then the nadir.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from services.sampler.density import LightMap
from services.sampler.square import area_from_direction, direction_from_area, disc_from_square, last_at_most, square_from_disc
from services.sphere import SPAN, ring_edges

TURN = 2 * np.pi


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

    edges: as above. importance: (rows, cols). rings: (rows, cols + 1), integral over azimuth up to each column's left side.
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


def azimuth_tables(light: LightMap) -> AzimuthTables:
    """The tables of a map, with the offset that keeps samples still when light crosses phi = 0.

    Without it every sample after the crossing light would sweep once round the sky. The offset 1/2 - E[phi] / 2 pi is the circular optimal
    transport of the marginal to the even one, in closed form.
    """
    rows, cols = light.importance.shape
    edges, columns, turn = ring_edges(rows, light.coverage), np.empty((rows + 1, cols)), np.empty(cols + 1)
    offset = _fill_azimuth(light.importance, edges, columns, turn)
    return AzimuthTables(edges, light.importance, columns, turn, offset, light.radiance)


@njit(cache=True)
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
    edges, rings, moments = ring_edges(rows, light.coverage), np.empty((rows, cols + 1)), np.empty(rows)
    centres = 2 * np.sin((np.arange(rows) + 0.5) * (SPAN[light.coverage] / rows) / 2) ** 2
    knots = np.concatenate([[0.0], centres, edges[-1:]])
    _fill_radius(light.importance, rings, moments)
    density = np.concatenate([rings[:1, -1], rings[:, -1], rings[-1:, -1]])
    outward = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(knots))])
    return RadiusTables(edges, light.importance, rings, moments, knots, density, outward, light.radiance)


@njit(cache=True)
def _fill_radius(importance, rings, moments):
    rows, cols = importance.shape
    h = TURN / cols
    for i in range(rows):
        total, moment = 0.0, 0.0
        rings[i, 0] = 0.0
        for j in range(cols):
            total += importance[i, j] * h
            moment += importance[i, j] * (j + 0.5)
            rings[i, j + 1] = total
        moments[i] = moment * h * h


def turn_from_azimuth(tables: AzimuthTables, azimuth: float) -> float:
    """Azimuth on the disc, in turns in [0, 1), of the azimuth (rad) on the sky."""
    j, y, _ = _segment(azimuth % TURN, tables.turn.size - 1)
    return float((_turn_at(tables.turn, tables.columns[-1], j, y) / tables.turn[-1] - tables.offset) % 1.0)


def quiet_azimuth(tables: AzimuthTables) -> float:
    """The azimuth (rad) in the middle of the quarter turn with the least light."""
    return _quiet_azimuth(tables.turn)


@njit(cache=True)
def _quiet_azimuth(turn):
    cols = turn.size - 1
    wide, best, least = max(cols // 4, 1), 0, np.inf
    for j in range(cols):
        end = j + wide
        light = turn[end] - turn[j] if end <= cols else turn[cols] - turn[j] + turn[end - cols]
        if light < least:
            best, least = j, light
    return (best + 0.5 * wide + 0.5) % cols * TURN / cols


@njit(cache=True)
def _step_inverse(d0, d1, h, x):
    """How far into a segment of length h, with density linear from d0 to d1, the integral reaches x (stable for d0 = d1 and for 0)."""
    root = d0 + np.sqrt(max(d0 * d0 + (d1 - d0) * x * (2 / h), 0.0))
    return min(max(2 * x / root, 0.0), h) if root > 0 else 0.0


@njit(cache=True)
def _turn_inverse(turn, density, x):
    """(column, way past its centre in rad) where the integral over azimuth reaches x."""
    cols = turn.size - 1
    j = last_at_most(turn, x)
    return j, _step_inverse(density[j], density[j + 1 if j + 1 < cols else 0], TURN / cols, x - turn[j])


@njit(cache=True)
def _turn_at(turn, density, j, y):
    """Integral over azimuth from the centre of column 0 to `y` rad past the centre of column j."""
    cols = turn.size - 1
    d0, d1 = density[j], density[(j + 1) % cols]
    return turn[j] + y * (d0 + 0.5 * y * (d1 - d0) * cols / TURN)


@njit(cache=True)
def _segment(phi, cols):
    """(j, y, t): the column whose centre comes before the azimuth phi, the way past it in rad and as a share."""
    h = TURN / cols
    psi = phi - 0.5 * h
    if psi < 0:
        psi += TURN
    j = min(int(psi / h), cols - 1)
    y = min(max(psi - j * h, 0.0), h)
    return j, y, y / h


@njit(cache=True)
def _mixed_cell(table, j0, j1, t, x):
    """The last row of the mixture (1 - t) table[:, j0] + t table[:, j1] that is <= x, and its value there."""
    low, left = 0, table.shape[0] - 1
    while left > 1:
        half = left >> 1
        low = low + half if (1 - t) * table[low + half, j0] + t * table[low + half, j1] <= x else low
        left -= half
    return low, (1 - t) * table[low, j0] + t * table[low, j1]


@njit(cache=True)
def azimuth_sample(tables, points, directions, radiance, density):
    """Fills directions (n, 3), the map's radiance there (n, 3) and the density per sr (n,) for points (n, 2); all float64."""
    edges, importance, columns, turn = tables.edges, tables.importance, tables.columns, tables.turn
    rows, cols = importance.shape
    total, marginal, h, per_h, per_total = turn[cols], columns[rows], TURN / cols, cols / TURN, 1 / turn[cols]
    for n in range(points.shape[0]):
        # Azimuth of the disc, turned by the offset, through the marginal; then the radius through the mixture of two columns.
        a0, w0 = disc_from_square(points[n, 0], points[n, 1])
        w0 += tables.offset
        j, y = _turn_inverse(turn, marginal, (w0 - np.floor(w0)) * total)
        k, t = j + 1 if j + 1 < cols else 0, y * per_h
        target = a0 * ((1 - t) * marginal[j] + t * marginal[k])
        i, below = _mixed_cell(columns, j, k, t, target)
        f = (1 - t) * importance[i, j] + t * importance[i, k]
        a = min(edges[i] + max(target - below, 0.0) / f, edges[i + 1])
        directions[n, 0], directions[n, 1], directions[n, 2] = direction_from_area(a, y + (j + 0.5) * h)
        density[n] = f * per_total
        for c in range(3):
            radiance[n, c] = (1 - t) * tables.radiance[i, j, c] + t * tables.radiance[i, k, c]


@njit(cache=True)
def azimuth_density(tables, directions, density):
    """Fills the density per sr (n,) of unit directions (n, 3); 0 outside the map."""
    edges, importance = tables.edges, tables.importance
    rows, cols = importance.shape
    for n in range(directions.shape[0]):
        a, phi = area_from_direction(directions[n, 0], directions[n, 1], directions[n, 2])
        j, _, t = _segment(phi, cols)
        i = last_at_most(edges, a)
        inside = a <= edges[rows]
        density[n] = ((1 - t) * importance[i, j] + t * importance[i, (j + 1) % cols]) / tables.turn[cols] if inside else 0.0


@njit(cache=True)
def azimuth_inverse(tables, directions, points):
    """Fills the points (n, 2) that `azimuth_sample` sends to the unit directions (n, 3); directions below the map go to its rim."""
    edges, importance, columns = tables.edges, tables.importance, tables.columns
    rows, cols = importance.shape
    marginal = columns[rows]
    for n in range(directions.shape[0]):
        a, phi = area_from_direction(directions[n, 0], directions[n, 1], directions[n, 2])
        j, y, t = _segment(phi, cols)
        k, a = (j + 1) % cols, min(a, edges[rows])
        i = last_at_most(edges, a)
        before = (1 - t) * columns[i, j] + t * columns[i, k]
        before += (a - edges[i]) * ((1 - t) * importance[i, j] + t * importance[i, k])
        w0 = _turn_at(tables.turn, marginal, j, y) / tables.turn[cols] - tables.offset
        points[n] = square_from_disc(min(before / ((1 - t) * marginal[j] + t * marginal[k]), 1.0), w0 - np.floor(w0))


@njit(cache=True)
def _ring_pair(s, y, knots, rows):
    """(ring below, ring above, share of the upper one) for the way y into the segment s between knots."""
    if s == 0 or s == rows:
        i = 0 if s == 0 else rows - 1
        return i, i, 0.0
    return s - 1, s, y / (knots[s + 1] - knots[s])


@njit(cache=True)
def radius_sample(tables, points, directions, radiance, density):
    """As `azimuth_sample`, radius first."""
    importance, rings, knots, d, outward = tables.importance, tables.rings, tables.knots, tables.density, tables.outward
    rows, cols = importance.shape
    total, h = outward[rows + 1], TURN / cols
    for n in range(points.shape[0]):
        # Radius through the marginal; then the azimuth, turned by the offset of this radius, through the mixture of two rings.
        a0, w0 = disc_from_square(points[n, 0], points[n, 1])
        x = a0 * total
        s = last_at_most(outward, x)
        y = _step_inverse(d[s], d[s + 1], knots[s + 1] - knots[s], x - outward[s])
        i, k, t = _ring_pair(s, y, knots, rows)
        lower, upper = rings[i], rings[k]
        ring = (1 - t) * lower[cols] + t * upper[cols]
        w0 += 0.5 - ((1 - t) * tables.moments[i] + t * tables.moments[k]) / (TURN * ring)
        target, low, left = (w0 - np.floor(w0)) * ring, 0, cols
        while left > 1:
            half = left >> 1
            low = low + half if (1 - t) * lower[low + half] + t * upper[low + half] <= target else low
            left -= half
        f = (1 - t) * importance[i, low] + t * importance[k, low]
        way = max(target - (1 - t) * lower[low] - t * upper[low], 0.0) / (f * h)
        directions[n] = direction_from_area(knots[s] + y, (low + min(way, 1.0)) * h)
        density[n] = f / total
        for c in range(3):
            radiance[n, c] = (1 - t) * tables.radiance[i, low, c] + t * tables.radiance[k, low, c]


@njit(cache=True)
def radius_density(tables, directions, density):
    """As `azimuth_density`, radius first."""
    importance, knots = tables.importance, tables.knots
    rows, cols = importance.shape
    for n in range(directions.shape[0]):
        a, phi = area_from_direction(directions[n, 0], directions[n, 1], directions[n, 2])
        s = last_at_most(knots, a)
        i, k, t = _ring_pair(s, a - knots[s], knots, rows)
        j = min(int(phi * cols / TURN), cols - 1)
        inside = a <= knots[rows + 1]
        density[n] = ((1 - t) * importance[i, j] + t * importance[k, j]) / tables.outward[rows + 1] if inside else 0.0


@njit(cache=True)
def radius_inverse(tables, directions, points):
    """As `azimuth_inverse`, radius first."""
    importance, rings, knots, d, outward = tables.importance, tables.rings, tables.knots, tables.density, tables.outward
    rows, cols = importance.shape
    h = TURN / cols
    for n in range(directions.shape[0]):
        a, phi = area_from_direction(directions[n, 0], directions[n, 1], directions[n, 2])
        a = min(a, knots[rows + 1])
        s = last_at_most(knots, a)
        y, length = a - knots[s], knots[s + 1] - knots[s]
        i, k, t = _ring_pair(s, y, knots, rows)
        a0 = (outward[s] + y * (d[s] + 0.5 * y * (d[s + 1] - d[s]) / length)) / outward[rows + 1]
        j = min(int(phi / h), cols - 1)
        ring = (1 - t) * rings[i, cols] + t * rings[k, cols]
        before = (1 - t) * rings[i, j] + t * rings[k, j] + (phi - j * h) * ((1 - t) * importance[i, j] + t * importance[k, j])
        w0 = before / ring - 0.5 + ((1 - t) * tables.moments[i] + t * tables.moments[k]) / (TURN * ring)
        points[n] = square_from_disc(min(a0, 1.0), w0 - np.floor(w0))
