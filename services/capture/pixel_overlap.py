"""The solid angle that each pixel of a fisheye image has in common with each cell of a polar map.

Counted in subpixels, finer where cells are narrow, and then balanced: the overlaps of a pixel add up to its solid angle exactly, so
that power is conserved, and those of a cell that the lens sees whole add up to the cell's as closely as the balancing gets, so that an
even sky stays even.
"""

import math
from typing import NamedTuple

import numpy as np

from vemlight.capture.lens import Intrinsics, Lens, angles_from_radii, centred, radius_from_angle
from vemlight.kernels import kernel, subroutine

RADIUS_TABLE_SIZE = 4096  # angles over the radius; linear interpolation is off by (3 / 4096)^2 / 8 = 7e-8 rad at most; 1024 to 16384 do
MIN_SUBPIXELS = 8  # on a side, where a pixel crosses a cell's edge: an edge along a line of them moves by 1/16 of the pixel
SUBPIXELS_PER_CELL = 8  # across the narrowest cell that a pixel near the zenith overlaps
MAX_SUBPIXELS = 128  # next to the zenith itself, where cells are narrower than a subpixel
STRAIGHT_FROM = 4.0  # pixels off the zenith: an edge bends by 1 / (8 x 4) of a pixel from here on, half a subpixel; 2 to 8 do
BALANCING_ROUNDS = 40  # an even sky is then even within 1 % at two pixels a cell; each halving of the error takes about 10 more


class Lattice(NamedTuple):
    """Pixels of one kind: every `step`-th from `first` on, along x and y, each representing `size` pixels around its centre."""

    first: tuple[int, int]
    step: tuple[int, int]
    size: tuple[int, int]


class RayTable(NamedTuple):
    """World directions of image points, from a table of angles over the radius."""

    lens: Intrinsics
    angles: np.ndarray  # (RADIUS_TABLE_SIZE,) float64, rad off the axis at even steps of the radius
    max_radius: float  # of the last angle, in units of the focal length
    world_from_camera: np.ndarray  # (3, 3) float64


class MapGrid(NamedTuple):
    """The cells of a polar map."""

    rows: int
    cols: int
    span: float  # polar angle of the last row's lower edge, rad


class CellCounts(NamedTuple):
    """Scratch space: the cells that one pixel overlaps, and the number of its subpixels in each."""

    cells: np.ndarray  # (rows * cols,) int32, of which the first few are in use
    hits: np.ndarray  # (rows * cols,) int32, by cell; 0 outside those


class CellBlock(NamedTuple):
    """The rows and columns of cells that a pixel reaches into; `right` may lie beyond the last column, across the seam."""

    top: int
    bottom: int
    left: int
    right: int


def ray_table(lens: Lens) -> RayTable:
    """The table of a lens, out to the corners of the outermost pixel whose centre lies inside the rim."""
    # two pixels would reach those corners, also of the mosaic's pixels that represent 2 x 2; twice that leaves a margin
    max_radius = radius_from_angle(lens.rim, lens.intrinsics) + 4 / min(lens.f)
    angles = angles_from_radii(np.linspace(0, max_radius, RADIUS_TABLE_SIZE), lens.intrinsics)
    return RayTable(lens.intrinsics, angles, max_radius, lens.rotation)


