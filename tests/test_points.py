import numpy as np
import pytest
from scipy.spatial import KDTree

from services.sampler.points import RELAXED, halton, points, relaxed_halton


def test_halton_starts_as_written_down_by_hand():
    expected = [[1 / 2, 1 / 3], [1 / 4, 2 / 3], [3 / 4, 1 / 9], [1 / 8, 4 / 9], [5 / 8, 7 / 9], [3 / 8, 2 / 9]]
    np.testing.assert_allclose(halton(6), expected, atol=1e-15)


@pytest.mark.parametrize(("shorter", "longer"), [(1, 2), (72, 216), (216, 5000)])
@pytest.mark.parametrize("kind", ["relaxed", "halton"])
def test_a_longer_table_begins_with_the_shorter(shorter, longer, kind):
    np.testing.assert_array_equal(points(longer, kind)[:shorter], points(shorter, kind))


def test_points_lie_inside_the_square_and_apart():
    table = points(3000, "relaxed")
    assert ((table > 0) & (table < 1)).all()
    assert len(np.unique(table, axis=0)) == 3000


def test_points_cannot_be_changed_by_their_users():
    with pytest.raises(ValueError):
        points(10, "relaxed")[0, 0] = 0.0


def test_the_stored_table_is_what_the_relaxation_makes():
    made = relaxed_halton(RELAXED)
    np.testing.assert_allclose(points(RELAXED, "relaxed"), made, atol=1e-6)


def edge_error(table: np.ndarray) -> float:
    """RMS over random half-planes of the share of points in it less its area in the unit square (by a fine grid)."""
    generator = np.random.default_rng(1)
    angles, centres = generator.random(1000) * 2 * np.pi, generator.random((1000, 2))
    normals = np.stack([np.cos(angles), np.sin(angles)])
    fine = (np.arange(64) + 0.5) / 64
    grid = np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)
    offsets = (centres.T * normals).sum(axis=0)
    return float(np.sqrt(np.mean(((table @ normals > offsets).mean(axis=0) - (grid @ normals > offsets).mean(axis=0)) ** 2)))


@pytest.mark.parametrize("length", [16, 32, 64, 72, 128, 216, 300, 512])
def test_every_prefix_is_spread_more_evenly_than_haltons(length):
    # What shadows see is the number of points on either side of an edge: relaxed prefixes miss it by a fifth less.
    assert edge_error(points(length, "relaxed")) < edge_error(points(length, "halton"))


@pytest.mark.parametrize("length", [8, 16, 32, 64, 72, 100, 216, 300, 512])
def test_no_two_points_of_a_prefix_are_close(length):
    # In units of the hexagonal lattice's distance; 0.45 is the worst that the multi-prefix relaxation should leave.
    distance, _ = KDTree(points(length, "relaxed")).query(points(length, "relaxed"), k=2)
    assert distance[:, 1].min() / np.sqrt(2 / (np.sqrt(3) * length)) > 0.4
