"""Weights that resample fisheye images to the polar map: each pixel's light goes to the cells that it overlaps, so that none is lost.

The weight of pixel p in cell c is their common solid angle over the cell's.

A Bayer mosaic is not demosaiced: the pixels of each colour represent the area between them, and have weights of their own.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np

from vemlight.capture.lens import (
    Lens,
    pixel_angles,
    pixel_from_direction,
    pixel_solid_angles,
    slope_from_angle,
    vignetting_from_angle,
)
from vemlight.capture.pixel_overlap import Lattice, MapGrid, balance, pixel_overlaps, ray_table
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells, bright_cells_from_light
from vemlight.light.sphere import SPAN, Coverage, angles_from_direction, cell_solid_angles, direction_from_angles

BayerPattern = Literal["RGGB", "BGGR", "GRBG", "GBRG"]  # colours of the first two pixels of the first two rows
MAP_PARTS = 8  # rows of the map that one thread adds to at a time: [capture] threads may be as many
LANES = 16  # neighbouring pixels meet in one cell and each addition waits for the one before, so the loop alternates between so many places
WHOLE_MARGIN_PX = 2.5  # inside the rim, for a cell to count as seen whole: a pixel of the mosaic reaches 1.4 from its centre; 1.5 to 4 do
ALL_PIXELS = (Lattice((0, 0), (1, 1), (1, 1)),)


class FisheyeToPolar(NamedTuple):
    """Weights from a fisheye image to a polar map: pixel[m] adds weight[m] times its value to cell[m].

    The map is divided into MAP_PARTS, rows after rows; only ends[p] <= m < ends[p + 1] add to part p. Within a part the entries are
    interleaved from LANES pieces of it.
    """

    shape: tuple[int, int]  # of the image
    rows: int
    cols: int
    pixel: np.ndarray  # (m,) uint32, index into the flat image
    cell: np.ndarray  # (m,) uint16 or uint32, index into the flat map
    weight: np.ndarray  # (m,) float32, common solid angle over the cell's, divided by vignetting or flat field
    ends: np.ndarray  # (MAP_PARTS + 1,) int64
    by_cell: np.ndarray  # (m,) int32, the order that sorts `cell`
    start: np.ndarray  # (rows * cols + 1,) int32: cell c has by_cell[start[c] : start[c + 1]]


def colour_lattices(pattern: BayerPattern) -> tuple[tuple[Lattice, ...], tuple[Lattice, ...], tuple[Lattice, ...]]:
    """The red, green and blue pixels of a mosaic. A red or blue pixel represents 2 x 2 pixels, a green one 2 x 1."""
    positions = {colour: [(n % 2, n // 2) for n in range(4) if pattern[n] == colour] for colour in "RGB"}
    sizes = {"R": (2, 2), "G": (2, 1), "B": (2, 2)}
    red, green, blue = (tuple(Lattice(first, (2, 2), sizes[colour]) for first in positions[colour]) for colour in "RGB")
    return red, green, blue


class Contributions(NamedTuple):
    """What pixels give to cells, in any order: weight[m] times the value of pixel[m] goes to cell[m]."""

    pixel: np.ndarray  # (m,) index into the flat image
    cell: np.ndarray  # (m,) index into the flat map
    weight: np.ndarray  # (m,) float, common solid angle over the cell's, divided by the pixel's sensitivity


def fisheye_to_polar(
    lens: Lens,
    rows: int,
    cols: int,
    coverage: Coverage,
    lattices: tuple[Lattice, ...] = ALL_PIXELS,
    flat_field: np.ndarray | None = None,
) -> FisheyeToPolar:
    """Weights for the pixels of `lattices` in images of `lens`.

    `flat_field` (height, width): each pixel's response to even light relative to the axis, instead of the lens file's vignetting.
    """
    contributions = fisheye_contributions(lens, rows, cols, coverage, lattices, flat_field)
    return weights_from_contributions((lens.size[1], lens.size[0]), rows, cols, contributions)


def fisheye_contributions(
    lens: Lens, rows: int, cols: int, coverage: Coverage, lattices: tuple[Lattice, ...], flat_field: np.ndarray | None
) -> Contributions:
    """What the pixels of one lens give to the map; see `fisheye_to_polar`."""
    solid, rays, grid = pixel_solid_angles(lens), ray_table(lens), MapGrid(rows, cols, float(SPAN[coverage]))
    of_lattices = [pixel_overlaps(solid, rays, grid, lattice) for lattice in lattices]
    pixel, cell, overlap = map(np.concatenate, zip(*of_lattices, strict=True))
    cell_solid = np.repeat(cell_solid_angles(rows, cols, coverage), cols)
    balance(pixel, cell, overlap, np.where(_seen_whole(lens, rows, cols, coverage).ravel(), cell_solid, 0.0))
    sensitivity = vignetting_from_angle(np.minimum(pixel_angles(lens), lens.rim), lens) if flat_field is None else flat_field
    return Contributions(pixel, cell, (overlap / cell_solid[cell] / sensitivity.ravel()[pixel]).astype(np.float32))


def weights_from_contributions(shape: tuple[int, int], rows: int, cols: int, contributions: Contributions) -> FisheyeToPolar:
    """The contributions in the order in which the loops add them; shape: height, width of the image."""
    pixel, cell, weight = contributions
    order, ends = _interleaved(cell, rows * cols)
    cell = cell[order].astype(np.uint16 if rows * cols <= 2**16 else np.uint32)  # memory bandwidth limits the loop over them
    by_cell = np.argsort(cell, kind="stable").astype(np.int32)
    start = np.searchsorted(cell[by_cell], np.arange(rows * cols + 1)).astype(np.int32)
    return FisheyeToPolar(shape, rows, cols, pixel[order].astype(np.uint32), cell, weight[order].astype(np.float32), ends, by_cell, start)


def _interleaved(cell: np.ndarray, cells: int) -> tuple[np.ndarray, np.ndarray]:
    # the order of FisheyeToPolar's entries, and its `ends`; parts have about equally many entries
    cumulative = np.cumsum(np.bincount(cell, minlength=cells))
    part = np.minimum((cumulative - 1) * MAP_PARTS // max(len(cell), 1), MAP_PARTS - 1).astype(np.uint8)[cell]
    sorted_by_part = np.argsort(part, kind="stable")
    ends = np.concatenate([[0], np.cumsum(np.bincount(part, minlength=MAP_PARTS))])
    pieces = []
    for begin, end in itertools.pairwise(ends):
        even = begin + (end - begin) // LANES * LANES
        pieces += [sorted_by_part[begin:even].reshape(LANES, -1).T.ravel(), sorted_by_part[even:end]]
    return np.concatenate(pieces), ends


def _seen_whole(lens: Lens, rows: int, cols: int, coverage: Coverage) -> np.ndarray:
    # cells whose corners lie at least WHOLE_MARGIN_PX inside the rim and a pixel inside the image, (rows, cols) bool
    theta = np.linspace(0, SPAN[coverage], rows + 1)[:, None]
    corners = direction_from_angles(theta, np.linspace(0, 2 * np.pi, cols + 1)) @ lens.rotation
    off_axis, _ = angles_from_direction(corners)
    inside = off_axis < lens.rim - WHOLE_MARGIN_PX / (min(lens.f) * slope_from_angle(np.array(lens.rim), lens))
    pixels = pixel_from_direction(corners, lens)
    inside &= np.all((pixels > 1) & (pixels < np.array(lens.size) - 2), axis=-1)
    return inside[:-1, :-1] & inside[1:, :-1] & inside[:-1, 1:] & inside[1:, 1:]


def _lit(weights: Sequence[FisheyeToPolar]) -> np.ndarray:
    """Which pixels see part of the map with any of the weights, such as those of a mosaic's colours, (height, width) bool."""
    lit = np.zeros(weights[0].shape, bool)
    for each in weights:
        lit.ravel()[each.pixel] = True
    return lit


