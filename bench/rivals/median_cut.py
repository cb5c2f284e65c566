"""Median cut (Debevec 2005) and variance minimisation (Viriyothai and Debevec 2009): regions of the map cut in two, again and again.

Median cut cuts every region along its longer side where its energy halves; a column's width counts with the sine of the polar angle at
the region's centre. Variance minimisation makes, in the same rounds, the cut after which the larger of the two halves' sums of
flux x squared distance to the centroid is smallest. A light has its region's flux and stands at its energy centroid in (theta, phi).
A region of one cell cannot be cut, a black one gives no light, and none reaches over phi = 0.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bench.rivals.cells import Cells, cells
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import SPAN, Coverage, direction_from_angles


class Tables(NamedTuple):
    """Summed-area tables (rows + 1, cols + 1, 5) of power x (1, theta, phi, theta^2, phi^2), float64, and the angles' steps in rad."""

    sums: np.ndarray
    d_theta: float
    d_phi: float


Region = tuple[int, int, int, int]  # rows from, to, columns from, to
Cut = Callable[[Tables, Region], tuple[Region, Region] | None]


def median_cut(radiance: np.ndarray, coverage: Coverage, count: int) -> LightSet:
    """At most `count` lights of a polar map (rows, cols, 3)."""
    return _lights(radiance, coverage, count, _halved)


def variance_minimisation(radiance: np.ndarray, coverage: Coverage, count: int) -> LightSet:
    """At most `count` lights of a polar map (rows, cols, 3)."""
    return _lights(radiance, coverage, count, _least_variance)


def _lights(radiance: np.ndarray, coverage: Coverage, count: int, cut: Cut) -> LightSet:
    of = cells(radiance, coverage)
    rows, cols = of.power.shape
    d_theta, d_phi = SPAN[coverage] / rows, 2 * np.pi / cols
    theta, phi = (np.arange(rows)[:, None] + 0.5) * d_theta, (np.arange(cols)[None, :] + 0.5) * d_phi
    moments = of.power[..., None] * np.stack(np.broadcast_arrays(1.0, theta, phi, theta**2, phi**2), axis=-1)
    sums = np.zeros((rows + 1, cols + 1, 5))
    sums[1:, 1:] = moments.cumsum(axis=0).cumsum(axis=1)
    tables = Tables(sums, d_theta, d_phi)
    done: list[Region] = []
    regions: list[Region] = [(0, rows, 0, cols)]
    # Rounds double the regions; in the last one the strongest are cut until the count is reached.
    while regions and len(done) + len(regions) < count:
        regions.sort(key=lambda r: -_inside(tables, r)[0])
        missing, after = count - len(done) - len(regions), []
        for k, region in enumerate(regions):
            halves = cut(tables, region) if k < missing else None
            if halves is None and k < missing:
                done.append(region)
            else:
                after += halves or (region,)
        if len(after) == len(regions):
            regions = after
            break
        regions = after
    return _placed(of, tables, done + regions)


def _placed(of: Cells, tables: Tables, regions: list[Region]) -> LightSet:
    moments = np.array([_inside(tables, r) for r in regions])
    flux = np.array([of.flux[i0:i1, j0:j1].sum(axis=(0, 1)) for i0, i1, j0, j1 in regions])
    lit = flux.sum(axis=1) > 0
    centre = moments[lit, 1:3] / moments[lit, :1]
    return LightSet.of(np.flatnonzero(lit), direction_from_angles(centre[:, 0], centre[:, 1]), flux[lit])


def _inside(tables: Tables, region: Region) -> np.ndarray:
    i0, i1, j0, j1 = region
    return tables.sums[i1, j1] - tables.sums[i0, j1] - tables.sums[i1, j0] + tables.sums[i0, j0]


def _halved(tables: Tables, region: Region) -> tuple[Region, Region] | None:
    i0, i1, j0, j1 = region
    if (i1 - i0) * (j1 - j0) == 1 or _inside(tables, region)[0] <= 0:
        return None
    tall = (i1 - i0) * tables.d_theta
    wide = (j1 - j0) * tables.d_phi * np.sin(0.5 * (i0 + i1) * tables.d_theta)
    s = tables.sums[..., 0]
    if i1 - i0 > 1 and (tall >= wide or j1 - j0 == 1):
        along = s[i0 : i1 + 1, j1] - s[i0 : i1 + 1, j0] - s[i0, j1] + s[i0, j0]
        at = i0 + int(np.clip(np.abs(along - along[-1] / 2).argmin(), 1, i1 - i0 - 1))
        return (i0, at, j0, j1), (at, i1, j0, j1)
    along = s[i1, j0 : j1 + 1] - s[i0, j0 : j1 + 1] - s[i1, j0] + s[i0, j0]
    at = j0 + int(np.clip(np.abs(along - along[-1] / 2).argmin(), 1, j1 - j0 - 1))
    return (i0, i1, j0, at), (i0, i1, at, j1)


def _least_variance(tables: Tables, region: Region) -> tuple[Region, Region] | None:
    i0, i1, j0, j1 = region
    whole = _inside(tables, region)
    if (i1 - i0) * (j1 - j0) == 1 or whole[0] <= 0:
        return None
    narrow = np.sin(whole[1] / whole[0])
    s = tables.sums
    best: tuple[float, tuple[Region, Region]] | None = None
    down = s[i0 + 1 : i1, j1] - s[i0 + 1 : i1, j0] - s[i0, j1] + s[i0, j0]
    across = s[i1, j0 + 1 : j1] - s[i0, j0 + 1 : j1] - s[i1, j0] + s[i0, j0]
    for first, rows in ((down, True), (across, False)):
        if not len(first):
            continue
        worse = np.maximum(_variance(first, narrow), _variance(whole - first, narrow))
        k = int(worse.argmin())
        at = (i0 if rows else j0) + k + 1
        halves = ((i0, at, j0, j1), (at, i1, j0, j1)) if rows else ((i0, i1, j0, at), (i0, i1, at, j1))
        if best is None or worse[k] < best[0]:
            best = float(worse[k]), halves
    return best[1] if best else None


def _variance(moments: np.ndarray, narrow: float) -> np.ndarray:
    """Sum of power x squared distance to the centroid (n,), with azimuths shortened by `narrow`."""
    power = np.maximum(moments[:, 0], 1e-300)
    up, round_ = moments[:, 3] - moments[:, 1] ** 2 / power, moments[:, 4] - moments[:, 2] ** 2 / power
    return np.maximum(up, 0) + narrow**2 * np.maximum(round_, 0)
