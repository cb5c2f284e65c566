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
from services.sphere import LUMINANCE, SPAN, Coverage, cell_directions, cell_solid_angles
from services.strong import PARTS

BASE = 8  # cells on a side of the largest tile
GROUP = 4  # base tiles on a side of a group, whose sites are searched first
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
    column's azimuth. height: of a cell, rad. widths: (rows,), rad. centres: (bases, 3), reach: (bases,): the middle of a base tile and
    the chord from there to its farthest cell. group: (bases,) int64, group_centres, group_reach: of groups
    of base tiles.
    """

    solid_angles: np.ndarray
    across: np.ndarray
    up: np.ndarray
    cosines: np.ndarray
    sines: np.ndarray
    height: float
    widths: np.ndarray
    centres: np.ndarray
    reach: np.ndarray
    group: np.ndarray
    group_centres: np.ndarray
    group_reach: np.ndarray


class Tiles(NamedTuple):
    """The n lit tiles, base tile by base tile, float64.

    flux: (n, 3), RGB. power: (n,), its luminance. direction: (n, 3), flux centroid, not normalised. weight: (n,), for Lloyd's step.
    radius: (n,), rad. start: (bases + 1,) int64, the first tile of each base tile.
    """

    flux: np.ndarray
    power: np.ndarray
    direction: np.ndarray
    weight: np.ndarray
    radius: np.ndarray
    start: np.ndarray


@lru_cache(maxsize=4)
def grid(rows: int, cols: int, coverage: Coverage) -> Grid:
    """The grid of maps with this shape."""
    directions = cell_directions(rows, cols, coverage)
    height = SPAN[coverage] / rows
    theta, phi = (np.arange(rows) + 0.5) * height, (np.arange(cols) + 0.5) * (2 * np.pi / cols)
    widths = np.sin(theta) * (2 * np.pi / cols)
    turn = np.cos(phi), np.sin(phi)
    # A flux centroid inside a cell lies up to half a diagonal beyond the cell's centre.
    beyond = 0.5 * np.hypot(height, widths.max())
    bases, groups = _blocks(directions, BASE, beyond), _blocks(directions, GROUP * BASE, beyond)
    down, across = np.arange(-(-rows // BASE)) // GROUP, np.arange(-(-cols // BASE)) // GROUP
    group = (down[:, None] * (across[-1] + 1) + across).ravel()
    return Grid(cell_solid_angles(rows, cols, coverage), np.sin(theta), np.cos(theta), *turn, height, widths, *bases, group, *groups)


def _blocks(directions: np.ndarray, side: int, beyond: float) -> tuple[np.ndarray, np.ndarray]:
    """Middles (n, 3) of all blocks of so many cells on a side, and the chords from there to their farthest cells, and so far `beyond`."""
    rows, cols, _ = directions.shape
    blocks = [directions[i : i + side, j : j + side].reshape(-1, 3) for i in range(0, rows, side) for j in range(0, cols, side)]
    centres = np.array([block.mean(axis=0) for block in blocks])
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    reach = np.array([np.linalg.norm(block - centre, axis=1).max() for block, centre in zip(blocks, centres, strict=True)])
    return centres, reach + beyond


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
    of = grid(rows, cols, coverage)
    inside, strong = np.full(rows * cols, -1, np.int32), strong.copy()
    if len(strong):
        cells, first = np.unique(strong[:, 0].astype(np.int64), return_index=True)
        inside[cells] = first
        strong[:, 4] /= np.repeat(np.add.reduceat(strong[:, 4], first), np.diff(first, append=len(strong)))
    whole, start = np.empty((rows * cols + len(strong), 9)), np.empty(len(of.centres) + 1, np.int64)
    table = whole[: _fill(radiance, of, strong, inside, count, whole, start)]
    return Tiles(table[:, 0:3], table[:, 3], table[:, 4:7], table[:, 7], table[:, 8], start)


@njit(cache=True)
def _fill(radiance, of, strong, inside, count, table, start):
    rows, cols, _ = radiance.shape
    # Base tiles first, for the sum of the density; those of strong sources count for MOST lights.
    base, density = 0, np.empty(of.centres.shape[0])
    for row in range(0, rows, BASE):
        for col in range(0, cols, BASE):
            power = area = 0.0
            for i in range(row, min(row + BASE, rows)):
                light = 0.0
                for j in range(col, min(col + BASE, cols)):
                    light += _RED * radiance[i, j, 0] + _GREEN * radiance[i, j, 1] + _BLUE * radiance[i, j, 2]
                power += of.solid_angles[i] * light
                area += of.solid_angles[i] * (min(col + BASE, cols) - col)
            density[base] = power ** (0.5 * SITES) * area ** (1 - 0.5 * SITES)
            base += 1
    total = density.sum()
    total = np.minimum(density, MOST / max(count, MOST) * total).sum()
    limit = SHARE / count * total

    n, base = 0, 0
    stack, sums = np.empty((16, 4), np.int64), np.zeros((BASE, BASE + 1))
    for row in range(0, rows, BASE):
        for col in range(0, cols, BASE):
            start[base] = n
            if density[base] > limit:
                n = _halve(radiance, of, strong, inside, limit**5, stack, sums, row, col, table, n)
            elif density[base] > 0:
                _measure(radiance, of, strong, inside, row, min(row + BASE, rows), col, min(col + BASE, cols), table[n])
                n += 1
            base += 1
    start[base] = n
    return n


@njit(cache=True)
def _halve(radiance, of, strong, inside, limit, stack, sums, row, col, table, n):
    """Appends the tiles of one base tile to the table and returns its new length. limit: of the density, to the power of 5."""
    rows, cols, _ = radiance.shape
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
        if fine or (i1 - i0) * (j1 - j0) == 1:
            _measure(radiance, of, strong, inside, i0, i1, j0, j1, table[n])
            k = inside[i0 * cols + j0]
            n = n + 1 if fine or k < 0 else _in_parts(strong, k, of.solid_angles[i0], table, n)
        elif i1 - i0 > 1 and ((i1 - i0) * of.height >= (j1 - j0) * of.widths[(i0 + i1) // 2] or j1 - j0 == 1):
            middle = (i0 + i1) // 2
            stack[depth], stack[depth + 1] = (middle, i1, j0, j1), (i0, middle, j0, j1)
            depth += 2
        else:
            middle = (j0 + j1) // 2
            stack[depth], stack[depth + 1] = (i0, i1, middle, j1), (i0, i1, j0, middle)
            depth += 2
    return n


@njit(cache=True, inline="always")
def _measure(radiance, of, strong, inside, i0, i1, j0, j1, tile):
    """Fills a row of the table: flux, power, direction, weight, radius."""
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
    k = inside[i0 * radiance.shape[1] + j0]
    if k >= 0 and (i1 - i0) * (j1 - j0) == 1:
        cell = strong[k, 0]
        x = y = z = 0.0
        while k < strong.shape[0] and strong[k, 0] == cell:
            part = power * strong[k, 4]
            x, y, z = x + part * strong[k, 1], y + part * strong[k, 2], z + part * strong[k, 3]
            k += 1
    height, width = (i1 - i0) * of.height, (j1 - j0) * of.widths[(i0 + i1) // 2]
    tile[0], tile[1], tile[2], tile[3] = red, green, blue, power
    tile[4], tile[5], tile[6] = x / power, y / power, z / power
    tile[7], tile[8] = area * (power / area) ** SITES, 0.5 * np.sqrt(height * height + width * width)


@njit(cache=True)
def _in_parts(strong, k, area, table, n):
    """Replaces the last tile of the table, the cell whose parts begin at `k`, by its parts; returns the table's new length."""
    cell, whole, small = strong[k, 0], table[n].copy(), area / (PARTS * PARTS)
    while k < strong.shape[0] and strong[k, 0] == cell:
        share = strong[k, 4]
        table[n, :4] = share * whole[:4]
        table[n, 4:7] = strong[k, 1:4]
        table[n, 7], table[n, 8] = small * (whole[3] * share / small) ** SITES, whole[8] / PARTS
        n, k = n + 1, k + 1
    return n
