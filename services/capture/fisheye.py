"""Fisheye images resampled to the polar map: each pixel's light is handed to the cells that it overlaps, so that none is lost.

The weight of pixel p in cell c is the solid angle they share over the cell's. Shared solid angles come from subpixels, finer
where cells are narrow, and are then balanced: the shares of a pixel add up to its solid angle exactly (power is conserved), those
of a cell that the lens sees whole to the cell's as nearly as the rounds below get (an even sky stays even).
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from services.capture.lens import (
    Lens,
    angle_from_radius,
    pixel_angles,
    pixel_from_direction,
    pixel_solid_angles,
    radius_from_angle,
    slope_from_angle,
    vignetting_from_angle,
)
from services.sphere import SPAN, Coverage, angles_from_direction, cell_solid_angles, direction_from_angles

LOOKUP = 4096  # angles of the radius table; between two of them the line is off by (3 / 4096)^2 / 8 = 7e-8 rad at most
FINE = 8  # subpixels a side where a pixel crosses an edge of the map
FINEST = 128  # where cells are narrower than that: next to the zenith
ROUNDS = 40  # of balancing; the evenness then reached is in the tests


class FisheyeToPolar(NamedTuple):
    """Weights from a fisheye image to a polar map, pixel by pixel: pixel[n] gives weight[m] to cell[m], start[n] <= m < start[n + 1]."""

    shape: tuple[int, int]  # of the image
    rows: int
    cols: int
    pixel: np.ndarray  # (n,) int32, index into the flat image, ascending; those inside the rim that see part of the map
    start: np.ndarray  # (n + 1,) int32
    cell: np.ndarray  # (m,) int32, index into the flat map
    weight: np.ndarray  # (m,) float32, shared solid angle / the cell's, over the vignetting


def fisheye_to_polar(lens: Lens, rows: int, cols: int, coverage: Coverage) -> FisheyeToPolar:
    """Weights for images of `lens`."""
    solid = pixel_solid_angles(lens)
    reach = radius_from_angle(lens.rim, lens.k, lens.rim) + 2 / min(lens.f)
    steps = np.linspace(0, reach, LOOKUP)
    angles = np.array([angle_from_radius(r, lens.k, lens.rim) for r in steps])
    pixel, start, cell, share = _shares(
        solid, np.array(lens.f), np.array(lens.c), angles, reach, lens.rotation, rows, cols, SPAN[coverage]
    )
    cells = np.repeat(cell_solid_angles(rows, cols, coverage), cols)
    _balance(start, cell, share, np.where(_seen_whole(lens, rows, cols, coverage).ravel(), cells, 0.0))
    vignetting = vignetting_from_angle(pixel_angles(lens).ravel()[pixel], lens)
    weight = share / cells[cell] / np.repeat(vignetting, np.diff(start))
    return FisheyeToPolar(solid.shape, rows, cols, pixel, start, cell, weight.astype(np.float32))


def _seen_whole(lens: Lens, rows: int, cols: int, coverage: Coverage) -> np.ndarray:
    # cells whose corners lie at least a pixel inside the rim, (rows, cols) bool
    theta = np.linspace(0, SPAN[coverage], rows + 1)[:, None]
    corners = direction_from_angles(theta, np.linspace(0, 2 * np.pi, cols + 1)) @ lens.rotation
    off_axis, _ = angles_from_direction(corners)
    inside = off_axis < lens.rim - 1.5 / (min(lens.f) * slope_from_angle(np.array(lens.rim), lens))
    inside &= np.all((pixel_from_direction(corners, lens) > 0) & (pixel_from_direction(corners, lens) < np.array(lens.size) - 1), axis=-1)
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
def _shares(solid, f, c, angles, reach, rotation, rows, cols, span):
    height, width = solid.shape
    corner = np.empty((height + 1, width + 1), np.int32)
    for y in range(height + 1):
        for x in range(width + 1):
            corner[y, x], _ = _cell((x - 0.5 - c[0]) / f[0], (y - 0.5 - c[1]) / f[1], angles, reach, rotation, rows, cols, span)
    pixel, start = np.empty(height * width, np.int32), np.empty(height * width + 1, np.int32)
    room = 2 * height * width + 4 * rows * cols
    cell, share = np.empty(room, np.int32), np.empty(room)
    n = m = 0
    found, hits = np.empty(rows * cols, np.int32), np.zeros(rows * cols, np.int32)
    for y in range(height):
        for x in range(width):
            if solid[y, x] == 0:
                continue
            middle, sine = _cell((x - c[0]) / f[0], (y - c[1]) / f[1], angles, reach, rotation, rows, cols, span)
            side = math.sqrt(solid[y, x])
            narrow = min(span / rows, 2 * math.pi / cols * max(sine - side, 1e-9))
            whole = middle == corner[y, x] == corner[y + 1, x] == corner[y, x + 1] == corner[y + 1, x + 1]
            if whole and (middle < 0 or side < narrow):
                count, fine = 1, 1
                if middle < 0:
                    continue
                found[0], hits[middle] = middle, 1
            else:
                # 4 subpixels across the narrowest cell
                fine, count = min(max(FINE, int(4 * side / narrow)), FINEST), 0
                for v in range(fine):
                    for u in range(fine):
                        px, py = x - 0.5 + (u + 0.5) / fine, y - 0.5 + (v + 0.5) / fine
                        at, _ = _cell((px - c[0]) / f[0], (py - c[1]) / f[1], angles, reach, rotation, rows, cols, span)
                        if at >= 0:
                            if hits[at] == 0:
                                found[count] = at
                                count += 1
                            hits[at] += 1
            if count == 0:
                continue
            if m + count > len(cell):
                cell, share = np.append(cell, np.empty_like(cell)), np.append(share, np.empty_like(share))
            pixel[n], start[n] = y * width + x, m
            n += 1
            for q in range(count):
                cell[m], share[m] = found[q], solid[y, x] * hits[found[q]] / (fine * fine)
                hits[found[q]] = 0
                m += 1
    start[n] = m
    return pixel[:n].copy(), start[: n + 1].copy(), cell[:m].copy(), share[:m].copy()


@njit(cache=True)
def _balance(start, cell, share, cells):
    # cells: the solid angle that each cell's shares must add up to, 0 where they need not
    # Sinkhorn and Knopp (1967): scale to one margin, then to the other; the pixels' margin comes last and is exact
    pixels = np.empty(len(start) - 1)
    for n in range(len(pixels)):
        pixels[n] = share[start[n] : start[n + 1]].sum()
    for _ in range(ROUNDS):
        total = np.zeros(len(cells))
        for m in range(len(cell)):
            total[cell[m]] += share[m]
        for m in range(len(cell)):
            if cells[cell[m]] > 0:
                share[m] *= cells[cell[m]] / total[cell[m]]
        for n in range(len(pixels)):
            share[start[n] : start[n + 1]] *= pixels[n] / share[start[n] : start[n + 1]].sum()


def polar_from_fisheye(image: np.ndarray, weights: FisheyeToPolar) -> np.ndarray:
    """The polar map (rows, cols, 3) float32 of a fisheye image of radiance (height, width, 3) float32."""
    polar = _scattered(image.reshape(-1, 3), weights.pixel, weights.start, weights.cell, weights.weight, weights.rows * weights.cols)
    return polar.reshape(weights.rows, weights.cols, 3)


@njit(cache=True)
def _scattered(image, pixel, start, cell, weight, cells):
    polar = np.zeros((cells, 3), np.float32)
    for n in range(len(pixel)):
        r, g, b = image[pixel[n]]
        for m in range(start[n], start[n + 1]):
            w, at = weight[m], cell[m]
            polar[at, 0] += w * r
            polar[at, 1] += w * g
            polar[at, 2] += w * b
    return polar