def lit_spans(weights: Sequence[FisheyeToPolar]) -> np.ndarray:
    """(height, 2) int64: in each row of the image the first pixel that sees part of the map, and one past the last."""
    lit = _lit(weights)
    any_lit = lit.any(axis=1)
    first, last = lit.argmax(axis=1), lit.shape[1] - lit[:, ::-1].argmax(axis=1)
    return np.column_stack([np.where(any_lit, first, 0), np.where(any_lit, last, 0)])


def lit_runs(weights: Sequence[FisheyeToPolar]) -> np.ndarray:
    """(m, 3) int64: the pixels that see part of the map and no others: row, first column and one past the last of each run of them."""
    edges = np.diff(np.pad(_lit(weights), ((0, 0), (1, 1))).astype(np.int8), axis=1)
    rows, first = np.nonzero(edges > 0)
    return np.column_stack([rows, first, np.nonzero(edges < 0)[1]]).astype(np.int64)


def fisheye_bright_cells(
    brightness: Callable[[np.ndarray], np.ndarray],
    weights: FisheyeToPolar,
    directions: Callable[[np.ndarray], np.ndarray],
    cells: np.ndarray,
    coverage: Coverage,
) -> BrightCells:
    """Where light lies inside each of the map's `cells` (n,), flat indices.

    `brightness`: luminance of the image's pixels (m,) int64, flat indices; each cell needs some that are lit. `directions`: unit vectors
    (m, 3), in the world, of pixel coordinates (m, 2).
    """
    if not len(cells):
        return NO_BRIGHT_CELLS
    entries = [weights.by_cell[weights.start[c] : weights.start[c + 1]] for c in cells]
    joined = np.concatenate(entries)
    pixel = weights.pixel[joined].astype(np.int64)
    flux = (weights.weight[joined] * brightness(pixel)).astype(np.float64)
    position = np.column_stack([pixel % weights.shape[1], pixel // weights.shape[1]])
    owner = np.repeat(cells.astype(np.int64), [len(entry) for entry in entries])
    return bright_cells_from_light(owner, directions(position), flux, weights.rows, weights.cols, coverage)
