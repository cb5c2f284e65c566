"""Primaries of linear RGB, and the matrices that bring them to Rec. 709 with the white of daylight, D65.

x, y are CIE 1931 chromaticities: ITU-R BT.709-6, BT.2020-2, BT.601-7, SMPTE EG 432-1 and RP 431-2 (P3), Academy S-2008-001 and
S-2014-004 (AP0, AP1), and papers of ARRI, Sony and Panasonic on their logs. Where the white differs it is adapted by Bradford's cone
responses (Lam 1985; ICC.1:2022, annex E).
"""

from collections.abc import Sequence
from functools import cache

import numpy as np

REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # x, y of red, green, blue, white (D65)
D65 = REC709[6:]
PRIMARIES = {  # x, y of red, green, blue, white; p3dci, bt470bg and smpte170m occur as tags alone, the last five are cameras'
    "bt709": REC709,
    "bt2020": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, *D65),
    "p3d65": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, *D65),
    "p3dci": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.314, 0.351),
    "bt470bg": (0.640, 0.330, 0.290, 0.600, 0.150, 0.060, *D65),
    "smpte170m": (0.630, 0.340, 0.310, 0.595, 0.155, 0.070, *D65),
    "ap0": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
    "ap1": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
    "awg3": (0.6840, 0.3130, 0.2210, 0.8480, 0.0861, -0.1020, *D65),
    "awg4": (0.7347, 0.2653, 0.1424, 0.8576, 0.0991, -0.0308, *D65),
    "sgamut3": (0.730, 0.280, 0.140, 0.855, 0.100, -0.050, *D65),
    "sgamut3cine": (0.766, 0.275, 0.225, 0.800, 0.089, -0.087, *D65),
    "vgamut": (0.730, 0.280, 0.165, 0.840, 0.100, -0.030, *D65),
}
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
