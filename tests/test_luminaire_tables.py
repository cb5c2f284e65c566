import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st
from scipy.stats import chi2

from tests.support.light_fields import lobed_field
from vemlight.renderer.luminaire.reference import Box, mean_over_box
from vemlight.renderer.luminaire.tables import (
    AxisBox,
    PixelAxis,
    axis_box,
    column_at,
    mean_importance,
    sample_box,
    summed_area_tables,
    table_at,
)


def axes(box: Box) -> tuple[AxisBox, AxisBox]:
    """The box along u and v; where it lies on U does not matter here."""
    return AxisBox(box[0], box[1], 0.0, 1.0), AxisBox(box[2], box[3], 0.0, 1.0)


def inverted(sums: np.ndarray, box: Box, x: float, y: float) -> tuple[float, float]:
    """The uniform numbers that make `sample_box` choose x and y of a box with extent."""
    x0, x1, y0, y1 = box
    x, y = x0 + x * (x1 - x0), y0 + y * (y1 - y0)
    base = table_at(sums, y1, x0) - table_at(sums, y0, x0)
    a = (table_at(sums, y1, x) - table_at(sums, y0, x) - base) / (table_at(sums, y1, x1) - table_at(sums, y0, x1) - base)
    i = min(int(x), sums.shape[1] - 2)
    base = column_at(sums, i, y0)
    return a, (column_at(sums, i, y) - base) / (column_at(sums, i, y1) - base)


def test_a_box_is_the_sum_of_its_pixels():
    tables, rng = summed_area_tables(lobed_field("bell", 2.0)), np.random.default_rng(3)
    for _ in range(200):
        x0, x1, y0, y1 = *np.sort(rng.uniform(0, 24, 2)), *np.sort(rng.uniform(0, 24, 2))
        if rng.random() < 0.3:  # a point on a corner of pixels, or next to it
            x0, y0 = np.rint(x0) - 1e-9 * rng.random(), np.rint(y0) - 1e-9 * rng.random()
            x0, y0, x1, y1 = max(x0, 0.0), max(y0, 0.0), x0 + 1e-9, y0 + 1e-9
        elif rng.random() < 0.5:
            x1, y1 = min(x0 + 10.0 ** rng.uniform(-9, 0), 24), min(y0 + 10.0 ** rng.uniform(-9, 0), 24)
        plain = mean_over_box(np.repeat(tables.importance[3][..., None], 3, axis=2), (x0, x1, y0, y1))[0]
        assert mean_importance(tables.sums[3], tables.importance[3], *axes((x0, x1, y0, y1))) == pytest.approx(plain, rel=1e-6)


@pytest.mark.parametrize("box", [(3.3, 17.8, 5.1, 20.4), (3.3, 4.7, 5.1, 5.6), (3.3, 9.9, 5.1, 5.6), (0.0, 24.0, 0.0, 24.0)])
def test_samples_of_a_box_have_its_density(box):
    """Chi-square over pixels; the printed marginal of equation 8, the whole image's cut to the box, fails where they are no products."""
    tables, rng = summed_area_tables(lobed_field("bell", 1.5)), np.random.default_rng(5)
    sums, importance = tables.sums[7], tables.importance[7]
    counts = np.zeros((24, 24))
    n = 20_000
    u, v = axes(box)
    for a, b in rng.random((n, 2)):
        x, y, row, column = sample_box(sums, importance, u, v, a, b)
        assert 0 <= x <= 1
        assert 0 <= y <= 1
        counts[row, column] += 1
    overlap = [np.clip(np.minimum(high, np.arange(24) + 1) - np.maximum(low, np.arange(24)), 0, None) for low, high in (box[2:], box[:2])]
    density = importance / mean_importance(sums, importance, u, v)
    expected = n * overlap[0][:, None] * overlap[1] * density / ((box[1] - box[0]) * (box[3] - box[2]))
    assert expected.sum() == pytest.approx(n, rel=1e-9)
    cells = expected >= 5
    assert counts[expected == 0].sum() == 0
    statistic = ((counts - expected)[cells] ** 2 / expected[cells]).sum()
    assert chi2.sf(statistic, cells.sum() - 1) > 1e-3
    if cells.sum() > 100 and overlap[0].min() == 0:
        whole = overlap[1] * importance.sum(axis=0)
        rows = overlap[0][:, None] * importance
        printed = n * whole / whole.sum() * rows / rows.sum(axis=0)
        assert chi2.sf(((printed - expected)[cells] ** 2 / expected[cells]).sum(), cells.sum() - 1) < 1e-6


@given(st.floats(0.001, 0.999), st.floats(0.001, 0.999))
@example_settings(max_examples=60)
def test_inverting_a_sample_brings_the_numbers_back(a, b):
    tables = summed_area_tables(lobed_field("bell", 1.0))
    box = (3.3, 17.8, 5.1, 20.4)
    drawn = sample_box(tables.sums[7], tables.importance[7], *axes(box), a, b)
    assert inverted(tables.sums[7], box, drawn.x, drawn.y) == pytest.approx((a, b), abs=1e-9)


def test_a_dark_pixel_is_never_drawn():
    field = lobed_field()
    field.images[:, :, :, 5:9] = 0
    field.images[:, :, 10:12] = 0
    tables, rng = summed_area_tables(field), np.random.default_rng(5)
    for a, b in [*rng.random((2000, 2)), (0.0, 0.0), (1 - 2**-53, 1 - 2**-53)]:
        for box in ((0.0, 24.0, 0.0, 24.0), (8.5, 9.5, 9.2, 10.7), (4.0, 20.0, 9.0, 13.0)):
            drawn = sample_box(tables.sums[7], tables.importance[7], *axes(box), a, b)
            assert tables.importance[7, drawn.row, drawn.column] > 0


@given(p=st.floats(-2, 2), z=st.floats(1e-3, 5), low=st.floats(-1, 1))
@example_settings(max_examples=200)
def test_points_of_the_support_are_seen_through_the_box(p, z, low):
    """Between the planes, where Delta is negative, the box is mirrored; the printed |Delta| gives another box."""
    x0, x1, u0, u1 = axis_box(low, low + 0.1, p, 0.4 / z, PixelAxis(-0.5, 0.05, 20))
    for u in np.linspace(low, low + 0.1, 7):
        x = (u + 0.4 / z * (p - u) + 0.5) / 0.05
        if 0 < x < 20:
            assert x0 - 1e-9 <= x <= x1 + 1e-9
            assert min(u0, u1) - 1e-9 <= u <= max(u0, u1) + 1e-9
            if x1 - x0 > 1e-6:
                assert u0 + (u1 - u0) * (x - x0) / (x1 - x0) == pytest.approx(u, abs=1e-6)


def test_table_corners_are_totals():
    tables = summed_area_tables(lobed_field())
    assert table_at(tables.sums[0], 24.0, 24.0) == pytest.approx(tables.importance[0].sum())
    assert table_at(tables.sums[0], 0.0, 24.0) == 0
