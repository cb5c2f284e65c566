"""Primaries of linear RGB, and the matrices that bring them to Rec. 709 with the white of daylight, D65.

x, y are CIE 1931 chromaticities. Where the white differs it is adapted by Bradford's cone responses (Lam 1985; ICC.1:2022, annex E).
"""

from collections.abc import Sequence
from functools import cache

import numpy as np

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # x, y of red, green, blue, white (D65)
XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0)  # red, green and blue of files whose channels hold CIE X, Y and Z
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def xyz_from_primaries(primaries: Sequence[float]) -> np.ndarray:
    """(3, 3): CIE XYZ of linear RGB whose (1, 1, 1) is the white with Y = 1 (SMPTE RP 177).

    primaries: x, y of red, green, blue and white. Raises ValueError for those that lie on a line and for a white without luminance.
    """
    xy = np.asarray(primaries, np.float64).reshape(4, 2)
    xyz = np.stack([xy[:, 0], xy[:, 1], 1 - xy.sum(axis=1)])
    if not np.isfinite(xy).all() or xy[3, 1] <= 0 or abs(np.linalg.det(xyz[:, :3])) < 1e-9:
        raise ValueError(f"{' '.join(f'{value:g}' for value in xy.ravel())} are no primaries with a white")
    return xyz[:, :3] * np.linalg.solve(xyz[:, :3], xyz[:, 3] / xy[3, 1])


def adapted_white(from_white: Sequence[float], to_white: Sequence[float]) -> np.ndarray:
    """(3, 3) of XYZ that makes the first white, x and y, the second one by Bradford's cone responses."""
    cones = [BRADFORD @ np.array([x / y, 1, (1 - x - y) / y]) for x, y in (from_white, to_white)]
    return np.linalg.inv(BRADFORD) @ np.diag(cones[1] / cones[0]) @ BRADFORD


def rec709_from_primaries(primaries: Sequence[float]) -> np.ndarray:
    """(3, 3): linear Rec. 709 of linear RGB with these primaries and white. Raises ValueError as `xyz_from_primaries`.

    Channels that are CIE X, Y and Z themselves are colours as measured: no white is adapted.
    """
    if tuple(primaries[:6]) == XYZ:
        return rec709_from_xyz()
    to_xyz = xyz_from_primaries(primaries)
    adaptation = adapted_white(tuple(primaries[6:8]), REC709[6:8])
    return np.linalg.inv(xyz_from_primaries(REC709)) @ adaptation @ to_xyz


@cache
def rec709_from_xyz() -> np.ndarray:
    """(3, 3): linear Rec. 709 of CIE XYZ, no white adapted."""
    return np.linalg.inv(xyz_from_primaries(REC709))
