import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.sampler.square import area_from_direction, direction_from_area, disc_from_square, last_at_most, square_from_disc

unit = st.floats(0, 1)


@given(unit, unit)
def test_square_to_disc_and_back(u, v):
    a, w = disc_from_square(u, v)
    assert 0 <= a <= 1
    assert 0 <= w < 1
    np.testing.assert_allclose(square_from_disc(a, w), (u, v), atol=1e-15)


def test_centre_edges_and_quarters():
    assert disc_from_square(0.5, 0.5) == (0.0, 0.0)
    for corner in ((0, 0), (0, 1), (1, 0), (1, 1), (0, 0.3), (1, 0.6), (0.2, 0), (0.7, 1)):
        assert disc_from_square(*corner)[0] == 1
    # To the right is azimuth 0, up a quarter turn, left a half, down three quarters.
    assert [disc_from_square(*p)[1] for p in ((1, 0.5), (0.5, 1), (0, 0.5), (0.5, 0))] == pytest.approx([0, 0.25, 0.5, 0.75])


def test_areas_are_kept():
    # du dv = da dw: the determinant of the Jacobian is 1 everywhere inside the four triangles.
    step = 1e-6
    for u, v in np.random.default_rng(2).random((200, 2)):
        if min(abs(u - v), abs(u + v - 1)) < 1e-3:
            continue
        a, w = np.array([disc_from_square(*p) for p in ((u + step, v), (u - step, v), (u, v + step), (u, v - step))]).T
        dw = (w[[0, 2]] - w[[1, 3]] + 0.5) % 1 - 0.5
        da = a[[0, 2]] - a[[1, 3]]
        assert abs(da[0] * dw[1] - da[1] * dw[0]) / (2 * step) ** 2 == pytest.approx(1, abs=1e-6)


@given(st.floats(0, 2), st.floats(0, 2 * np.pi, exclude_max=True))
def test_direction_to_area_and_back(a, phi):
    x, y, z = direction_from_area(a, phi)
    assert x * x + y * y + z * z == pytest.approx(1, abs=1e-14)
    back, azimuth = area_from_direction(x, y, z)
    assert back == pytest.approx(a, rel=1e-12, abs=3e-16)
    if 1e-12 < a < 2 - 1e-3:
        assert np.cos(azimuth - phi) == pytest.approx(1, abs=1e-14)


def test_the_azimuth_stays_below_a_full_turn():
    assert area_from_direction(1.0, -1e-20, 0.0)[1] == 0.0


def test_last_at_most_never_leaves_the_table():
    table = np.array([0.0, 1.0, 1.0, 3.0])
    assert [last_at_most(table, x) for x in (-1, 0, 0.5, 1, 2.9, 3, 9)] == [0, 0, 0, 2, 2, 2, 2]
