"""A polar map as few tiles of little light each: a tree of halvings whose leaves carry their exact power and flux centroid.

One direction that stands for light of flux F spread over a radius r is wrong, at shadow edges, by about F for a share r of all
edges: a mean square of F^2 r. For N lights the sum of it is least when their density follows radiance^0.8; a tile is halved
until its part of that density is SHARE of a light.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit

from vemlight.light.bright_cells import SUBCELLS, BrightCells
from vemlight.light.colour import LUMINANCE_BLUE, LUMINANCE_GREEN, LUMINANCE_RED
from vemlight.light.sphere import SPAN, Coverage, cell_solid_angles, ring_edges
from vemlight.sampler.density import LARGEST

BASE = 8  # cells on a side of the largest tile
BAND = 3  # rows of base tiles that are visited column by column, so that tiles in a row lie together
SHARE = 0.25  # of a light, for one tile: a light has 4 tiles or more, of even sky 8
MOST = 4.0  # lights that a base tile counts for: beyond it there are single cells, which are cut into their sub-cells at most
SITES = 1.6  # sites weigh radiance^1.6 in Lloyd's step: in the plane their density is then the weight's root
HOLD = 2  # frames; a lost picture is bridged, and darkness is believed 80 ms late at 25 fps
CLEAR = 3.0  # standard deviations of the noise: a change of so many goes through at once
LEAST = np.float32(0.12)  # gain: noise is averaged over 2 / 0.12 - 1 = 16 frames at most


class Grid(NamedTuple):
    """What depends on the map's shape alone, float64.

    solid_angles: (rows,), sr of a cell. above: (rows + 1,), sr of a column down to a row. across, up: (rows,), sine and cosine of a
    ring's polar angle. cosines, sines: (cols,), of a column's azimuth. height: of a cell, rad. widths: (rows,), rad. corners:
    (bases, 2) int64, the first row and column of the base tiles, in the order in which they are visited: along bands, so that tiles
    that follow each other lie together.
    """

    solid_angles: np.ndarray
    above: np.ndarray
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


class CellSamples(NamedTuple):
    """Bright cells, looked up by cell. first: (rows * cols,) int32, where a cell's samples begin, -1 where it has none.

    cells, directions, weights: as in `BrightCells`, weights float64.
    """

    first: np.ndarray
    cells: np.ndarray
    directions: np.ndarray
    weights: np.ndarray


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
    angles = cell_solid_angles(rows, cols, coverage), ring_edges(rows, coverage) * (2 * np.pi / cols)
    return Grid(*angles, np.sin(theta), np.cos(theta), np.cos(phi), np.sin(phi), height, widths, np.array(corners))


def received(radiance: np.ndarray, before: np.ndarray | None, black: np.ndarray, variance: float) -> tuple[np.ndarray, np.ndarray, int]:
    """(clean map (rows, cols, 3) float32, black (rows, cols) uint8, spoilt cells) of a map as it came.

    Spoilt values (nan, infinite, negative, above LARGEST) become 0, or when the map `before` is given, the whole cell becomes
    what it was there. So does a cell that turned black, for HOLD frames: a lost line of the picture comes back, a light that
    went out stays out. A cell whose change lies within noise of that relative variance goes only part of the way.
    """
    clean = np.array(radiance, np.float32, order="C")
    ages = np.zeros(radiance.shape[:2], np.uint8) if black.shape != radiance.shape[:2] else black.copy()
    return clean, ages, _receive(clean, before is not None, clean if before is None else before, variance, ages)


@njit(cache=True, error_model="numpy")
def _receive(clean, filling, before, variance, ages):
    rows, cols, _ = clean.shape
    spoilt, gain = 0, np.empty(cols, np.float32)
    for i in range(rows):
        row, old = clean[i].reshape(3 * cols), before[i].reshape(3 * cols)
        if _sound(row):
            ages[i] = 0
        else:
            spoilt += _mend(row, filling, old, ages[i])
        if filling and variance > 0:
            _smooth(row, old, np.float32(1 / (CLEAR * CLEAR * variance)), gain)
    return spoilt


@njit(cache=True)
def _sound(row):
    """Whether all cells of a row (3 cols,) are lit and none is spoilt."""
    unsound = 0
    for j in range(row.size // 3):
        r, g, b = row[3 * j], row[3 * j + 1], row[3 * j + 2]
        whole = r + g + b
        unsound += not ((r >= 0) & (g >= 0) & (b >= 0) & (whole > 0) & (whole <= LARGEST))  # nan is nowhere
    return unsound == 0


@njit(cache=True)
def _mend(row, filling, old, ages):
    """Cleans or fills the cells of a row (3 cols,) that are spoilt or black; returns how many are spoilt."""
    spoilt = 0
    for j in range(ages.size):
        cell, was = row[3 * j : 3 * j + 3], old[3 * j : 3 * j + 3]
        whole = cell[0] + cell[1] + cell[2]
        good = cell[0] >= 0 and cell[1] >= 0 and cell[2] >= 0 and whole <= LARGEST
        spoilt += not good
        if good and whole > 0:
            ages[j] = 0
        elif filling and (not good or ages[j] < HOLD):
            ages[j] += good
            cell[:] = was
        else:
            for c in range(3):
                cell[c] = cell[c] if 0 <= cell[c] <= LARGEST else 0
    return spoilt


@njit(cache=True, error_model="numpy")
def _smooth(row, old, within, gain):
    """Takes each cell of a row (3 cols,) only part of the way from the `old` row where its change is noise. gain: (cols,), for use.

    within: 1 over the square of a change, relative, that goes through.
    """
    red, green, blue = np.float32(LUMINANCE_RED), np.float32(LUMINANCE_GREEN), np.float32(LUMINANCE_BLUE)
    for j in range(gain.size):
        level = red * old[3 * j] + green * old[3 * j + 1] + blue * old[3 * j + 2]
        change = (red * row[3 * j] + green * row[3 * j + 1] + blue * row[3 * j + 2] - level) / level
        part = change * change * within
        gain[j] = (part * part if part * part > LEAST else LEAST) if part < 1 else np.float32(1)
    for j in range(gain.size):
        for c in range(3):
            row[3 * j + c] = old[3 * j + c] + gain[j] * (row[3 * j + c] - old[3 * j + c])


def tiles_from_map(radiance: np.ndarray, coverage: Coverage, count: int, bright_cells: BrightCells) -> Tiles:
    """The tiles of a clean map (rows, cols, 3) float32, small enough for `count` lights. A cell's weights are brought to the sum 1."""
    rows, cols, _ = radiance.shape
    # Copied, since numba compiles a function anew for arrays that may not be written, as those off the wire.
    bright_cells = BrightCells(*(np.array(array) for array in bright_cells))
    table = _fill(radiance, grid(rows, cols, coverage), bright_cells, count)
    return Tiles(table[0:3], table[3], table[4:7], table[7], table[8])


