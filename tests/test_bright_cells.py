import numpy as np
import pytest

from vemlight.light.bright_cells import NO_BRIGHT_CELLS, SUBCELLS, bright_cells_from_light
from vemlight.light.sphere import angle_between, cell_directions, cell_from_direction, direction_from_angles

ROWS, COLS = 90, 360


def light(n, seed=0):
    """Light from n directions in five cells, one beside phi = 0 and one at the zenith."""
    generator = np.random.default_rng(seed)
    cells = generator.choice([0, 5 * COLS, 30 * COLS + 359, 60 * COLS + 7, 89 * COLS + 200], n)
    theta = (cells // COLS + generator.random(n)) * np.pi / 2 / ROWS
    phi = (cells % COLS + generator.random(n)) * 2 * np.pi / COLS
    return cells, direction_from_angles(theta, phi), generator.lognormal(0, 1, n)


def test_samples_hold_all_light_and_its_moment():
    cells, directions, flux = light(400)
    found = bright_cells_from_light(cells, directions, flux, ROWS, COLS, "hemisphere")
    assert (np.diff(found.cells) >= 0).all()
    for cell in np.unique(cells):
        own, of = found.cells == cell, cells == cell
        assert 1 < own.sum() <= SUBCELLS**2
        np.testing.assert_allclose(found.weights[own].sum(), 1, rtol=1e-6)
        centre = found.weights[own] @ found.directions[own]
        truth = flux[of] @ directions[of] / flux[of].sum()
        assert np.degrees(np.linalg.norm(centre - truth)) < 1e-3  # a sample's direction has length 1; a sub-cell is a third of a degree


def test_each_sample_lies_in_a_subcell_of_its_own():
    cells, directions, flux = light(400, 1)
    found = bright_cells_from_light(cells, directions, flux, ROWS, COLS, "hemisphere")
    i, j = cell_from_direction(found.directions.astype(np.float64), ROWS, COLS, "hemisphere")
    assert ((i.astype(int) * COLS + j.astype(int)) == found.cells).all()
    places = np.column_stack([found.cells, (SUBCELLS * (i % 1)).astype(int), (SUBCELLS * (j % 1)).astype(int)])
    assert len(np.unique(places, axis=0)) == len(places)


def test_one_direction_is_one_sample_where_it_is():
    direction = direction_from_angles(np.radians([31.9]), np.radians([0.2]))
    found = bright_cells_from_light(np.array([31 * COLS]), direction, np.array([3.0]), ROWS, COLS, "hemisphere")
    assert found.cells.tolist() == [31 * COLS]
    assert found.weights.tolist() == [1.0]
    assert np.degrees(angle_between(found.directions.astype(np.float64), direction)).max() < 1e-4


@pytest.mark.parametrize("phi", [-0.3, 0.3])
def test_a_pixel_that_reaches_into_a_cell_counts_for_its_nearest_subcell(phi):
    direction = direction_from_angles(np.radians([30.4]), np.radians([phi]))
    cell = 31 * COLS + (359 if phi > 0 else 0)  # one row down, one column beside, across phi = 0
    inside = direction_from_angles(np.radians([31.8]), np.radians([0.1 if phi < 0 else 359.9]))
    found = bright_cells_from_light(np.full(2, cell), np.concatenate([direction, inside]), np.ones(2), ROWS, COLS, "hemisphere")
    assert len(found.cells) == 2
    centre = cell_directions(ROWS, COLS, "hemisphere").reshape(-1, 3)[cell]
    assert np.degrees(angle_between(found.directions.astype(np.float64), centre)).max() < 2


def test_darkness_and_invalid_pixels_give_no_sample():
    cells, directions, flux = light(50, 2)
    flux[:10] = [np.nan, np.inf, -1, 0, 0, 0, -np.inf, 0, 0, 0]
    found = bright_cells_from_light(cells, directions, flux, ROWS, COLS, "hemisphere")
    expected = bright_cells_from_light(cells[10:], directions[10:], flux[10:], ROWS, COLS, "hemisphere")
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)
    dark = bright_cells_from_light(cells, directions, np.zeros(50), ROWS, COLS, "hemisphere")
    assert [part.shape for part in dark] == [part.shape for part in NO_BRIGHT_CELLS]


def test_an_evenly_lit_cell_has_nine_samples():
    grid = (np.arange(30) + 0.5) / 30
    theta, phi = np.meshgrid(np.radians(30 + grid), np.radians(7 + grid), indexing="ij")
    directions = direction_from_angles(theta.ravel(), phi.ravel())
    found = bright_cells_from_light(np.full(900, 30 * COLS + 7), directions, np.ones(900), ROWS, COLS, "hemisphere")
    assert found.weights == pytest.approx(np.full(9, 1 / 9))


@pytest.mark.parametrize(("column", "phi_deg"), [(0, -0.001), (359, 360.001)])
def test_light_across_the_seam_counts_for_the_sub_cells_next_to_it(column, phi_deg):
    """With as much light inside the nearest third of the cell, both make one sample."""
    inside = 0.1 if column == 0 else 359.9
    directions = direction_from_angles(np.radians([30.1, 30.1]), np.radians([phi_deg, inside]))
    found = bright_cells_from_light(np.full(2, 30 * COLS + column), directions, np.ones(2), ROWS, COLS, "hemisphere")
    assert found.weights.tolist() == [1.0]
