"""Basis functions on a luminaire's sampling plane and their duals, the filters that a light field is measured with.

All functions are of one axis, in units of the spacing between neighbouring basis functions; a function of the plane is a product of two.
Both bases form a partition of unity and each function has integral 1, so a function of the plane has the integral `spacing^2`.
"""

from typing import Literal, NamedTuple

import numpy as np

BasisKind = Literal["bell", "b-spline"]
SUPPORT_CELLS: dict[BasisKind, int] = {"bell": 2, "b-spline": 3}  # width of a function's support, in spacings
_GAUSS = np.polynomial.legendre.leggauss(3)  # exact to degree 5; products of two quadratics have degree 4
SPAN_REACH = 24  # shifts to each side in a span dual: its coefficients fall as 0.156^k (bell) or 0.434^k, to 2e-9 of the first at k = 24


class Dual(NamedTuple):
    """The filter sum_k coefficients[k + reach] phi(x - k) for |x| <= half_width, 0 outside; reach = (len(coefficients) - 1) / 2."""

    basis_kind: BasisKind
    coefficients: np.ndarray
    half_width: float


def basis(kind: BasisKind, x: np.ndarray) -> np.ndarray:
    """phi(x), any shape. "bell": Granier et al. 2003, equation 6; "b-spline": the uniform quadratic B-spline."""
    a = np.abs(x)
    if kind == "bell":
        return np.where(a <= 0.5, 1 - 2 * a * a, np.where(a < 1, 2 * (1 - a) ** 2, 0.0))
    return np.where(a <= 0.5, 0.75 - a * a, np.where(a < 1.5, 0.5 * (1.5 - a) ** 2, 0.0))


def inner_product(kind: BasisKind, shift: int, low: float, high: float, other: int = 0) -> float:
    """Integral of phi(x - shift) phi(x - other) over [low, high], exact."""
    edges = np.unique(np.clip(np.arange(2 * np.floor(low), 2 * np.ceil(high) + 1) / 2, low, high))  # knots lie at multiples of 1/2
    centre, half = (edges[1:] + edges[:-1])[:, None] / 2, np.diff(edges)[:, None] / 2
    x = centre + half * _GAUSS[0]
    return float((basis(kind, x - shift) * basis(kind, x - other) * half * _GAUSS[1]).sum())


def gram_row(kind: BasisKind) -> np.ndarray:
    """Integrals of phi(x) phi(x - k) for k = 0, 1, 2: 23/30, 7/60, 0 (bell); 11/20, 13/60, 1/120 (b-spline)."""
    return np.array([inner_product(kind, k, -2, 2) for k in range(3)])


def span_dual(kind: BasisKind, reach: int = SPAN_REACH) -> Dual:
    """The dual within the span of the basis: infinitely wide, truncated after `reach` shifts.

    Its shifts add up to 1, so a measurement with it preserves the flux.
    """
    n = 256  # period of the discrete transform; any from 2 reach + 3 on does: what wraps round is 0.434^128 = 10^-46 here
    row = np.zeros(n)
    row[[0, 1, 2, -1, -2]] = gram_row(kind)[[0, 1, 2, 1, 2]]
    coefficients = np.fft.ifft(1 / np.fft.fft(row)).real
    return Dual(kind, coefficients[np.arange(-reach, reach + 1)], reach + SUPPORT_CELLS[kind] / 2)


def compact_dual(kind: BasisKind, width: float) -> Dual:
    """The dual of least norm on [-width / 2, width / 2], in spacings: 4 is the slide of Granier et al. 2003 (20 mm at 5 mm).

    Raises ValueError for a width below the support of the basis, where no dual exists.
    """
    half = width / 2
    if width < SUPPORT_CELLS[kind]:
        raise ValueError(f"a dual of the {kind} basis is at least {SUPPORT_CELLS[kind]} spacings wide, not {width:g}")
    reach = int(np.ceil(half + SUPPORT_CELLS[kind] / 2)) - 1  # the farthest shift that still overlaps
    shifts = range(-reach, reach + 1)
    gram = np.array([[inner_product(kind, k, -half, half, j) for k in shifts] for j in shifts])
    return Dual(kind, np.linalg.solve(gram, np.equal(shifts, 0).astype(float)), half)


def dual_value(dual: Dual, x: np.ndarray) -> np.ndarray:
    """The filter at x, any shape: the integral of dual(x) phi(x - k) is 1 for k = 0 and 0 for every other k."""
    reach = len(dual.coefficients) // 2
    nearest = np.rint(x)
    total = np.zeros(np.shape(x))
    for step in (-1, 0, 1):  # supports are at most 3 wide: all other shifts are 0 here
        k = nearest + step
        c = dual.coefficients[np.clip(k + reach, 0, 2 * reach).astype(np.int64)]
        total += np.where(np.abs(k) <= reach, c, 0.0) * basis(dual.basis_kind, x - k)
    return np.where(np.abs(x) <= dual.half_width, total, 0.0)
