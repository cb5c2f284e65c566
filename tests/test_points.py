import numpy as np
import pytest

from services.sampler.points import halton, points


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
