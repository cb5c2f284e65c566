"""A polar map as few tiles of little light each: a tree of halvings whose leaves carry their exact power and flux centroid.

One direction that stands for light of flux F spread over a radius r is wrong, at shadow edges, by about F for a share r of all
edges: a mean square of F^2 r. For N lights the sum of it is least when their density follows radiance^0.8; a tile is halved
until its part of that density is SHARE of a light.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from services.sampler.density import LARGEST
from services.sphere import LUMINANCE, SPAN, Coverage, cell_solid_angles
from services.strong import PARTS

BASE = 8  # cells on a side of the largest tile
BAND = 3  # rows of base tiles that are visited column by column, so that tiles in a row lie together
SHARE = 0.25  # of a light, for one tile: a light has 4 tiles or more, of even sky 8
MOST = 4.0  # lights that a base tile counts for: beyond it there are single cells, which are cut into their parts at most
SITES = 1.6  # sites weigh radiance^1.6 in Lloyd's step: in the plane their density is then the weight's root
HOLD = 2  # frames; a lost picture is bridged, and darkness is believed 80 ms late at 25 fps
CLEAR = 3.0  # standard deviations of the noise: a change of so many goes through at once
LEAST = 0.12  # gain: noise is averaged over 2 / 0.12 - 1 = 16 frames at most
_RED, _GREEN, _BLUE = (float(weight) for weight in LUMINANCE)


class Grid(NamedTuple):
    """What depends on the map's shape alone, float64.

    solid_angles: (rows,), sr of a cell. across, up: (rows,), sine and cosine of a ring's polar angle. cosines, sines: (cols,), of a
    column's azimuth. height: of a cell, rad. widths: (rows,), rad. corners: (bases, 2) int64, the first row and column of the base
    tiles, in the order in which they are visited: along bands, so that tiles that follow each other lie together.
    """

    solid_angles: np.ndarray
    across: np.ndarray
    up: np.ndarray
    cosines: np.ndarray
    sines: np.ndarray
    height: float
    widths: np.ndarray
    corners: np.ndarray


class Tiles(NamedTuple):
    """The n lit tiles, base tile by base tile, float64.

    flux: (3, n), RGB. power: (n,), its luminance. direction: (3, n), flux centroid, not normalised. weight: (n,), for Lloyd's step.
    radius: (n,), rad.
    """

    flux: np.ndarray
    power: np.ndarray
    direction: np.ndarray
    weight: np.ndarray
    radius: np.ndarray


@lru_cache(maxsize=4)
def grid(rows: int, cols: int, coverage: Coverage) -> Grid:
    """The grid of maps with this shape."""
    height = SPAN[coverage] / rows
    theta, phi = (np.arange(rows) + 0.5) * height, (np.arange(cols) + 0.5) * (2 * np.pi / cols)
    widths = np.sin(theta) * (2 * np.pi / cols)
    corners = [
        (row, col)
        for band in range(0, rows, BAND * BASE)
        for k, col in enumerate(range(0, cols, BASE))
        for row in range(band, min(band + BAND * BASE, rows), BASE)[:: -1 if k % 2 else 1]
    ]
    solid_angles = cell_solid_angles(rows, cols, coverage)
    return Grid(solid_angles, np.sin(theta), np.cos(theta), np.cos(phi), np.sin(phi), height, widths, np.array(corners))


def received(
    radiance: np.ndarray, solid_angles: np.ndarray, before: np.ndarray | None, black: np.ndarray, variance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """(clean map (rows, cols, 3) float32, black (rows, cols) uint8, irradiance (3,), spoilt cells) of a map as it came.

    Spoilt values (nan, infinite, negative, above LARGEST) become 0, or when the map `before` is given, the whole cell becomes
    what it was there. So does a cell that turned black, for HOLD frames: a lost line of the picture comes back, a light that
    went out stays out. A cell whose change lies within noise of that relative variance goes only part of the way.
    """
    clean, irradiance = np.empty(radiance.shape, np.float32), np.empty(3)
    ages = np.zeros(radiance.shape[:2], np.uint8) if black.shape != radiance.shape[:2] else black.copy()
    old = clean if before is None else before
    spoilt = _receive(np.ascontiguousarray(radiance, np.float32), solid_angles, before is not None, old, variance, ages, clean, irradiance)
    return clean, ages, irradiance, spoilt


@njit(cache=True)
def _receive(radiance, solid_angles, filling, before, variance, ages, clean, irradiance):
    rows, cols, _ = radiance.shape
    irradiance[:] = 0.0
    spoilt = 0
    within = 1 / (CLEAR * CLEAR * variance) if variance > 0 else np.inf
    for i in range(rows):
        red = green = blue = 0.0
        for j in range(cols):
            r, g, b = radiance[i, j, 0], radiance[i, j, 1], radiance[i, j, 2]
            whole = r + g + b
            good = r >= 0 and g >= 0 and b >= 0 and whole <= LARGEST  # false for nan
            if not good or whole == 0:
                spoilt += not good
                if filling and (not good or ages[i, j] < HOLD):
                    if good:
                        ages[i, j] += 1
                    r, g, b = before[i, j, 0], before[i, j, 1], before[i, j, 2]
                else:
                    r = r if 0 <= r <= LARGEST else np.float32(0)
                    g = g if 0 <= g <= LARGEST else np.float32(0)
                    b = b if 0 <= b <= LARGEST else np.float32(0)
            else:
                ages[i, j] = 0
                if filling and variance > 0:
                    r0, g0, b0 = before[i, j, 0], before[i, j, 1], before[i, j, 2]
                    old = _RED * r0 + _GREEN * g0 + _BLUE * b0
                    change = _RED * r + _GREEN * g + _BLUE * b - old
                    square = change * change * within
                    if square < old * old:
                        gain = max((square / (old * old)) ** 2, LEAST)
                        r, g, b = r0 + gain * (r - r0), g0 + gain * (g - g0), b0 + gain * (b - b0)
            clean[i, j, 0], clean[i, j, 1], clean[i, j, 2] = r, g, b
            red, green, blue = red + r, green + g, blue + b
        irradiance[0] += red * solid_angles[i]
        irradiance[1] += green * solid_angles[i]
        irradiance[2] += blue * solid_angles[i]
    return spoilt


def tiles_from_map(radiance: np.ndarray, coverage: Coverage, count: int, strong: np.ndarray) -> Tiles:
    """The tiles of a clean map (rows, cols, 3) float32, fine enough for `count` lights.

    strong: (k, 5), of the parts of strong cells: row * cols + column, ascending, unit vector to the part's flux centroid, share of the
    cell's light (a cell's shares are brought to 1).
    """
    rows, cols, _ = radiance.shape
    table = _fill(radiance, grid(rows, cols, coverage), strong, count)
    return Tiles(table[0:3], table[3], table[4:7], table[7], table[8])


@njit(cache=True)
def _fill(radiance, of, strong, count):
    """The table (9, tiles): flux, power, direction, weight, radius."""
    rows, cols, _ = radiance.shape
    inside, shares = _parts(strong, rows * cols)
    # Base tiles first, for the sum of the density, power^0.8 area^0.2; those of strong sources count for MOST lights.
    bases, density = np.empty((9, of.corners.shape[0])), np.zeros(of.corners.shape[0])
    for base in range(density.size):
        row, col = of.corners[base]
        area = _measure(radiance, of, row, min(row + BASE, rows), col, min(col + BASE, cols), bases, base)
        if bases[3, base] > 0:
            density[base] = np.sqrt(bases[7, base] * area)
    total = density.sum()
    total = np.minimum(density, MOST / max(count, MOST) * total).sum()
    limit = SHARE / count * total

    table, n = np.empty((9, rows * cols + strong.shape[0])), 0
    stack, sums = np.empty((16, 4), np.int64), np.zeros((BASE, BASE + 1))
    for base in range(density.size):
        if density[base] > limit:
            n = _halve(radiance, of, strong, shares, inside, limit**5, stack, sums, of.corners[base], table, n)
        elif density[base] > 0:
            table[:, n] = bases[:, base]
            n += 1
    return table[:, :n].copy()


@njit(cache=True)
def _parts(strong, cells):
    """(inside, shares): for each of so many cells where its parts begin in `strong`, or -1; the parts' shares, brought to 1 in a cell."""
    inside, shares, k = np.full(cells, -1, np.int32), strong[:, 4].copy(), 0
    while k < shares.size:
        begin, whole = k, 0.0
        while k < shares.size and strong[k, 0] == strong[begin, 0]:
            whole, k = whole + shares[k], k + 1
        inside[int(strong[begin, 0])] = begin
        shares[begin:k] /= whole
    return inside, shares


