"""Compact sources of one map: what stands out of its surroundings, with direction, flux, extent, and how well each is known.

A cell is hot where its luminance is above HOT_RATIO times the median around it. Hot cells around a
peak, linked in steps of LINK_RAD, are a source; its core are those above CORE of the peak: a lamp without its glow on the wall beside it.
Its light is what its core and the cells within GROW_RAD of that, the rim, hold above the median of the rim; its direction is that of the
cells above BRIGHT of the peak, since glow on a wall lies to one side of its lamp.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vemlight.fuse.union_find import root_of
from vemlight.kernels import kernel, read_only, subroutine
from vemlight.light.colour import LUMINANCE_BLUE, LUMINANCE_GREEN, LUMINANCE_RED
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.sphere import SPAN, Coverage, cell_directions, cell_solid_angles

HOT_RATIO = 3.0  # over the local median: textures of walls reach 2; 2.5 to 4 would do
HOT_FLOOR = 1e-3  # of the map's integral, in radiance: in the dark everything stands out
BLOCK = 4  # cells on a side of a block, on whose means medians are taken
WINDOW_ROWS, WINDOW_COLS, WINDOW_RAD = 1, 3, math.radians(15.0)  # blocks up and down; places and angle to either side: 13 x 30 degrees
PROMINENCE = 3.0  # of the peak over the rim: light on a wall beside a lamp fades out and has 1.5 to 3, a window 6, a lamp 20 and more
SURE = 1.5  # times the limits of strength and prominence: cameras a metre apart see a lamp's flux alike to a third
CORE = 0.03  # of a source's brightest cell: above the glow on walls near a lamp, below the cells at a lamp's edge; 0.02 to 0.1 would do
# Of a source's brightest cell, above which cells have a say in its direction. Degrees rms in large rooms, lamps 10 to 20 cm from a wall and
# lamps in the open: .19, .076 by all cells; .16, .073 by the core; .085, .063 above .1; .065, .066 above .2; .068, .073 above .3. A lamp
# that is carried before cameras of 200 pixels, .15 has bearings a sixth worse than .1.
BRIGHT = 0.1
MERGE = 0.5  # of the lower of two peaks: the saddle below which they are two lamps; noise makes 0.9, two lamps two cells apart 0.1
LINK_RAD = math.radians(1.6)  # at cells of a degree: the next but one is another source
GROW_RAD = math.radians(1.5)  # what blur of a lens and a cell leave around a lamp
MIN_SHARE = 2e-3  # of the map's luminous flux
MAX_RADIUS_RAD = math.radians(12.0)  # a wider light is a wall or a window, which one direction does not stand for
MAX_SOURCES = 48  # of a map, the strongest; MIN_SHARE lets 500 pass
NOISE = 0.02  # of a cell's light, relative
LENS_RAD = math.radians(0.02)  # by which a calibrated lens is wrong
OF_RADIUS = 0.03  # of a source's radius: by which its centroid is not its middle, since lamps are not even
SUBCELL = 1 / 3  # of a cell's side: a part of a bright cell


class CompactSources(NamedTuple):
    """Sources of a map, the strongest first, in the map's axes.

    directions: (n, 3) float64 unit vectors, centroids of their bright cells' flux. flux: (n, 3) RGB irradiance on a plane that faces them.
    noise, fixed: (n,) rad^2, variance of a direction along an axis across it: what is new in each frame, and what stays. spread: (n,)
    rad^2, second moment of the source about its direction, both axes together. peak: (n,), luminance of its brightest cell. background:
    (n, 3), radiance behind it. owner: (rows * cols,) int16, the source that a cell belongs to, -1: none. sure: (n,) bool, whether it is so
    far above what is left out that another camera, which sees it too, cannot have left it out. beyond: how many more there are than
    MAX_SOURCES.
    """

    directions: np.ndarray
    flux: np.ndarray
    noise: np.ndarray
    fixed: np.ndarray
    spread: np.ndarray
    peak: np.ndarray
    background: np.ndarray
    owner: np.ndarray
    sure: np.ndarray
    beyond: int


class _Geometry(NamedTuple):
    """Of a map's cells: directions (rows * cols, 3), solid angles (rows,), and for each row and each row up to `reach` below or above it
    how many columns to either side lie within LINK_RAD and GROW_RAD, (rows, 2 reach + 1), -1: none.
    """

    directions: np.ndarray
    solid_angles: np.ndarray
    theta: np.ndarray
    linked: np.ndarray
    grown: np.ndarray
    pitch: float


@lru_cache(maxsize=8)
def _geometry(rows: int, cols: int, coverage: Coverage) -> _Geometry:
    pitch = SPAN[coverage] / rows
    theta = (np.arange(rows) + 0.5) * pitch
    wide = max(1.0, pitch / math.radians(1.0))  # on coarser maps neighbours must still be linked
    directions = cell_directions(rows, cols, coverage).reshape(-1, 3)
    linked, grown = (_columns_within(theta, cols, angle * wide) for angle in (LINK_RAD, GROW_RAD))
    return _Geometry(directions, cell_solid_angles(rows, cols, coverage), theta, linked, grown, pitch)


def _columns_within(theta: np.ndarray, cols: int, angle: float) -> np.ndarray:
    """How many columns to either side, in each row near each row, lie within an angle, by the law of cosines on the sphere."""
    reach = int(angle / (theta[1] - theta[0] if len(theta) > 1 else math.pi)) + 1
    table = np.full((len(theta), 2 * reach + 1), -1)
    for k in range(-reach, reach + 1):
        other = np.arange(len(theta)) + k
        inside = (other >= 0) & (other < len(theta))
        a, b = theta[inside], theta[other[inside]]
        cosine = (math.cos(angle) - np.cos(a) * np.cos(b)) / (np.sin(a) * np.sin(b))
        columns = np.floor(np.arccos(np.clip(cosine, -1, 1)) * (cols / (2 * math.pi))).astype(np.int64)
        table[inside, k + reach] = np.where(cosine > 1, -1, np.minimum(columns, cols // 2))
    return table


def compact_sources(seen: EnvironmentMap) -> CompactSources:
    """The compact sources of a map. Cells that are nan, infinite or negative are dark in each such channel."""
    rows, cols, _ = seen.radiance.shape
    of = _geometry(rows, cols, seen.coverage)
    bright = seen.bright_cells
    luminance, power = _luminance(read_only(seen.radiance), of.solid_angles)
    if not power > 0:
        vectors, numbers = np.zeros((0, 3)), np.zeros(0)
        none = np.full(rows * cols, -1, np.int16)
        return CompactSources(vectors, vectors, numbers, numbers, numbers, numbers, vectors, none, np.zeros(0, bool), 0)
    floor = HOT_FLOOR * power
    hot = _hot_cells(luminance, _local_median(luminance, of.theta, floor), floor)
    order = hot[np.argsort(-luminance.reshape(-1)[hot], kind="stable")]
    members, starts, core = _components(luminance, order, of.linked, of.grown)
    table, background = _measured(
        read_only(seen.radiance), luminance, members, starts, core, of.directions, of.solid_angles, of.pitch,
        read_only(bright.cells), read_only(bright.directions), read_only(bright.weights),
    )  # fmt: skip
    strength = table[:, 3:6] @ np.array([LUMINANCE_RED, LUMINANCE_GREEN, LUMINANCE_BLUE])
    behind = background @ np.array([LUMINANCE_RED, LUMINANCE_GREEN, LUMINANCE_BLUE])
    least = MIN_SHARE * power
    kept = (strength >= least) & (table[:, 8] <= MAX_RADIUS_RAD) & (table[:, 10] > PROMINENCE * behind)
    order = np.flatnonzero(kept)[np.argsort(-strength[kept], kind="stable")]
    beyond = max(len(order) - MAX_SOURCES, 0)
    if beyond:
        order, least = order[:MAX_SOURCES], strength[order[MAX_SOURCES]]
    sure = (strength[order] > SURE * least) & (table[order, 10] > SURE * PROMINENCE * behind[order])
    owner = np.full(rows * cols, -1, np.int16)
    for n, component in enumerate(order):
        owner[members[starts[component] : starts[component + 1]]] = n
    table = table[order]
    spread = table[:, 9]
    radius2 = 2 * spread  # of an even disc
    fixed = table[:, 7] + LENS_RAD**2 + OF_RADIUS**2 * radius2
    return CompactSources(table[:, :3], table[:, 3:6], table[:, 6], fixed, spread, table[:, 10], background[order], owner, sure, beyond)


@kernel
def _luminance(radiance, solid_angles):
    rows, cols, _ = radiance.shape
    luminance, power = np.empty((rows, cols)), 0.0
    for i in range(rows):
        ring = 0.0
        for j in range(cols):
            red, green, blue = radiance[i, j, 0], radiance[i, j, 1], radiance[i, j, 2]
            value = LUMINANCE_RED * red + LUMINANCE_GREEN * green + LUMINANCE_BLUE * blue
            if not (red >= 0 and green >= 0 and blue >= 0 and value < np.inf):
                value = LUMINANCE_RED * red if 0 < red < np.inf else 0.0
                value += LUMINANCE_GREEN * green if 0 < green < np.inf else 0.0
                value += LUMINANCE_BLUE * blue if 0 < blue < np.inf else 0.0
            luminance[i, j] = value
            ring += value
        power += ring * solid_angles[i]
    return luminance, power


@subroutine
def _median(values, count):
    # the upper median of values[:count], which are reordered (Hoare's selection)
    k, low, high = count // 2, 0, count - 1
    while low < high:
        pivot, i, j = values[k], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if j < k:
            low = i
        if k < i:
            high = j
    return values[k]


@kernel
def _local_median(luminance, theta, floor):
    """Medians around each block of BLOCK x BLOCK cells, of the blocks' means; inf where the lowest of them says that no cell is hot."""
    rows, cols = luminance.shape
    down, across = (rows + BLOCK - 1) // BLOCK, (cols + BLOCK - 1) // BLOCK
    means, counts, medians = np.zeros((down, across)), np.zeros((down, across)), np.full((down, across), np.inf)
    brightest = np.zeros((down, across))
    for i in range(rows):
        for j in range(cols):
            means[i // BLOCK, j // BLOCK] += luminance[i, j]
            counts[i // BLOCK, j // BLOCK] += 1
            brightest[i // BLOCK, j // BLOCK] = max(brightest[i // BLOCK, j // BLOCK], luminance[i, j])
    for i in range(down):
        for j in range(across):
            means[i, j] /= counts[i, j]
    values = np.empty((2 * WINDOW_ROWS + 1) * (2 * WINDOW_COLS + 1))
    for i in range(down):
        sine = np.sin(theta[min(i * BLOCK + BLOCK // 2, rows - 1)])
        step = min(WINDOW_RAD / sine, np.pi) / WINDOW_COLS * across / (2 * np.pi)  # blocks from place to place
        for j in range(0, across, 2):
            count, lowest, beside = 0, np.inf, min(j + 1, across - 1)
            for di in range(-WINDOW_ROWS, WINDOW_ROWS + 1):
                row = min(max(i + di, 0), down - 1)
                for dj in range(-WINDOW_COLS, WINDOW_COLS + 1):
                    values[count] = means[row, int(np.floor(j + dj * step + 0.5)) % across]
                    lowest = min(lowest, values[count])
                    count += 1
            if max(brightest[i, j], brightest[i, beside]) > HOT_RATIO * lowest + floor:
                medians[i, j] = _median(values, count)
                medians[i, beside] = medians[i, j]
    return medians


@kernel
def _hot_cells(luminance, around, floor):
    rows, cols = luminance.shape
    cells, count = np.zeros(rows * cols, np.int64), 0
    for i in range(rows):
        for j in range(cols):
            if luminance[i, j] > HOT_RATIO * around[i // BLOCK, j // BLOCK] + floor:
                cells[count] = i * cols + j
                count += 1
    return cells[:count]


@kernel
def _components(luminance, order, linked, grown):
    """The cells of each source: members[starts[n] : starts[n + 1]], the first core[n] of them its core, the others its rim.

    order: the hot cells, the brightest first. Each joins the brightest cell near it, or is a peak; where two peaks meet at MERGE of the
    lower or above, they are one source (a watershed by persistence: Edelsbrunner, Letscher and Zomorodian 2002).
    """
    rows, cols = luminance.shape
    label, in_core = np.full(rows * cols, -1, np.int32), np.zeros(rows * cols, np.bool_)
    root, peak, count = np.zeros(len(order), np.int64), np.zeros(len(order)), 0
    for cell in order:
        light = luminance[cell // cols, cell % cols]
        own = _joined(cell, light, luminance, label, root, peak, linked)
        if own < 0:
            own = count
            root[count], peak[count] = count, light
            count += 1
        label[cell], in_core[cell] = own, light >= CORE * peak[own]
    members, starts, core = np.zeros(rows * cols, np.int64), np.zeros(count + 1, np.int64), np.zeros(count, np.int64)
    taken, end, sources = in_core.copy(), 0, 0
    first = np.zeros(len(order) + 1, np.int64)  # the hot cells by source: a counting sort
    for cell in order:
        label[cell] = root_of(root, label[cell])
        first[label[cell] + 1] += in_core[cell]
    for n in range(count):
        first[n + 1] += first[n]
    sorted_cells, at = np.zeros(first[count], np.int64), first.copy()
    for cell in order:
        if in_core[cell]:
            sorted_cells[at[label[cell]]] = cell
            at[label[cell]] += 1
    for n in range(count):
        if root[n] != n:
            continue
        begin = end
        for k in range(first[n], first[n + 1]):
            members[end] = sorted_cells[k]
            end += 1
        core[sources] = end - begin
        for k in range(begin, begin + core[sources]):
            end = _take_near(members[k], taken, grown, members, end, cols)
        sources += 1
        starts[sources] = end
    return members[:end], starts[: sources + 1], core[:sources]


@subroutine
def _joined(cell, light, luminance, label, root, peak, columns):
    # the source of the brightest cell near one, joined with others near it that have no valley in between; -1: none is near
    cols = luminance.shape[1]
    row, col = cell // cols, cell % cols
    reach = columns.shape[1] // 2
    own, brightest = -1, -1.0
    for again in range(2):
        for k in range(-reach, reach + 1):
            width = columns[row, k + reach]
            if width < 0:
                continue
            first = -width if 2 * width < cols else -((cols - 1) // 2)
            for dj in range(first, width + 1):
                column = (col + dj) % cols
                other = label[(row + k) * cols + column]
                if other < 0:
                    continue
                if again == 0:
                    if luminance[row + k, column] > brightest:
                        own, brightest = other, luminance[row + k, column]
                    continue
                a, b = root_of(root, own), root_of(root, other)
                if a != b and light >= MERGE * min(peak[a], peak[b]):
                    higher, lower = (a, b) if peak[a] >= peak[b] else (b, a)
                    root[lower] = higher
        if own < 0:
            return own
    return root_of(root, own)


@subroutine
def _take_near(cell, taken, columns, members, end, cols):
    # puts the cells near one behind the members, unless they are taken
    row, col = cell // cols, cell % cols
    reach = columns.shape[1] // 2
    for k in range(-reach, reach + 1):
        width = columns[row, k + reach]
        if width < 0:
            continue
        first = -width if 2 * width < cols else -((cols - 1) // 2)
        for dj in range(first, width + 1):
            other = (row + k) * cols + (col + dj) % cols
            if not taken[other]:
                taken[other] = True
                members[end] = other
                end += 1
    return end


@kernel
def _measured(radiance, luminance, members, starts, core, directions, solid_angles, pitch, cells, centres, weights):
    """Of each source: direction (3), flux (3), noise, fixed, radius, spread, peak; and its background (3)."""
    rows, cols, _ = radiance.shape
    sources = len(core)
    table, background = np.zeros((sources, 11)), np.zeros((sources, 3))
    part_of = np.full(rows * cols, -1, np.int32)  # the first part of a bright cell
    for n in range(len(cells) - 1, -1, -1):
        part_of[cells[n]] = n
    values = np.zeros(len(members) + 1)
    for s in range(sources):
        rim = starts[s] + core[s]
        for c in range(3):
            count = 0
            for n in range(rim, starts[s + 1]):
                light = radiance[members[n] // cols, members[n] % cols, c]
                values[count] = light if 0 < light < np.inf else 0.0
                count += 1
            background[s, c] = _median(values, count) if count else 0.0
        behind = LUMINANCE_RED * background[s, 0] + LUMINANCE_GREEN * background[s, 1] + LUMINANCE_BLUE * background[s, 2]
        _centroid(s, radiance, luminance, members[starts[s] : starts[s + 1]], background[s], behind, directions, solid_angles, part_of,
                  cells, centres, weights, table)  # fmt: skip
        _spreads(s, luminance, members[starts[s] : starts[s + 1]], core[s], behind, directions, solid_angles, pitch, part_of,
                 cells, centres, weights, table)  # fmt: skip
    return table, background


@subroutine
def _centroid(s, radiance, luminance, members, background, behind, directions, solid_angles, part_of, cells, centres, weights, table):
    # direction, flux and peak of a source
    cols = luminance.shape[1]
    for cell in members:
        i, j = cell // cols, cell % cols
        for c in range(3):
            light = radiance[i, j, c]
            table[s, 3 + c] += ((light if 0 < light < np.inf else 0.0) - background[c]) * solid_angles[i]
        table[s, 10] = max(table[s, 10], luminance[i, j])
    for cell in members:
        i, j = cell // cols, cell % cols
        if luminance[i, j] < BRIGHT * table[s, 10]:
            continue
        light = (luminance[i, j] - behind) * solid_angles[i]
        n = part_of[cell]
        if n < 0:
            for x in range(3):
                table[s, x] += light * directions[cell, x]
        while 0 <= n < len(cells) and cells[n] == cell:
            for x in range(3):
                table[s, x] += light * weights[n] * centres[n, x]
            n += 1
    length = np.sqrt(table[s, 0] ** 2 + table[s, 1] ** 2 + table[s, 2] ** 2)
    for x in range(3):
        table[s, x] /= max(length, 1e-300)
        table[s, 3 + x] = max(table[s, 3 + x], 0.0)


@subroutine
def _spreads(s, luminance, members, core, behind, directions, solid_angles, pitch, part_of, cells, centres, weights, table):
    # variances, radius and second moment of a source about its direction
    cols = luminance.shape[1]
    flux, bright_flux, noise, grain, moment = 0.0, 0.0, 0.0, 0.0, 0.0
    for at in range(len(members)):
        cell = members[at]
        i, j = cell // cols, cell % cols
        seen, light = luminance[i, j] * solid_angles[i], (luminance[i, j] - behind) * solid_angles[i]
        away = 0.0
        for x in range(3):
            away += (directions[cell, x] - table[s, x]) ** 2
        if at < core:
            table[s, 8] = max(table[s, 8], np.sqrt(away))
        n = part_of[cell]
        side = pitch if n < 0 else SUBCELL * pitch
        if n < 0:
            moment += light * (away - pitch * pitch / 6)  # of what is spread over a cell, at its centre (Sheppard 1898)
        while 0 <= n < len(cells) and cells[n] == cell:
            for x in range(3):
                moment += light * weights[n] * (centres[n, x] - table[s, x]) ** 2
            n += 1
        flux += light
        if luminance[i, j] >= BRIGHT * table[s, 10]:
            bright_flux += light
            noise += seen * seen * away
            grain += light * light * side * side / 12
    if flux > 0 and bright_flux > 0:
        table[s, 6] = NOISE * NOISE * noise / (2 * bright_flux * bright_flux)
        table[s, 7] = grain / (bright_flux * bright_flux)
        table[s, 9] = max(moment / flux, 0.0)