@njit(cache=True, error_model="numpy")
def _fill(radiance, of, bright, count):
    """The table (9, tiles): flux, power, direction, weight, radius."""
    rows, cols, _ = radiance.shape
    samples = _cell_samples(bright, rows * cols)
    # Base tiles first, for the sum of the density, power^0.8 area^0.2; those of strong sources count for MOST lights.
    light, across = np.empty((rows, cols), np.float32), -(-cols // BASE)
    bases, density = _bases(radiance, of, light)
    total = density.sum()
    total = np.minimum(density, MOST / max(count, MOST) * total).sum()
    limit = SHARE / count * total

    table, n = np.empty((9, rows * cols + bright.cells.size)), 0
    stack, sums = np.empty((16, 4), np.int64), np.zeros((BASE + 1, BASE + 1))
    for k in range(density.size):
        base = of.corners[k, 0] // BASE * across + of.corners[k, 1] // BASE
        if density[base] > limit:
            n = _halve(radiance, light, of, samples, limit**5, stack, sums, of.corners[k], table, n)
        elif density[base] > 0:
            for c in range(9):
                table[c, n] = bases[c, base]
            n += 1
    return table[:, :n].copy()


@njit(cache=True, error_model="numpy")
def _bases(radiance, of, light):
    """(table (9, bases), density (bases,)) of the base tiles, row by row; fills each cell's luminance, light (rows, cols)."""
    rows, cols, _ = radiance.shape
    across, count = -(-cols // BASE), -(-rows // BASE) * -(-cols // BASE)
    table, density = np.empty((9, count)), np.empty(count)
    cells, flux, moment = radiance.reshape(rows, 3 * cols), np.empty(3 * cols), np.empty((2, cols))
    red, green, blue = np.float32(LUMINANCE_RED), np.float32(LUMINANCE_GREEN), np.float32(LUMINANCE_BLUE)
    for base in range(count):
        row, col = base // across * BASE, base % across * BASE
        end, right = min(row + BASE, rows), min(col + BASE, cols)
        if col == 0:
            # Down all columns at once: long loops over what lies side by side.
            flux[:], moment[:] = 0.0, 0.0
            for i in range(row, end):
                _add_row(cells[i], of.solid_angles[i], flux)
                for j in range(cols):
                    light[i, j] = red * cells[i, 3 * j] + green * cells[i, 3 * j + 1] + blue * cells[i, 3 * j + 2]
                _add_row(light[i], of.solid_angles[i] * of.across[i], moment[0])
                _add_row(light[i], of.solid_angles[i] * of.up[i], moment[1])
        r = g = b = x = y = z = 0.0
        for j in range(col, right):
            r, g, b = r + flux[3 * j], g + flux[3 * j + 1], b + flux[3 * j + 2]
            x, y, z = x + of.cosines[j] * moment[0, j], y + of.sines[j] * moment[0, j], z + moment[1, j]
        area = _tile(of, row, end, col, right, (r, g, b), (x, y, z), table, base)
        density[base] = np.sqrt(table[7, base] * area)
    return table, density


@njit(cache=True)
def _add_row(row, weight, sums):
    for k in range(sums.size):
        sums[k] += weight * row[k]


@njit(cache=True, error_model="numpy")
def _tile(of, i0, i1, j0, j1, flux, moment, table, n):
    """Fills a column of the table with the tile of these rows and columns, that has such flux and moment; returns its solid angle."""
    power, area = LUMINANCE_RED * flux[0] + LUMINANCE_GREEN * flux[1] + LUMINANCE_BLUE * flux[2], (of.above[i1] - of.above[i0]) * (j1 - j0)
    height, width = (i1 - i0) * of.height, (j1 - j0) * of.widths[(i0 + i1) // 2]
    table[0, n], table[1, n], table[2, n], table[3, n] = flux[0], flux[1], flux[2], power
    table[4, n], table[5, n], table[6, n] = moment[0] / power, moment[1] / power, moment[2] / power
    table[7, n], table[8, n] = area * (power / area) ** SITES, 0.5 * np.sqrt(height * height + width * width)
    return area


@njit(cache=True)
def _cell_samples(bright, count):
    """The sub-cell samples of a map of `count` cells, with the weights of each cell normalised."""
    first, weights, k = np.full(count, -1, np.int32), bright.weights.astype(np.float64), 0
    while k < weights.size:
        begin, whole = k, 0.0
        while k < weights.size and bright.cells[k] == bright.cells[begin]:
            whole, k = whole + weights[k], k + 1
        first[bright.cells[begin]] = begin
        weights[begin:k] /= whole
    return CellSamples(first, bright.cells, bright.directions, weights)


@njit(cache=True, error_model="numpy")
def _halve(radiance, light, of, samples, limit, stack, sums, corner, table, n):
    """Appends the tiles of one base tile to the table and returns its new length. limit: of the density, to the power of 5.

    stack (16, 4), sums (BASE + 1, BASE + 1) with zeros before the first row and column.
    """
    rows, cols, _ = radiance.shape
    row, col = corner
    _push(stack, 0, row, min(row + BASE, rows), col, min(col + BASE, cols))
    # Power above and left of each of the base tile's cells: four of them tell any tile's, but for the last digits of the whole.
    for i in range(stack[0, 1] - row):
        along = 0.0
        for j in range(stack[0, 3] - col):
            along += light[row + i, col + j]
            sums[i + 1, j + 1] = sums[i, j + 1] + of.solid_angles[row + i] * along
    depth = 1
    while depth:
        depth -= 1
        i0, i1, j0, j1 = stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3]
        power = sums[i1 - row, j1 - col] - sums[i1 - row, j0 - col] - sums[i0 - row, j1 - col] + sums[i0 - row, j0 - col]
        # The density, power^0.8 area^0.2, to the power of 5.
        fine = power**4 * (of.above[i1] - of.above[i0]) * (j1 - j0) <= limit
        single = (i1 - i0) * (j1 - j0) == 1
        if fine or single:
            _measure(radiance, light, of, i0, i1, j0, j1, table, n)
            if single and samples.first[i0 * cols + j0] >= 0:
                n = _subdivide(samples, samples.first[i0 * cols + j0], of.solid_angles[i0], fine, table, n)
            else:
                n += table[3, n] > 0
        elif i1 - i0 > 1 and ((i1 - i0) * of.height >= (j1 - j0) * of.widths[(i0 + i1) // 2] or j1 - j0 == 1):
            middle = (i0 + i1) // 2
            _push(stack, depth, middle, i1, j0, j1)
            _push(stack, depth + 1, i0, middle, j0, j1)
            depth += 2
        else:
            middle = (j0 + j1) // 2
            _push(stack, depth, i0, i1, middle, j1)
            _push(stack, depth + 1, i0, i1, j0, middle)
            depth += 2
    return n


@njit(cache=True, error_model="numpy")
def _measure(radiance, light, of, i0, i1, j0, j1, table, n):
    """Fills a column of the table with what lies between these rows and columns."""
    red = green = blue = x = y = z = 0.0
    for i in range(i0, i1):
        r = g = b = c = s = whole = 0.0
        for j in range(j0, j1):
            r, g, b = r + radiance[i, j, 0], g + radiance[i, j, 1], b + radiance[i, j, 2]
            c, s, whole = c + light[i, j] * of.cosines[j], s + light[i, j] * of.sines[j], whole + light[i, j]
        omega, across, up = of.solid_angles[i], of.solid_angles[i] * of.across[i], of.solid_angles[i] * of.up[i]
        red, green, blue = red + omega * r, green + omega * g, blue + omega * b
        x, y, z = x + across * c, y + across * s, z + up * whole
    _tile(of, i0, i1, j0, j1, (red, green, blue), (x, y, z), table, n)


@njit(cache=True, inline="always")
def _push(stack, depth, i0, i1, j0, j1):
    stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3] = i0, i1, j0, j1


@njit(cache=True, error_model="numpy")
def _subdivide(samples, k, area, whole, table, n):
    """Cuts the bright cell in the table's column n, whose samples begin at `k`, into one tile a sample; returns the table's new length.

    With `whole` it stays one tile, and its direction becomes the mean of its samples.
    """
    cell, tile, small = samples.cells[k], table[:, n].copy(), area / (SUBCELLS * SUBCELLS)
    table[4:7, n] = 0.0
    while k < samples.cells.size and samples.cells[k] == cell:
        weight = samples.weights[k]
        if whole:
            for c in range(3):
                table[4 + c, n] += weight * samples.directions[k, c]
        else:
            table[:4, n] = weight * tile[:4]
            table[4:7, n] = samples.directions[k]
            table[7, n], table[8, n] = small * (tile[3] * weight / small) ** SITES, tile[8] / SUBCELLS
            n += 1
        k += 1
    return n + 1 if whole else n