@njit(cache=True)
def _halve(radiance, of, strong, shares, inside, limit, stack, sums, corner, table, n):
    """Appends the tiles of one base tile to the table and returns its new length. limit: of the density, to the power of 5."""
    rows, cols, _ = radiance.shape
    row, col = corner
    stack[0] = row, min(row + BASE, rows), col, min(col + BASE, cols)
    for i in range(row, stack[0, 1]):
        light = 0.0  # summed along the row: what is 0 stays 0 in the differences
        for j in range(col, stack[0, 3]):
            light += _RED * radiance[i, j, 0] + _GREEN * radiance[i, j, 1] + _BLUE * radiance[i, j, 2]
            sums[i - row, j - col + 1] = light
    depth = 1
    while depth:
        depth -= 1
        i0, i1, j0, j1 = stack[depth]
        power = area = 0.0
        for i in range(i0, i1):
            power += of.solid_angles[i] * (sums[i - row, j1 - col] - sums[i - row, j0 - col])
            area += of.solid_angles[i] * (j1 - j0)
        if power == 0.0:
            continue
        fine = power**4 * area <= limit  # the density, power^0.8 area^0.2, to the power of 5
        if (i1 - i0) * (j1 - j0) == 1 and inside[i0 * cols + j0] >= 0:
            _measure(radiance, of, i0, i1, j0, j1, table, n)
            n = _in_parts(strong, shares, inside[i0 * cols + j0], of.solid_angles[i0], fine, table, n)
        elif fine or (i1 - i0) * (j1 - j0) == 1:
            _measure(radiance, of, i0, i1, j0, j1, table, n)
            n += 1
        elif i1 - i0 > 1 and ((i1 - i0) * of.height >= (j1 - j0) * of.widths[(i0 + i1) // 2] or j1 - j0 == 1):
            middle = (i0 + i1) // 2
            stack[depth], stack[depth + 1] = (middle, i1, j0, j1), (i0, middle, j0, j1)
            depth += 2
        else:
            middle = (j0 + j1) // 2
            stack[depth], stack[depth + 1] = (i0, i1, middle, j1), (i0, i1, j0, middle)
            depth += 2
    return n


@njit(cache=True)
def _measure(radiance, of, i0, i1, j0, j1, table, n):
    """Fills a column of the table with what lies between these rows and columns, and returns its solid angle."""
    red = green = blue = x = y = z = area = 0.0
    for i in range(i0, i1):
        r = g = b = c = s = 0.0
        for j in range(j0, j1):
            light = _RED * radiance[i, j, 0] + _GREEN * radiance[i, j, 1] + _BLUE * radiance[i, j, 2]
            r += radiance[i, j, 0]
            g += radiance[i, j, 1]
            b += radiance[i, j, 2]
            c += light * of.cosines[j]
            s += light * of.sines[j]
        omega = of.solid_angles[i]
        area += omega * (j1 - j0)
        red, green, blue = red + omega * r, green + omega * g, blue + omega * b
        x, y = x + omega * of.across[i] * c, y + omega * of.across[i] * s
        z += omega * of.up[i] * (_RED * r + _GREEN * g + _BLUE * b)
    power = _RED * red + _GREEN * green + _BLUE * blue
    if power > 0:
        x, y, z = x / power, y / power, z / power
    height, width = (i1 - i0) * of.height, (j1 - j0) * of.widths[(i0 + i1) // 2]
    table[0, n], table[1, n], table[2, n], table[3, n] = red, green, blue, power
    table[4, n], table[5, n], table[6, n] = x, y, z
    table[7, n], table[8, n] = area * (power / area) ** SITES, 0.5 * np.sqrt(height * height + width * width)
    return area


@njit(cache=True)
def _in_parts(strong, shares, k, area, whole, table, n):
    """Cuts the strong cell at the table's column n, whose parts begin at `k`, into them; returns the table's new length.

    With `whole` it stays one tile, and its direction becomes that of its parts.
    """
    cell, tile, small = strong[k, 0], table[:, n].copy(), area / (PARTS * PARTS)
    table[4:7, n] = 0.0
    while k < shares.size and strong[k, 0] == cell:
        if whole:
            for c in range(3):
                table[4 + c, n] += shares[k] * strong[k, 1 + c]
        else:
            table[:4, n] = shares[k] * tile[:4]
            table[4:7, n] = strong[k, 1:4]
            table[7, n], table[8, n] = small * (tile[3] * shares[k] / small) ** SITES, tile[8] / PARTS
            n += 1
        k += 1
    return n + 1 if whole else n
