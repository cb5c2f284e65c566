"""Solid angles that pixels and cells have in common."""

import msgspec
import numpy as np
import pytest

from vemlight.capture.fisheye import ALL_PIXELS, colour_lattices
from vemlight.capture.lens import Lens, direction_from_pixel, pixel_solid_angles
from vemlight.capture.pixel_overlap import Lattice, MapGrid, balance, pixel_overlaps, ray_table
from vemlight.light.sphere import cell_from_direction, rotation_xyz

TILT = tuple(tuple(map(float, row)) for row in rotation_xyz((25, -10, 40)))
UP = Lens(size=(120, 110), f=(32.0, 31.0), c=(59.3, 54.6), k1=-0.01, k2=0.001, k3=0.0, k4=0.0, rim_deg=95.0)
DECENTRED = msgspec.structs.replace(UP, p1=0.02, p2=-0.01, world_from_camera=TILT)
TILTED = msgspec.structs.replace(UP, world_from_camera=TILT)
ROWS, COLS, SPAN = 90, 360, np.pi


def found(lens: Lens, lattice: Lattice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return pixel_overlaps(pixel_solid_angles(lens), ray_table(lens), MapGrid(ROWS, COLS, SPAN), lattice)


@pytest.mark.parametrize("lens", [UP, TILTED, DECENTRED])
@pytest.mark.parametrize("lattice", [*ALL_PIXELS, *colour_lattices("RGGB")[1]])
def test_overlaps_of_a_pixel_add_up_to_it(lens: Lens, lattice: Lattice) -> None:
    pixel, _, overlap = found(lens, lattice)
    solid = pixel_solid_angles(lens)
    seen = np.zeros(solid.shape, bool)
    seen[lattice.first[1] :: lattice.step[1], lattice.first[0] :: lattice.step[0]] = True
    total = np.bincount(pixel, overlap, solid.size).reshape(solid.shape)
    np.testing.assert_allclose(total, np.where(seen, solid * lattice.size[0] * lattice.size[1], 0), rtol=1e-12)


@pytest.mark.parametrize("lens", [UP, TILTED, DECENTRED])
@pytest.mark.parametrize("lattice", [*ALL_PIXELS, colour_lattices("RGGB")[0][0]])
def test_overlaps_agree_with_many_rays(lens: Lens, lattice: Lattice) -> None:
    pixel, cell, overlap = found(lens, lattice)
    width = lens.size[0]
    side, rng = 48, np.random.default_rng(4)
    at = (np.arange(side) + 0.5) / side - 0.5
    # a few anywhere, and all that are near the zenith of the world
    zenith = cell_from_direction(direction_from_pixel(np.stack([np.unique(pixel) % width, np.unique(pixel) // width], -1), lens)
                                 @ lens.rotation.T, ROWS, COLS, "sphere")[0]
    near = np.unique(pixel)[zenith < 4]
    for p in [*rng.choice(pixel, 60), *near]:
        x, y = p % width + at * lattice.size[0], p // width + at * lattice.size[1]
        rays = direction_from_pixel(np.stack(np.meshgrid(x, y), -1), lens) @ lens.rotation.T
        row, col = cell_from_direction(rays, ROWS, COLS, "sphere")
        truth = np.bincount((row.astype(int) * COLS + np.minimum(col.astype(int), COLS - 1)).ravel(), minlength=ROWS * COLS) / side**2
        got = np.zeros(ROWS * COLS)
        got[cell[pixel == p]] = overlap[pixel == p] / overlap[pixel == p].sum()
        # an edge that runs along a line of the 8 x 8 subpixels moves 1/16 of the pixel from one side to the other
        assert np.abs(got - truth).max() < 1 / 14


def test_balance_keeps_pixels_and_fills_cells() -> None:
    pixel, cell, overlap = found(UP, ALL_PIXELS[0])
    before, cells = np.bincount(pixel, overlap), np.bincount(cell, overlap, ROWS * COLS)
    goal = np.where(cells > np.median(cells[cells > 0]), cells * 1.001, 0.0)  # 0: a cell that may have any sum
    balance(pixel, cell, overlap, goal)
    np.testing.assert_allclose(np.bincount(pixel, overlap), before, rtol=1e-12)
    assert overlap.min() > 0


def test_balance_of_what_is_balanced_changes_nothing() -> None:
    pixel, cell, overlap = found(TILTED, ALL_PIXELS[0])
    before = overlap.copy()
    balance(pixel, cell, overlap, np.bincount(cell, overlap, ROWS * COLS))
    np.testing.assert_allclose(overlap, before, rtol=1e-12)


def test_balance_of_nothing_is_nothing() -> None:
    none, overlap, goal = np.empty(0, np.int32), np.empty(0), np.zeros(4)
    balance(none, none, overlap, goal)
    assert len(overlap) == 0
    assert not goal.any()
