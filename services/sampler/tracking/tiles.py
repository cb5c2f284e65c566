"""A polar map as a few thousand tiles of little light each: leaves of a binary tree, with their exact power and flux centroid.

One direction that stands for light of flux F spread over a radius r is wrong by about F at a fraction r of all shadow edges: a mean
square of F^2 r. For N lights the sum of that is least when their density follows radiance^0.8, so a tile is halved until it holds
TILE_FRACTION of a light by that density.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.bright_cells import SUBCELLS, BrightCells
from vemlight.light.colour import LUMINANCE_BLUE, LUMINANCE_GREEN, LUMINANCE_RED
from vemlight.light.sphere import SPAN, Coverage, cell_solid_angles, ring_edges

BASE = 8  # cells on a side of the largest tile
BAND = 3  # rows of base tiles that are visited column by column, so that a run of tiles lies together; changes the time alone
TILE_FRACTION = 0.25  # of a light, for one tile: a light has 4 tiles or more, of even sky 8
MAX_LIGHTS = 4.0  # that a base tile counts for: beyond it there are single cells, which are cut into their sub-cells at most
WEIGHT_EXPONENT = 1.6  # Lloyd weights are radiance^1.6: in the plane the density of the sites is then its root, radiance^0.8
STACK = 16  # tiles that wait to be halved: of a base tile of 8 x 8 cells at most 7; any larger value does


class Grid(NamedTuple):
    """Geometry of maps of one shape, float64.

    solid_angles: (rows,), of a cell, sr. above: (rows + 1,), solid angle of a column from the pole down to a row, sr. across, up: (rows,),
    sine and cosine of a row's polar angle. cosines, sines: (cols,), of a column's azimuth. height: of a cell, rad. widths: (rows,), of a
    cell, rad. corners: (bases, 2) int64, first row and column of the base tiles, in the order in which they are visited.
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

    flux: (3, n), RGB irradiance. power: (n,), its luminance. direction: (3, n), flux centroid, not normalised. weight: (n,), for the
    Lloyd update. radius: (n,), half the diagonal, rad. area: (n,), solid angle, sr.
    """

    flux: np.ndarray
    power: np.ndarray
    direction: np.ndarray
    weight: np.ndarray
    radius: np.ndarray
    area: np.ndarray


class Span(NamedTuple):
    """Cells of rows i0 <= i < i1 and columns j0 <= j < j1."""

    i0: int
    i1: int
    j0: int
    j1: int


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
    """The geometry of maps of this shape."""
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


def tiles_from_map(radiance: np.ndarray, coverage: Coverage, count: int, bright_cells: BrightCells) -> Tiles:
    """The tiles of a clean map (rows, cols, 3) float32, small enough for `count` lights. A cell's weights are brought to the sum 1."""
    rows, cols, _ = radiance.shape
    # Copied, since numba compiles a second version of a function for arrays that are read-only, as those off the wire are.
    cells, directions, weights = np.array(bright_cells.cells), np.array(bright_cells.directions), np.array(bright_cells.weights, np.float64)
    table, n = _fill(radiance, grid(rows, cols, coverage), count, cells, directions, weights)
    table = table[:, :n].copy()
    return Tiles(table[0:3], table[3], table[4:7], table[7], table[8], table[9])


