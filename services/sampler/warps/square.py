"""The concentric map of the unit square onto the disc, and its inverse: Shirley and Chiu 1997; it preserves area and neighbours.

The disc is given by (a, w): squared radius in [0, 1] and azimuth over 2 pi in [0, 1), so that du dv = da dw. The square's centre is the
disc's centre, its edges are the disc's rim. A direction has the same coordinates: a = 1 - cos(theta) in [0, 2], and w.

Samples are drawn a block at a time, each stage for the whole block. Nothing branches on a sample, so no branch is mispredicted, several
samples share an instruction, and the loads of many searches overlap: 25 ns a sample where one after the other took 140. What remains is
about a third each the searches, the loads of radiance and density in the cells found, and arithmetic.
"""

from math import factorial

import numpy as np

from vemlight.kernels import kernel, subroutine

BLOCK = 64  # samples; 16 to 256 do equally well: the loops' overhead no longer counts, and all of it stays in the first-level cache
# Taylor's series of sine and cosine, enough for an eighth of a turn: the first terms left out are 5e-17 and 2e-18 there.
_S = tuple((-1) ** k / factorial(2 * k + 1) for k in range(8))
_C = tuple((-1) ** k / factorial(2 * k) for k in range(9))


@kernel
def disc_from_square(u, v):
    """(a, w) of the point (u, v) in [0, 1]^2."""
    x, y = 2 * u - 1, 2 * v - 1
    wide = abs(x) > abs(y)
    major, minor = (x if wide else y), (y if wide else x)
    ratio = minor / (major if major != 0 else 1.0)
    w = (0.125 * ratio if wide else 0.25 - 0.125 * ratio) + (0.5 if major < 0 else 0.0)
    w += 1.0 if w < 0 else 0.0
    return major * major, (0.0 if w >= 1 or major == 0 else w)  # -1e-17 + 1 rounds to 1


@kernel
def square_from_disc(a, w):
    """(u, v) in [0, 1]^2 of the disc's point (a, w): the inverse of `disc_from_square`."""
    r = np.sqrt(a)
    turn = w - 1.0 if w >= 0.875 else w
    quarter = min(max(int(np.floor((turn + 0.125) * 4)), 0), 3)
    t = r * (turn - 0.25 * quarter) * 8
    if quarter == 0:
        x, y = r, t
    elif quarter == 1:
        x, y = -t, r
    elif quarter == 2:
        x, y = -r, -t
    else:
        x, y = t, -r
    return 0.5 * (x + 1), 0.5 * (y + 1)


@kernel
def cosine_and_sine(w):
    """Of the angle of w turns."""
    quarter = np.rint(4 * w)
    angle, q = (4 * w - quarter) * (np.pi / 2), np.int32(quarter)
    z = angle * angle
    sine = _S[0] + z * (_S[1] + z * (_S[2] + z * (_S[3] + z * (_S[4] + z * (_S[5] + z * (_S[6] + z * _S[7]))))))
    cosine = _C[0] + z * (_C[1] + z * (_C[2] + z * (_C[3] + z * (_C[4] + z * (_C[5] + z * (_C[6] + z * (_C[7] + z * _C[8])))))))
    sine *= angle
    x, y = (sine if q & 1 else cosine), (cosine if q & 1 else sine)
    return (-x if (q + 1) & 2 else x), (-y if q & 2 else y)


@kernel
def direction_from_area(a, w):
    """Unit vector with area coordinate a = 1 - cos(theta) in [0, 2] and azimuth of w turns: exact near the zenith."""
    s = np.sqrt(max(a * (2 - a), 0.0))
    cosine, sine = cosine_and_sine(w)
    return s * cosine, s * sine, 1 - a


@kernel
def area_from_direction(x, y, z):
    """(a, w) of a unit vector, a = 1 - cos(theta) without cancellation near the zenith, w in [0, 1) turns."""
    s2 = x * x + y * y
    a = s2 / (1 + z) if z > 0 else 1 - z
    w = np.arctan2(y, x) / (2 * np.pi)
    if w < 0:
        w += 1.0
    return a, (0.0 if w >= 1 else w)


@kernel
def last_at_most(table, x):
    """The last i < len(table) - 1 with table[i] <= x (0 when x is below all): the cell of x in a cumulative table."""
    low, left = 0, table.size - 1
    while left > 1:  # steps that do not depend on the outcome, so that no branch is mispredicted
        half = left >> 1
        low = low + half if table[low + half] <= x else low
        left -= half
    return low


@subroutine
def load_disc(points, a, w):
    """Fills a, w (BLOCK,) with `disc_from_square` of up to BLOCK points (n, 2)."""
    for k in range(points.shape[0]):
        a[k], w[k] = points[k, 0], points[k, 1]
    for k in range(points.shape[0]):
        a[k], w[k] = disc_from_square(a[k], w[k])


@kernel
def load_cells(table, x, cells, n):
    """Fills the first n of cells (BLOCK,) uint64 with `last_at_most` of x (BLOCK,)."""
    cells[:n] = 0
    left = np.uint64(table.size - 1)
    while left > 1:
        half = left >> np.uint64(1)
        for k in range(n):
            at = cells[k] + half
            cells[k] = at if table[at] <= x[k] else cells[k]
        left -= half


@subroutine
def store_directions(a, w, directions):
    """Fills directions (n, 3) with `direction_from_area` of the first n of a, w (BLOCK,), which it overwrites."""
    for k in range(directions.shape[0]):
        directions[k, 2] = 1 - a[k]
    for k in range(directions.shape[0]):
        a[k], w[k], _ = direction_from_area(a[k], w[k])
    for k in range(directions.shape[0]):
        directions[k, 0], directions[k, 1] = a[k], w[k]
