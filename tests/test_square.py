import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vemlight.sampler.warps.square import (
    BLOCK,
    area_from_direction,
    cosine_and_sine,
    direction_from_area,
    disc_from_square,
    last_at_most,
    load_cells,
    square_from_disc,
)

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


@given(st.floats(0, 2), st.floats(0, 1, exclude_max=True))
def test_direction_to_area_and_back(a, w):
    x, y, z = direction_from_area(a, w)
    assert x * x + y * y + z * z == pytest.approx(1, abs=1e-14)
    back, turn = area_from_direction(x, y, z)
    assert back == pytest.approx(a, rel=1e-12, abs=3e-16)
    if 1e-12 < a < 2 - 1e-3:
        assert np.cos(2 * np.pi * (turn - w)) == pytest.approx(1, abs=1e-14)


@given(st.floats(-2, 2))
def test_cosine_and_sine_are_those_of_the_library(w):
    # 3e-16: two roundings of the angle within an eighth of a turn, and one of the sum; the library's own argument 2 pi w has one more.
    cosine, sine = cosine_and_sine(w)
    quarter = np.rint(4 * w)
    angle = (4 * w - quarter) * np.pi / 2
    expected = np.exp(1j * angle) * (1, 1j, -1, -1j)[int(quarter) % 4]
    assert cosine == pytest.approx(expected.real, abs=3e-16)
    assert sine == pytest.approx(expected.imag, abs=3e-16)


def test_quarters_of_a_turn_are_exact():
    assert [cosine_and_sine(w) for w in (0.0, 0.25, 0.5, 0.75, 1.0)] == [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 0)]


@pytest.mark.parametrize("count", [1, 63, 64, 65, 200])
def test_a_block_of_searches_finds_what_each_of_them_does(count):
    generator = np.random.default_rng(count)
    table = np.sort(generator.integers(0, 50, count + 1)).astype(float)
    x, cells = generator.uniform(-1, 51, BLOCK), np.full(BLOCK, 99, np.uint64)
    load_cells(table, x, cells, 40)
    assert cells[:40].tolist() == [last_at_most(table, one) for one in x[:40]]
    assert (cells[40:] == 99).all()


def test_the_azimuth_stays_below_a_full_turn():
    assert area_from_direction(1.0, -1e-20, 0.0)[1] == 0.0


def test_last_at_most_never_leaves_the_table():
    table = np.array([0.0, 1.0, 1.0, 3.0])
    assert [last_at_most(table, x) for x in (-1, 0, 0.5, 1, 2.9, 3, 9)] == [0, 0, 0, 2, 2, 2, 2]