@kernel
def _fill(radiance, of, count, cells, directions, weights):
    """(table (10, tiles or more): flux, power, direction, weight, radius, area; how many tiles). weights: brought to the sum 1."""
    rows, cols, _ = radiance.shape
    samples = _cell_samples(BrightCells(cells, directions, weights), rows * cols)
    # Base tiles first, for the sum of the density, power^0.8 area^0.2; those of bright sources count for MAX_LIGHTS.
    luminance, across = np.empty((rows, cols), np.float32), -(-cols // BASE)
    bases, density = _bases(radiance, of, luminance)
    total = counted = 0.0
    for k in range(density.size):
        total += density[k]
    for k in range(density.size):
        counted += min(density[k], MAX_LIGHTS / max(count, MAX_LIGHTS) * total)
    limit = TILE_FRACTION / count * counted

    table, n = np.empty((10, rows * cols + cells.size)), np.int64(0)
    stack, sums = np.empty((STACK, 4), np.int64), np.zeros((BASE + 1, BASE + 1))
    for k in range(density.size):
        base = of.corners[k, 0] // BASE * across + of.corners[k, 1] // BASE
        if density[base] > limit:
            n = _halve(radiance, luminance, of, samples, limit**5, of.corners[k], stack, sums, table, n)
        elif density[base] > 0:
            for c in range(10):
                table[c, n] = bases[c, base]
            n += 1
    return table, n


@subroutine
def _bases(radiance, of, light):
    """(table (10, bases), density (bases,)) of the base tiles, row by row; fills light (rows, cols), the cells' luminance."""
    rows, cols, _ = radiance.shape
    across, count = -(-cols // BASE), -(-rows // BASE) * -(-cols // BASE)
    table, density = np.empty((10, count)), np.empty(count)
    cells, flux, moment = radiance.reshape(rows, 3 * cols), np.empty(3 * cols), np.empty((2, cols))
    red, green, blue = np.float32(LUMINANCE_RED), np.float32(LUMINANCE_GREEN), np.float32(LUMINANCE_BLUE)
    for base in range(count):
        row, col = base // across * BASE, base % across * BASE
        end, right = min(row + BASE, rows), min(col + BASE, cols)
        if col == 0:
            # A row of base tiles at a time, in long loops over neighbours in memory.
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
        area = _tile(of, Span(row, end, col, right), (r, g, b), (x, y, z), table, base)
        density[base] = np.sqrt(table[7, base] * area)
    return table, density


@subroutine
def _add_row(row, weight, sums):
    for k in range(sums.size):
        sums[k] += weight * row[k]


@subroutine
def _tile(of, span, flux, moment, table, n):
    """Fills column n of the table with the tile of these cells, of this flux and moment; returns its solid angle."""
    i0, i1, j0, j1 = span
    power, area = LUMINANCE_RED * flux[0] + LUMINANCE_GREEN * flux[1] + LUMINANCE_BLUE * flux[2], (of.above[i1] - of.above[i0]) * (j1 - j0)
    height, width = (i1 - i0) * of.height, (j1 - j0) * of.widths[(i0 + i1) // 2]
    table[0, n], table[1, n], table[2, n], table[3, n] = flux[0], flux[1], flux[2], power
    table[4, n], table[5, n], table[6, n] = moment[0] / power, moment[1] / power, moment[2] / power
    table[7, n], table[8, n] = area * (power / area) ** WEIGHT_EXPONENT, 0.5 * np.sqrt(height * height + width * width)
    table[9, n] = area
    return area


@subroutine
def _cell_samples(bright, count):
    """The sub-cell samples of a map of `count` cells, with the weights of each cell normalised."""
    first, weights, k = np.empty(count, np.int32), bright.weights, 0
    for cell in range(count):
        first[cell] = -1
    while k < weights.size:
        begin, whole = k, 0.0
        while k < weights.size and bright.cells[k] == bright.cells[begin]:
            whole, k = whole + weights[k], k + 1
        first[bright.cells[begin]] = begin
        for sample in range(begin, k):
            weights[sample] /= whole
    return CellSamples(first, bright.cells, bright.directions, weights)


@subroutine
def _halve(radiance, luminance, of, samples, limit, corner, stack, sums, table, n):
    """Appends the tiles of one base tile to the table and returns its new length. limit: of the density, to the power of 5.

    stack: (STACK, 4), sums: (BASE + 1, BASE + 1), zero in its first row and column: scratch memory. All passed one by one, since a record
    of them makes numba count references to its arrays on each call, which takes a quarter as long again.
    """
    rows, cols = luminance.shape
    row, col = corner
    _push(stack, 0, row, min(row + BASE, rows), col, min(col + BASE, cols))
    # Summed-area table of the power: four entries give any tile's, up to rounding of the whole.
    for i in range(stack[0, 1] - row):
        along = 0.0
        for j in range(stack[0, 3] - col):
            along += luminance[row + i, col + j]
            sums[i + 1, j + 1] = sums[i, j + 1] + of.solid_angles[row + i] * along
    depth = 1
    while depth:
        depth -= 1
        i0, i1, j0, j1 = stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3]
        power = sums[i1 - row, j1 - col] - sums[i1 - row, j0 - col] - sums[i0 - row, j1 - col] + sums[i0 - row, j0 - col]
        # The density, power^0.8 area^0.2, to the power of 5.
        small = power**4 * (of.above[i1] - of.above[i0]) * (j1 - j0) <= limit
        single = (i1 - i0) * (j1 - j0) == 1
        if small or single:
            _measure(radiance, luminance, of, Span(i0, i1, j0, j1), table, n)
            if single and samples.first[i0 * cols + j0] >= 0:
                n = _subdivide(samples, samples.first[i0 * cols + j0], of.solid_angles[i0], small, table, n)
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


@subroutine
def _measure(radiance, luminance, of, span, table, n):
    """Fills column n of the table from these cells."""
    i0, i1, j0, j1 = span
    red = green = blue = x = y = z = 0.0
    for i in range(i0, i1):
        r = g = b = c = s = whole = 0.0
        for j in range(j0, j1):
            r, g, b = r + radiance[i, j, 0], g + radiance[i, j, 1], b + radiance[i, j, 2]
            c, s, whole = c + luminance[i, j] * of.cosines[j], s + luminance[i, j] * of.sines[j], whole + luminance[i, j]
        omega, across, up = of.solid_angles[i], of.solid_angles[i] * of.across[i], of.solid_angles[i] * of.up[i]
        red, green, blue = red + omega * r, green + omega * g, blue + omega * b
        x, y, z = x + across * c, y + across * s, z + up * whole
    _tile(of, span, (red, green, blue), (x, y, z), table, n)


@subroutine(inline="always")
def _push(stack, depth, i0, i1, j0, j1):
    stack[depth, 0], stack[depth, 1], stack[depth, 2], stack[depth, 3] = i0, i1, j0, j1


@subroutine
def _subdivide(samples, k, area, whole, table, n):
    """Cuts the bright cell in the table's column n, whose samples begin at `k`, into one tile a sample; returns the table's new length.

    With `whole` it stays one tile, and its direction becomes the mean of its samples.
    """
    cell, tile, small = samples.cells[k], table[:, n].copy(), area / (SUBCELLS * SUBCELLS)
    table[4, n] = table[5, n] = table[6, n] = 0.0
    while k < samples.cells.size and samples.cells[k] == cell:
        weight = samples.weights[k]
        if whole:
            for c in range(3):
                table[4 + c, n] += weight * samples.directions[k, c]
        else:
            for c in range(4):
                table[c, n] = weight * tile[c]
            for c in range(3):
                table[4 + c, n] = samples.directions[k, c]
            table[7, n], table[8, n] = small * (tile[3] * weight / small) ** WEIGHT_EXPONENT, tile[8] / SUBCELLS
            table[9, n] = small
            n += 1
        k += 1
    return n + 1 if whole else n
