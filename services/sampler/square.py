"""The unit square laid on the disc and back: Shirley and Chiu 1997, the concentric map, which keeps areas and neighbours.

The disc is given by (a, w): squared radius in [0, 1] and azimuth over 2 pi in [0, 1), so that du dv = da dw. The square's centre is the
disc's centre, its edges are the disc's rim.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def disc_from_square(u, v):
    """(a, w) of the point (u, v) in [0, 1]^2."""
    x, y = 2 * u - 1, 2 * v - 1
    if abs(x) > abs(y):
        r = abs(x)
        w = 0.125 * (y / x) + (0.5 if x < 0 else 0.0)
    elif y != 0:
        r = abs(y)
        w = 0.25 - 0.125 * (x / y) + (0.5 if y < 0 else 0.0)
    else:
        r = w = 0.0
    if w < 0:
        w += 1.0
    return r * r, (0.0 if w >= 1 else w)  # -1e-17 + 1 rounds to 1


@njit(cache=True)
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


@njit(cache=True)
def direction_from_area(a, phi):
    """Unit vector with area coordinate a = 1 - cos(theta) in [0, 2] and azimuth phi in rad: exact near the zenith."""
    s = np.sqrt(max(a * (2 - a), 0.0))
    return s * np.cos(phi), s * np.sin(phi), 1 - a


@njit(cache=True)
def area_from_direction(x, y, z):
    """(a, phi) of a unit vector, a = 1 - cos(theta) without cancellation near the zenith, phi in [0, 2 pi)."""
    s2 = x * x + y * y
    a = s2 / (1 + z) if z > 0 else 1 - z
    phi = np.arctan2(y, x)
    if phi < 0:
        phi += 2 * np.pi
    return a, (0.0 if phi >= 2 * np.pi else phi)


@njit(cache=True)
def last_at_most(table, x):
    """The last i < len(table) - 1 with table[i] <= x (0 when x is below all): the cell of x in a cumulative table."""
    low, left = 0, table.size - 1
    while left > 1:  # steps that do not depend on the outcome, so that no branch is guessed wrong
        half = left >> 1
        low = low + half if table[low + half] <= x else low
        left -= half
    return low
