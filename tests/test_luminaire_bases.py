import numpy as np
import pytest

from vemlight.renderer.luminaire.bases import SUPPORT_CELLS, basis, compact_dual, dual_value, gram_row, inner_product, span_dual

KINDS = list(SUPPORT_CELLS)
X = np.linspace(-12, 12, 48_001)  # steps of 1/2000, which meet every knot


@pytest.mark.parametrize("kind", KINDS)
def test_a_basis_adds_up_to_1_and_has_integral_1(kind):
    # Lu et al. 2015 deny this of the 2003 basis; its equation 6 says otherwise
    inside = np.linspace(-0.5, 0.5, 1001)
    assert sum(basis(kind, inside - k) for k in range(-3, 4)) == pytest.approx(np.ones(1001), abs=1e-15)
    assert inner_product(kind, 0, -2, 2) < 1
    assert np.trapezoid(basis(kind, X), X) == pytest.approx(1, abs=1e-6)
    assert not basis(kind, X[np.abs(X) >= SUPPORT_CELLS[kind] / 2]).any()


def test_only_the_spline_reproduces_lines():
    inside = np.linspace(-0.5, 0.5, 1001)
    error = {kind: np.abs(sum(k * basis(kind, inside - k) for k in range(-3, 4)) - inside).max() for kind in KINDS}
    assert error["b-spline"] < 1e-15
    assert error["bell"] == pytest.approx(0.125, abs=1e-6)


@pytest.mark.parametrize(("kind", "row"), [("bell", [23 / 30, 7 / 60, 0]), ("b-spline", [11 / 20, 13 / 60, 1 / 120])])
def test_gram_rows_are_the_fractions_they_are(kind, row):
    assert gram_row(kind) == pytest.approx(np.array(row), abs=1e-15)


@pytest.mark.parametrize(("kind", "coefficients"), [
    ("bell", [1.36931, -0.21344, 0.03327, -0.00519]), ("b-spline", [2.84217, -1.32173, 0.57333, -0.24704]),
])
def test_span_duals_have_the_expected_coefficients(kind, coefficients):
    dual = span_dual(kind)
    middle = len(dual.coefficients) // 2
    assert dual.coefficients[middle : middle + 4] == pytest.approx(np.array(coefficients), abs=6e-6)  # five decimals
    assert sum(dual_value(dual, np.linspace(-0.5, 0.5, 101) - k) for k in range(-27, 28)) == pytest.approx(np.ones(101), abs=1e-7)


@pytest.mark.parametrize(("kind", "width"), [
    ("bell", None), ("b-spline", None), ("bell", 2), ("bell", 4), ("b-spline", 3), ("b-spline", 5),
])
def test_duals_are_biorthogonal_to_the_basis(kind, width):
    dual = compact_dual(kind, width) if width else span_dual(kind)
    value = dual_value(dual, X)
    got = [np.trapezoid(value * basis(kind, X - k), X) for k in range(-4, 5)]
    # trapezoids of 1/2000 err by the jump at the cut edges, up to 5.4 / 2 / 2000 = 1.4e-3
    assert np.array(got) == pytest.approx(np.equal(range(-4, 5), 0).astype(float), abs=2e-3)


@pytest.mark.parametrize(("kind", "width", "peak", "lowest", "negative_share"), [
    ("bell", 4, 1.371, -0.219, 0.206), ("bell", 2, 1.4375, -0.4375, 0.166),
    ("b-spline", 3, 2.20, -0.96, 0.48), ("b-spline", 5, 1.87, -0.72, 0.49),
])
def test_compact_duals_have_the_expected_shape(kind, width, peak, lowest, negative_share):
    x = np.linspace(-width / 2, width / 2, 20_001)
    value = dual_value(compact_dual(kind, width), x)
    assert (value.max(), value.min()) == pytest.approx((peak, lowest), abs=5e-3)
    assert -np.minimum(value, 0).sum() / np.maximum(value, 0).sum() == pytest.approx(negative_share, abs=5e-3)
    assert np.trapezoid(value, x) == pytest.approx(1, abs=1e-6)


def test_the_slide_of_2003_has_these_terms():
    assert compact_dual("bell", 4).coefficients == pytest.approx(np.array([0.0666, -0.2188, 1.3709, -0.2188, 0.0666]), abs=6e-5)


def test_clipping_the_negative_lobes_leaks_and_brightens():
    # why the positive and the negative part are measured apart
    clipped = np.maximum(dual_value(compact_dual("bell", 4), X), 0)
    assert np.trapezoid(clipped * basis("bell", X - 1), X) == pytest.approx(0.114, abs=1e-3)
    assert np.trapezoid(clipped, X) == pytest.approx(1.259, abs=1e-3)


def test_no_dual_is_narrower_than_its_basis():
    with pytest.raises(ValueError, match="at least 3 spacings"):
        compact_dual("b-spline", 2)
