"""Fisheye images resampled to the polar map: each pixel's light is handed to the cells that it overlaps, so that none is lost.

The weight of pixel p in cell c is the solid angle they share over the cell's.

A Bayer mosaic is not demosaiced: the pixels of each colour stand for the ground between them, and have weights of their own.
"""

import itertools
from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from vemlight.capture.lens import (
    Lens,
    angles_from_radii,
    direction_from_pixel,
    pixel_angles,
    pixel_from_direction,
    pixel_solid_angles,
    radius_from_angle,
    slope_from_angle,
    vignetting_from_angle,
)
from vemlight.capture.pixel_overlap import LOOKUP, balance, shares
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells, bright_cells_from_light
from vemlight.light.sphere import SPAN, Coverage, angles_from_direction, cell_solid_angles, direction_from_angles

Bayer = Literal["RGGB", "BGGR", "GRBG", "GBRG"]  # colours of the first two pixels of the first two rows
PARTS = 8  # of the map, each some threads' own: as many threads as can share the work
LANES = 16  # neighbours meet in one cell, and adding to it waits for the addition before: the loop takes turns at so many places


class Lattice(NamedTuple):
    """Pixels of one kind: every `step`-th from `first` on, along x and y, each standing for `size` pixels around its centre."""

    first: tuple[int, int]
    step: tuple[int, int]
    size: tuple[int, int]


ALL = (Lattice((0, 0), (1, 1), (1, 1)),)


class FisheyeToPolar(NamedTuple):
    """Weights from a fisheye image to a polar map: pixel[m] gives weight[m] times its value to cell[m].

    The map lies in PARTS, rows after rows; part p is all that ends[p] <= m < ends[p + 1] adds to, and nothing else does. Within a part the
    order is that of LANES pieces in turns.
    """

    shape: tuple[int, int]  # of the image
    rows: int
    cols: int
    pixel: np.ndarray  # (m,) uint32, index into the flat image
    cell: np.ndarray  # (m,) uint16 or uint32, index into the flat map
    weight: np.ndarray  # (m,) float32, shared solid angle / the cell's, over vignetting and flat field
    ends: np.ndarray  # (PARTS + 1,) int64
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
    angles = angles_from_radii(np.linspace(0, reach, LOOKUP), lens.k, lens.rim)
    found = [shares(solid, f, c, angles, reach, lens.rotation, rows, cols, SPAN[coverage], *lattice) for lattice in lattices]
    pixel, cell, share = map(np.concatenate, zip(*found, strict=True))
    cells = np.repeat(cell_solid_angles(rows, cols, coverage), cols)
    balance(pixel, cell, share, np.where(_seen_whole(lens, rows, cols, coverage).ravel(), cells, 0.0))
    own = vignetting_from_angle(np.minimum(pixel_angles(lens), lens.rim), lens) if flat_field is None else flat_field
    weight = (share / cells[cell] / own.ravel()[pixel]).astype(np.float32)
    order, ends = _in_turns(cell, rows * cols)
    cell = cell[order].astype(np.uint16 if rows * cols <= 2**16 else np.uint32)  # what is read most is best small
    by_cell = np.argsort(cell, kind="stable").astype(np.int32)
    start = np.searchsorted(cell[by_cell], np.arange(rows * cols + 1)).astype(np.int32)
    return FisheyeToPolar(solid.shape, rows, cols, pixel[order].astype(np.uint32), cell, weight[order], ends, by_cell, start)


def _in_turns(cell: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray]:
    # the order that FisheyeToPolar has, and its ends; parts are of about as many entries each
    heavy = np.cumsum(np.bincount(cell, minlength=cells))
    part = np.minimum((heavy - 1) * PARTS // max(len(cell), 1), PARTS - 1).astype(np.uint8)[cell]
    sorted_by_part = np.argsort(part, kind="stable")
    ends = np.concatenate([[0], np.cumsum(np.bincount(part, minlength=PARTS))])
    pieces = []
    for begin, end in itertools.pairwise(ends):
        even = begin + (end - begin) // LANES * LANES
        pieces += [sorted_by_part[begin:even].reshape(LANES, -1).T.ravel(), sorted_by_part[even:end]]
    return np.concatenate(pieces), ends


def _seen_whole(lens: Lens, rows: int, cols: int, coverage: Coverage) -> np.ndarray:
    # cells whose corners lie at least a pixel inside the rim, (rows, cols) bool
    theta = np.linspace(0, SPAN[coverage], rows + 1)[:, None]
    corners = direction_from_angles(theta, np.linspace(0, 2 * np.pi, cols + 1)) @ lens.rotation
    off_axis, _ = angles_from_direction(corners)
    inside = off_axis < lens.rim - 2.5 / (min(lens.f) * slope_from_angle(np.array(lens.rim), lens))
    pixels = pixel_from_direction(corners, lens)
    inside &= np.all((pixels > 1) & (pixels < np.array(lens.size) - 2), axis=-1)
    return inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]


def lit_spans(weights: FisheyeToPolar) -> np.ndarray:
    """(height, 2) int64: in each row of the image, the first pixel that sees part of the map, and one past the last."""
    seen = np.zeros(weights.shape, bool)
    seen.ravel()[weights.pixel] = True
    lit = seen.any(axis=1)
    first, last = seen.argmax(axis=1), weights.shape[1] - seen[:, ::-1].argmax(axis=1)
    return np.column_stack([np.where(lit, first, 0), np.where(lit, last, 0)])


def fisheye_bright_cells(
    brightness: Callable[[np.ndarray], np.ndarray], weights: FisheyeToPolar, lens: Lens, cells: np.ndarray, coverage: Coverage
) -> BrightCells:
    """Where light sits inside each of the map's `cells` (n,), flat indices.

    `brightness`: luminance of the image's pixels (m,) int64, flat indices, some of which must be lit in each cell.
    """
    if not len(cells):
        return NO_BRIGHT_CELLS
    entries = [weights.by_cell[weights.start[c] : weights.start[c + 1]] for c in cells]
    each = np.concatenate(entries)
    pixel = weights.pixel[each].astype(np.int64)
    flux = (weights.weight[each] * brightness(pixel)).astype(np.float64)
    at = np.column_stack([pixel % weights.shape[1], pixel // weights.shape[1]])
    owner = np.repeat(cells.astype(np.int64), [len(part) for part in entries])
    return bright_cells_from_light(owner, direction_from_pixel(at, lens) @ lens.rotation.T, flux, weights.rows, weights.cols, coverage)
