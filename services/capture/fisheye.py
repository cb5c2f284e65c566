"""Fisheye images resampled to the polar map: each pixel's light is handed to the cells that it overlaps, so that none is lost.

The weight of pixel p in cell c is the solid angle they share over the cell's. Shared solid angles come from subpixels, finer
where cells are narrow, and are then balanced: the shares of a pixel add up to its solid angle exactly (power is conserved), those
of a cell that the lens sees whole to the cell's as nearly as the rounds below get (an even sky stays even).

A Bayer mosaic is not demosaiced: the pixels of each colour stand for the ground between them, and have weights of their own.
"""

import math
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from numba import njit

from services.capture.lens import (
    Lens,
    angle_from_radius,
    direction_from_pixel,
    pixel_angles,
    pixel_from_direction,
    pixel_solid_angles,
    radius_from_angle,
    slope_from_angle,
    vignetting_from_angle,
)
from services.sphere import SPAN, Coverage, angles_from_direction, cell_solid_angles, direction_from_angles
from services.strong import NONE, StrongLight, strong_light

Bayer = Literal["RGGB", "BGGR", "GRBG", "GBRG"]  # colours of the first two pixels of the first two rows
LOOKUP = 4096  # angles of the radius table; between two of them the line is off by (3 / 4096)^2 / 8 = 7e-8 rad at most
FINE = 8  # subpixels a side, at least, where a pixel crosses an edge of the map
FINER = 8  # across the narrowest cell
FINEST = 128  # next to the zenith, where cells are narrower than that
ROUNDS = 40  # of balancing; the evenness then reached is in the tests


class Lattice(NamedTuple):
    """Pixels of one kind: every `step`-th from `first` on, along x and y, each standing for `size` pixels around its centre."""

    first: tuple[int, int]
    step: tuple[int, int]
    size: tuple[int, int]


ALL = (Lattice((0, 0), (1, 1), (1, 1)),)


class FisheyeToPolar(NamedTuple):
    """Weights from a fisheye image to a polar map: pixel[m] gives weight[m] times its value to cell[m]."""

    shape: tuple[int, int]  # of the image
    rows: int
    cols: int
    pixel: np.ndarray  # (m,) uint32, index into the flat image, ascending
    cell: np.ndarray  # (m,) uint16 or uint32, index into the flat map
    weight: np.ndarray  # (m,) float32, shared solid angle / the cell's, over vignetting and flat field
    by_cell: np.ndarray  # (m,) int32, the order that sorts `cell`
    start: np.ndarray  # (rows * cols + 1,) int32: cell c has by_cell[start[c] : start[c + 1]]


