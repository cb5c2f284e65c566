"""Correlated colour temperature and Duv of light: the nearest point of the Planckian locus in CIE 1960 u, v.

References: CIE 15:2018, 9.5 (correlated colour temperature) and table 1 (CIE 1931 standard observer); Ohno, "Practical use and calculation
of CCT and Duv", Leukos 10 (2014), whose sign of Duv it has: above 0 is greenish, below 0 pinkish.
"""

from functools import cache

import numpy as np

from vemlight.light.primaries import REC709, xyz_from_primaries

C2_M_K = 1.438776877e-2  # second radiation constant, h c / k
LOWEST_K, HIGHEST_K = 1000.0, 100_000.0  # beyond them a small error of u, v is a large one of the temperature
FARTHEST_DUV = 0.05  # CIE 15: farther from the locus a colour has no correlated temperature
MIREDS = np.arange(1e6 / HIGHEST_K, 1e6 / LOWEST_K + 0.5, 1.0)  # of the locus's points; a chord of 1 mired departs from it by 1e-7
# CIE 1931 x, y, z from 380 to 780 nm, every 5 nm; sums over them give u, v of the locus to 2e-6.
OBSERVER = np.fromstring(
    """
    0.001368 3.9e-05 0.00645  0.002236 6.4e-05 0.01055  0.004243 0.00012 0.02005
    0.00765 0.000217 0.03621  0.01431 0.000396 0.06785  0.02319 0.00064 0.1102
    0.04351 0.00121 0.2074  0.07763 0.00218 0.3713  0.13438 0.004 0.6456
    0.21477 0.0073 1.03905  0.2839 0.0116 1.3856  0.3285 0.01684 1.62296
    0.34828 0.023 1.74706  0.34806 0.0298 1.7826  0.3362 0.038 1.77211
    0.3187 0.048 1.7441  0.2908 0.06 1.6692  0.2511 0.0739 1.5281
    0.19536 0.09098 1.28764  0.1421 0.1126 1.0419  0.09564 0.13902 0.81295
    0.05795 0.1693 0.6162  0.03201 0.20802 0.46518  0.0147 0.2586 0.3533
    0.0049 0.323 0.272  0.0024 0.4073 0.2123  0.0093 0.503 0.1582
    0.0291 0.6082 0.1117  0.06327 0.71 0.07825  0.1096 0.7932 0.05725
    0.1655 0.862 0.04216  0.22575 0.91485 0.02984  0.2904 0.954 0.0203
    0.3597 0.9803 0.0134  0.43345 0.99495 0.00875  0.51205 1 0.00575
    0.5945 0.995 0.0039  0.6784 0.9786 0.00275  0.7621 0.952 0.0021
    0.8425 0.9154 0.0018  0.9163 0.87 0.00165  0.9786 0.8163 0.0014
    1.0263 0.757 0.0011  1.0567 0.6949 0.001  1.0622 0.631 0.0008
    1.0456 0.5668 0.0006  1.0026 0.503 0.00034  0.9384 0.4412 0.00024
    0.85445 0.381 0.00019  0.7514 0.321 0.0001  0.6424 0.265 5e-05
    0.5419 0.217 3e-05  0.4479 0.175 2e-05  0.3608 0.1382 1e-05
    0.2835 0.107 0  0.2187 0.0816 0  0.1649 0.061 0
    0.1212 0.04458 0  0.0874 0.032 0  0.0636 0.0232 0
    0.04677 0.017 0  0.0329 0.01192 0  0.0227 0.00821 0
    0.01584 0.005723 0  0.011359 0.004102 0  0.008111 0.002929 0
    0.00579 0.002091 0  0.004109 0.001484 0  0.002899 0.001047 0
    0.002049 0.00074 0  0.00144 0.00052 0  0.001 0.000361 0
    0.00069 0.000249 0  0.000476 0.000172 0  0.000332 0.00012 0
    0.000235 8.5e-05 0  0.000166 6e-05 0  0.000117 4.2e-05 0
    8.3e-05 3e-05 0  5.9e-05 2.1e-05 0  4.2e-05 1.5e-05 0
    """,
    sep=" ",
).reshape(-1, 3)
WAVELENGTHS_M = np.linspace(380e-9, 780e-9, len(OBSERVER))


def uv_from_rgb(rgb: np.ndarray) -> np.ndarray:
    """CIE 1960 u, v (..., 2) float64 of linear Rec. 709 colours (..., 3); nan where there is no light."""
    return _uv_from_xyz(np.asarray(rgb, np.float64) @ xyz_from_primaries(REC709).T)


def planckian_uv(temperature_k: np.ndarray | float) -> np.ndarray:
    """CIE 1960 u, v (..., 2) of a black body (...) by Planck's law."""
    exponent = C2_M_K / (WAVELENGTHS_M * np.asarray(temperature_k, np.float64)[..., None])
    radiance = WAVELENGTHS_M**-5 / np.expm1(exponent)
    return _uv_from_xyz(radiance @ OBSERVER)


def colour_temperature(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Correlated colour temperature in K and Duv, two arrays (...) float64, of linear Rec. 709 colours (..., 3).

    Both are nan for darkness and for colours that have none: FARTHEST_DUV or more from the locus, or outside LOWEST_K to HIGHEST_K.
    """
    uv = uv_from_rgb(rgb)
    points = _locus()
    from_points = np.where(np.isfinite(uv), uv, np.inf)[..., None, :] - points
    nearest = np.hypot(from_points[..., 0], from_points[..., 1]).argmin(axis=-1)

    # The foot of the perpendicular on the chord before or after that point.
    start = np.clip(nearest[..., None] + np.array([-1, 0]), 0, len(points) - 2)
    chord, from_start = points[start + 1] - points[start], uv[..., None, :] - points[start]
    part = np.clip((from_start * chord).sum(axis=-1) / (chord**2).sum(axis=-1), 0, 1)
    away = from_start - part[..., None] * chord
    distance = np.hypot(away[..., 0], away[..., 1])
    chosen = distance.argmin(axis=-1)[..., None]
    part, start, duv, above = (np.take_along_axis(each, chosen, axis=-1)[..., 0] for each in (part, start, distance, away[..., 1] >= 0))
    mired = MIREDS[start] + part
    within = (duv < FARTHEST_DUV) & (mired > MIREDS[0]) & (mired < MIREDS[-1])
    return np.where(within, 1e6 / mired, np.nan), np.where(within, np.where(above, duv, -duv), np.nan)


@cache
def _locus() -> np.ndarray:
    """Points (n, 2) of the Planckian locus at MIREDS."""
    return planckian_uv(1e6 / MIREDS)


def _uv_from_xyz(xyz: np.ndarray) -> np.ndarray:
    whole = xyz @ np.array([1.0, 15.0, 3.0])
    lit = (whole > 0) & (xyz[..., 1] > 0)
    return np.where(lit[..., None], xyz[..., :2] * np.array([4.0, 6.0]) / np.where(lit, whole, 1)[..., None], np.nan)