@kernel
def pixel_overlaps(solid, rays, grid, lattice):
    """Pixel, cell and common solid angle of the pixels of a lattice, pixel by pixel: int32, int32 and float64, all (n,).

    `solid` (height, width): solid angle of each pixel, 0 where no light arrives.
    """
    height, width = solid.shape
    (first_x, first_y), (step_x, step_y), (size_x, size_y) = lattice
    capacity = 2 * height * width // (step_x * step_y) + 4 * grid.rows * grid.cols
    pixel, cell, overlap = np.empty(capacity, np.int32), np.empty(capacity, np.int32), np.empty(capacity)
    counts = CellCounts(np.empty(grid.rows * grid.cols, np.int32), np.zeros(grid.rows * grid.cols, np.int32))
    above, below = np.empty((width // step_x + 2, 5)), np.empty((width // step_x + 2, 5))
    ready, m = math.inf, 0
    for y in range(first_y, height, step_y):
        # corners of this row of pixels; where rows touch, those above are those below the previous row
        if ready == y - size_y / 2:
            above, below = below, above
        else:
            _fill_corners(above, y - size_y / 2, rays, grid, lattice)
        ready = y + size_y / 2
        _fill_corners(below, ready, rays, grid, lattice)
        for n, x in enumerate(range(first_x, width, step_x)):
            if solid[y, x] == 0:
                continue
            side = math.sqrt(solid[y, x]) * max(size_x, size_y)
            total, count = _count_cells(counts, above, below, n, side, grid)
            if m + count > len(cell):
                pixel, cell, overlap = _doubled(pixel), _doubled(cell), _doubled(overlap)
            for q in range(count):
                pixel[m], cell[m] = y * width + x, counts.cells[q]
                overlap[m] = solid[y, x] * size_x * size_y * counts.hits[counts.cells[q]] / total
                counts.hits[counts.cells[q]] = 0
                m += 1
    return pixel[:m].copy(), cell[:m].copy(), overlap[:m].copy()


@subroutine
def _doubled(array):
    # numpy's own `append` takes seconds to compile
    longer = np.empty(2 * len(array), array.dtype)
    for k in range(len(array)):
        longer[k] = array[k]
    return longer


@subroutine
def _fill_corners(corners, y, rays, grid, lattice):
    # x, y, z in the world, and row and column of the map, of a row of pixel corners, (n, 5)
    lens, rotation = rays.lens, rays.world_from_camera
    for n in range(len(corners)):
        px, py = centred((lattice.first[0] + (n - 0.5) * lattice.size[0] - lens.cx) / lens.fx, (y - lens.cy) / lens.fy, lens)
        radius = math.hypot(px, py)
        at = min(radius / rays.max_radius * (len(rays.angles) - 1), len(rays.angles) - 1.000001)
        i = int(at)
        theta = rays.angles[i] + (at - i) * (rays.angles[i + 1] - rays.angles[i])
        across = math.sin(theta) / radius if radius > 0 else 0.0
        dx, dy, dz = px * across, py * across, math.cos(theta)
        for k in range(3):
            corners[n, k] = rotation[k, 0] * dx + rotation[k, 1] * dy + rotation[k, 2] * dz
        corners[n, 3], corners[n, 4] = _row_and_column(corners[n, 0], corners[n, 1], corners[n, 2], grid)


@subroutine
def _row_and_column(x, y, z, grid):
    # continuous row and column of the map
    phi = math.atan2(y, x)
    row = math.atan2(math.hypot(x, y), z) / grid.span * grid.rows
    return row, (phi if phi >= 0 else phi + 2 * math.pi) / (2 * math.pi) * grid.cols


@subroutine
def _count_cells(counts, above, below, n, side, grid):
    # fills `counts` with the cells that pixel `n` between two rows of corners overlaps; returns its subpixels and the cells' number
    a, b, c, d = above[n], above[n + 1], below[n], below[n + 1]
    sine = min(math.hypot(a[0], a[1]), math.hypot(d[0], d[1]))
    # columns relative to the first corner's, so that the seam at phi = 0 separates none
    low = high = 0.0
    for other in (b[4], c[4], d[4]):
        along = (other - a[4] + 1.5 * grid.cols) % grid.cols - 0.5 * grid.cols
        low, high = min(low, along), max(high, along)
    left, right = math.floor(a[4] + low), math.floor(a[4] + high)
    top, bottom = math.floor(min(a[3], b[3], c[3], d[3])), math.floor(max(a[3], b[3], c[3], d[3]))
    if sine < STRAIGHT_FROM * side or bottom - top > 1 or right - left > 1:
        return _count_subpixels(counts, above, below, n, side, grid)
    if top >= grid.rows:
        return 1, 0
    if top == bottom and left == right:
        counts.cells[0] = int(top) * grid.cols + int(left) % grid.cols
        counts.hits[counts.cells[0]] = 1
        return 1, 1
    return _count_quadrants(counts, above, below, n, CellBlock(int(top), int(bottom), int(left), int(right)), grid)


@subroutine
def _count_quadrants(counts, above, below, n, block, grid):
    # a pixel that at most one edge between rows and one between columns crosses; the distance from either is bilinear over the pixel
    theta, phi = block.bottom * grid.span / grid.rows, block.right * 2 * math.pi / grid.cols
    sin_theta, cos_theta, sin_phi, cos_phi = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
    past_row, past_col = np.ones((2, 2)), np.ones((2, 2))
    for k in range(4):
        corner = above[n + k % 2] if k < 2 else below[n + k % 2]
        if block.bottom > block.top:
            past_row[k // 2, k % 2] = math.hypot(corner[0], corner[1]) * cos_theta - corner[2] * sin_theta
        if block.right > block.left:
            past_col[k // 2, k % 2] = corner[1] * cos_phi - corner[0] * sin_phi
    below_edge = right_of_edge = both = 0
    for v in range(MIN_SUBPIXELS):
        t = (v + 0.5) / MIN_SUBPIXELS
        row_0, row_1 = past_row[0, 0] + t * (past_row[1, 0] - past_row[0, 0]), past_row[0, 1] + t * (past_row[1, 1] - past_row[0, 1])
        col_0, col_1 = past_col[0, 0] + t * (past_col[1, 0] - past_col[0, 0]), past_col[0, 1] + t * (past_col[1, 1] - past_col[0, 1])
        for u in range(MIN_SUBPIXELS):
            s = (u + 0.5) / MIN_SUBPIXELS
            is_below, is_right = row_0 + s * (row_1 - row_0) >= 0, col_0 + s * (col_1 - col_0) >= 0
            below_edge += is_below
            right_of_edge += is_right
            both += is_below and is_right
    total, count = MIN_SUBPIXELS * MIN_SUBPIXELS, 0
    quadrants = (total - below_edge - right_of_edge + both, right_of_edge - both, below_edge - both, both)
    for k in range(4):
        row = block.bottom if k // 2 else block.top
        if quadrants[k] > 0 and row < grid.rows:
            counts.cells[count] = row * grid.cols + (block.right if k % 2 else block.left) % grid.cols
            counts.hits[counts.cells[count]] = quadrants[k]
            count += 1
    return total, count


@subroutine
def _count_subpixels(counts, above, below, n, side, grid):
    # any pixel, also on the zenith: subpixel by subpixel
    a, b, c, d = above[n], above[n + 1], below[n], below[n + 1]
    sine = max(math.hypot(a[0], a[1]), math.hypot(d[0], d[1]))
    narrowest = min(grid.span / grid.rows, 2 * math.pi / grid.cols * max(sine - 1.5 * side, 1e-9))
    across, count = min(max(MIN_SUBPIXELS, int(SUBPIXELS_PER_CELL * side / narrowest)), MAX_SUBPIXELS), 0
    for v in range(across):
        t = (v + 0.5) / across
        for u in range(across):
            s = (u + 0.5) / across
            p, q, r, w = (1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t
            x, y = p * a[0] + q * b[0] + r * c[0] + w * d[0], p * a[1] + q * b[1] + r * c[1] + w * d[1]
            row, col = _row_and_column(x, y, p * a[2] + q * b[2] + r * c[2] + w * d[2], grid)
            if row < grid.rows:
                cell = int(row) * grid.cols + min(int(col), grid.cols - 1)
                if counts.hits[cell] == 0:
                    counts.cells[count] = cell
                    count += 1
                counts.hits[cell] += 1
    return across * across, count


@kernel
def balance(pixel, cell, overlap, solid_by_cell):
    """Scales the overlaps (n,) in place so that those of each cell add up to its solid angle and those of each pixel to what they did.

    Entries of a pixel are adjacent. A `solid_by_cell` (cells,) of 0 leaves a cell's sum free. Alternates between the two
    margins (Sinkhorn and Knopp 1967, "Concerning nonnegative matrices and doubly stochastic matrices"); the pixels' comes last and is
    exact.
    """
    # pixels in one cell only never change
    fixed = np.zeros(len(solid_by_cell))
    starts, ends, solid_by_pixel = np.empty(len(pixel), np.int64), np.empty(len(pixel), np.int64), np.empty(len(pixel))
    several, begin = 0, 0
    for m in range(1, len(pixel) + 1):
        if m < len(pixel) and pixel[m] == pixel[begin]:
            continue
        if m - begin > 1:
            starts[several], ends[several], solid_by_pixel[several] = begin, m, overlap[begin:m].sum()
            several += 1
        else:
            fixed[cell[begin]] += overlap[begin]
        begin = m
    for _ in range(BALANCING_ROUNDS):
        total = fixed.copy()
        for n in range(several):
            for m in range(starts[n], ends[n]):
                total[cell[m]] += overlap[m]
        factor = np.ones(len(solid_by_cell))
        for at in range(len(solid_by_cell)):
            if solid_by_cell[at] > 0 and total[at] > 0:
                factor[at] = solid_by_cell[at] / total[at]
        for n in range(several):
            scaled = 0.0
            for m in range(starts[n], ends[n]):
                overlap[m] *= factor[cell[m]]
                scaled += overlap[m]
            for m in range(starts[n], ends[n]):
                overlap[m] *= solid_by_pixel[n] / scaled