def colour_lattices(bayer: Bayer) -> tuple[tuple[Lattice, ...], tuple[Lattice, ...], tuple[Lattice, ...]]:
    """The pixels of red, green and blue in a mosaic. A red or blue pixel stands for 2 x 2, a green one for 2 x 1."""
    at = {colour: [(n % 2, n // 2) for n in range(4) if bayer[n] == colour] for colour in "RGB"}
    sizes = {"R": (2, 2), "G": (2, 1), "B": (2, 2)}
    red, green, blue = (tuple(Lattice(first, (2, 2), sizes[colour]) for first in at[colour]) for colour in "RGB")
    return red, green, blue


def fisheye_to_polar(
    lens: Lens,
    rows: int,
    cols: int,
    coverage: Coverage,
    lattices: tuple[Lattice, ...] = ALL,
    flat_field: np.ndarray | None = None,
) -> FisheyeToPolar:
    """Weights for the pixels of `lattices` in images of `lens`.

    `flat_field` (height, width): each pixel's response to even light relative to the axis, in place of the lens file's vignetting.
    """
    solid, f, c = pixel_solid_angles(lens), np.array(lens.f), np.array(lens.c)
    reach = radius_from_angle(lens.rim, lens.k, lens.rim) + 4 / min(lens.f)
    angles = np.array([angle_from_radius(r, lens.k, lens.rim) for r in np.linspace(0, reach, LOOKUP)])
    found = [
        _shares(solid, f, c, angles, reach, lens.rotation, rows, cols, SPAN[coverage], *first, *step, *size)
        for first, step, size in lattices
    ]
    pixel, cell = np.concatenate([part[0] for part in found]), np.concatenate([part[1] for part in found])
    share = np.concatenate([part[2] for part in found])
    cells = np.repeat(cell_solid_angles(rows, cols, coverage), cols)
    _balance(pixel, cell, share, np.where(_seen_whole(lens, rows, cols, coverage).ravel(), cells, 0.0), solid.size)
    own = vignetting_from_angle(np.minimum(pixel_angles(lens), lens.rim), lens) if flat_field is None else flat_field
    order = np.argsort(pixel, kind="stable")
    pixel, cell, share = pixel[order], cell[order], share[order]
    weight = (share / cells[cell] / own.ravel()[pixel]).astype(np.float32)
    by_cell = np.argsort(cell, kind="stable").astype(np.int32)
    start = np.searchsorted(cell[by_cell], np.arange(rows * cols + 1)).astype(np.int32)
    cell = cell.astype(np.uint16 if rows * cols <= 2**16 else np.uint32)  # what is read most is best small
    return FisheyeToPolar(solid.shape, rows, cols, pixel.astype(np.uint32), cell, weight, by_cell, start)


def _seen_whole(lens: Lens, rows: int, cols: int, coverage: Coverage) -> np.ndarray:
    # cells whose corners lie at least a pixel inside the rim, (rows, cols) bool
    theta = np.linspace(0, SPAN[coverage], rows + 1)[:, None]
    corners = direction_from_angles(theta, np.linspace(0, 2 * np.pi, cols + 1)) @ lens.rotation
    off_axis, _ = angles_from_direction(corners)
    inside = off_axis < lens.rim - 2.5 / (min(lens.f) * slope_from_angle(np.array(lens.rim), lens))
    pixels = pixel_from_direction(corners, lens)
    inside &= np.all((pixels > 1) & (pixels < np.array(lens.size) - 2), axis=-1)
    return inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]


@njit(cache=True)
def _cell(x, y, angles, reach, rotation, rows, cols, span):
    # cell of the map that (x, y) in units of theta_d sees, and the sine of its polar angle; -1 outside the map
    radius = math.hypot(x, y)
    at = min(radius / reach * (len(angles) - 1), len(angles) - 1.000001)
    i = int(at)
    theta = angles[i] + (at - i) * (angles[i + 1] - angles[i])
    across = math.sin(theta) / radius if radius > 0 else 0.0
    dx, dy, dz = x * across, y * across, math.cos(theta)
    wx = rotation[0, 0] * dx + rotation[0, 1] * dy + rotation[0, 2] * dz
    wy = rotation[1, 0] * dx + rotation[1, 1] * dy + rotation[1, 2] * dz
    wz = rotation[2, 0] * dx + rotation[2, 1] * dy + rotation[2, 2] * dz
    sine = math.hypot(wx, wy)
    row = int(math.atan2(sine, wz) / span * rows)
    if row >= rows:
        return -1, sine
    phi = math.atan2(wy, wx)
    col = int((phi if phi >= 0 else phi + 2 * math.pi) / (2 * math.pi) * cols)
    return row * cols + min(col, cols - 1), sine


@njit(cache=True)
def _shares(solid, f, c, angles, reach, rotation, rows, cols, span, first_x, first_y, step_x, step_y, size_x, size_y):
    # (pixel, cell, shared solid angle) of all pixels of a lattice, pixel by pixel
    height, width = solid.shape
    room = 2 * height * width // (step_x * step_y) + 4 * rows * cols
    pixel, cell, share = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room)
    found, hits = np.empty(rows * cols, np.int32), np.zeros(rows * cols, np.int32)
    m = 0
    for y in range(first_y, height, step_y):
        for x in range(first_x, width, step_x):
            if solid[y, x] == 0:
                continue
            whole_angle = solid[y, x] * size_x * size_y
            middle, sine = _cell((x - c[0]) / f[0], (y - c[1]) / f[1], angles, reach, rotation, rows, cols, span)
            side = math.sqrt(solid[y, x]) * max(size_x, size_y)
            narrow = min(span / rows, 2 * math.pi / cols * max(sine - side, 1e-9))
            whole = side < narrow or middle < 0
            for corner in range(4):
                px = (x + (corner % 2 - 0.5) * size_x - c[0]) / f[0]
                py = (y + (corner // 2 - 0.5) * size_y - c[1]) / f[1]
                at, _ = _cell(px, py, angles, reach, rotation, rows, cols, span)
                whole = whole and at == middle
            if whole:
                if middle < 0:
                    continue
                count, fine = 1, 1
                found[0], hits[middle] = middle, 1
            else:
                fine, count = min(max(FINE, int(FINER * side / narrow)), FINEST), 0
                for v in range(fine):
                    for u in range(fine):
                        px = x + ((u + 0.5) / fine - 0.5) * size_x
                        py = y + ((v + 0.5) / fine - 0.5) * size_y
                        at, _ = _cell((px - c[0]) / f[0], (py - c[1]) / f[1], angles, reach, rotation, rows, cols, span)
                        if at >= 0:
                            if hits[at] == 0:
                                found[count] = at
                                count += 1
                            hits[at] += 1
            if m + count > len(cell):
                pixel, cell = np.append(pixel, np.empty_like(pixel)), np.append(cell, np.empty_like(cell))
                share = np.append(share, np.empty_like(share))
            for q in range(count):
                pixel[m], cell[m], share[m] = y * width + x, found[q], whole_angle * hits[found[q]] / (fine * fine)
                hits[found[q]] = 0
                m += 1
    return pixel[:m].copy(), cell[:m].copy(), share[:m].copy()


@njit(cache=True)
def _balance(pixel, cell, share, cells, pixels):
    # Sinkhorn and Knopp (1967): scale to one margin, then to the other; the pixels' margin comes last and is exact.
    # cells: the solid angle that each cell's shares must add up to, 0 where they need not
    own = np.zeros(pixels)
    for m in range(len(pixel)):
        own[pixel[m]] += share[m]
    for _ in range(ROUNDS):
        total = np.zeros(len(cells))
        for m in range(len(cell)):
            total[cell[m]] += share[m]
        sums = np.zeros(pixels)
        for m in range(len(cell)):
            if cells[cell[m]] > 0:
                share[m] *= cells[cell[m]] / total[cell[m]]
            sums[pixel[m]] += share[m]
        for m in range(len(cell)):
            share[m] *= own[pixel[m]] / sums[pixel[m]]


def polar_from_fisheye(image: np.ndarray, weights: FisheyeToPolar) -> np.ndarray:
    """The polar map (rows, cols, 3) float32 of a fisheye image of radiance (height, width, 3) float32."""
    polar = _scattered(image.reshape(-1, 3), weights.pixel, weights.cell, weights.weight, weights.rows * weights.cols)
    return polar.reshape(weights.rows, weights.cols, 3)


@njit(cache=True)
def _scattered(image, pixel, cell, weight, cells):
    polar = np.zeros((cells, 3), np.float32)
    for m in range(len(pixel)):
        w, p, at = weight[m], pixel[m], cell[m]
        polar[at, 0] += w * image[p, 0]
        polar[at, 1] += w * image[p, 1]
        polar[at, 2] += w * image[p, 2]
    return polar


def polar_from_codes(codes: np.ndarray, weights: FisheyeToPolar, table: np.ndarray) -> np.ndarray:
    """The polar map (rows, cols) float32 of one channel of raw codes, (height, width) uint8 or uint16.

    `table`: radiance of each code that the dtype has, (256,) or (65536,) float32, finite.
    """
    polar = _decoded(codes.reshape(-1), weights.pixel, weights.cell, weights.weight, table, weights.rows * weights.cols)
    return polar.reshape(weights.rows, weights.cols)


@njit(cache=True)
def _decoded(codes, pixel, cell, weight, table, cells):
    # two halves of the image in turns: neighbouring pixels meet in one cell, and adding to it waits for the addition before
    polar = np.zeros(cells, np.float32)
    half = len(pixel) // 2
    for m in range(half):
        n = m + half
        polar[cell[m]] += weight[m] * table[codes[pixel[m]]]
        polar[cell[n]] += weight[n] * table[codes[pixel[n]]]
    for m in range(2 * half, len(pixel)):
        polar[cell[m]] += weight[m] * table[codes[pixel[m]]]
    return polar


@njit(cache=True)
def clipped_counts(codes, spans, top):
    """(black, saturated, highest code) of codes (height, width) within `spans` (height, 2) of columns, first and last + 1."""
    black, saturated, highest = 0, 0, 0
    for y in range(len(spans)):
        row = codes[y, spans[y, 0] : spans[y, 1]]
        for x in range(len(row)):
            black += row[x] == 0
            saturated += row[x] >= top
            highest = max(highest, row[x])
    return black, saturated, highest


def lit_spans(weights: FisheyeToPolar) -> np.ndarray:
    """(height, 2) int64: in each row of the image, the first pixel that sees part of the map, and one past the last."""
    y, x = np.divmod(weights.pixel.astype(np.int64), weights.shape[1])
    first, last = np.full(weights.shape[0], weights.shape[1]), np.zeros(weights.shape[0], np.int64)
    np.minimum.at(first, y, x)
    np.maximum.at(last, y, x + 1)
    return np.column_stack([np.minimum(first, last), last])


def fisheye_strong(
    brightness: Callable[[np.ndarray], np.ndarray], weights: FisheyeToPolar, lens: Lens, cells: np.ndarray, coverage: Coverage
) -> StrongLight:
    """Where light sits inside each of the map's `cells` (n,), flat indices.

    `brightness`: luminance of the image's pixels (m,) int64, flat indices, some of which must be lit in each cell.
    """
    if not len(cells):
        return NONE
    entries = [weights.by_cell[weights.start[c] : weights.start[c + 1]] for c in cells]
    each = np.concatenate(entries)
    pixel = weights.pixel[each].astype(np.int64)
    flux = (weights.weight[each] * brightness(pixel)).astype(np.float64)
    at = np.column_stack([pixel % weights.shape[1], pixel // weights.shape[1]])
    owner = np.repeat(cells.astype(np.int64), [len(part) for part in entries])
    return strong_light(owner, direction_from_pixel(at, lens) @ lens.rotation.T, flux, weights.rows, weights.cols, coverage)
