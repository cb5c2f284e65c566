"""Ears of a concave polygon (Meisters 1975, "Polygons have ears"), in a loop that is compiled."""

import numpy as np

from vemlight.kernels import kernel, subroutine

STRICT, TOUCHING = 0, 1  # how an ear may be: whole and alone; flat, or touched from outside


@subroutine
def _turn(x, y, a, b, c):
    return (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])


@subroutine
def _holds(x, y, a, b, c, p, pass_by):
    # whether p lies in the triangle a b c, its edges included for STRICT, but is none of its corners
    for q in (a, b, c):
        if x[p] == x[q] and y[p] == y[q]:
            return False
    ab, bc, ca = _turn(x, y, a, b, p), _turn(x, y, b, c, p), _turn(x, y, c, a, p)
    if pass_by == STRICT:
        return ab >= 0 and bc >= 0 and ca >= 0
    return ab > 0 and bc > 0 and ca > 0


@kernel
def clip_ears(x: np.ndarray, y: np.ndarray, triangles: np.ndarray, steps: int):
    """Fills `triangles` (n - 2, 3) with the numbers of a counter-clockwise polygon's corners x, y (n,).

    Returns whether it has no ears, since its edges cross, or takes more than `steps` steps; and the steps that are left.
    """
    n = len(x)
    before, after = np.empty(n, np.int64), np.empty(n, np.int64)
    for k in range(n):
        before[k], after[k] = (k - 1) % n, (k + 1) % n
    b, found, missed, pass_by = 0, 0, 0, STRICT
    while found < n - 3:
        a, c = before[b], after[b]
        turn = _turn(x, y, a, b, c)
        ear = turn > 0 if pass_by == STRICT else turn >= 0
        p = after[c]
        while ear and p != a:
            steps -= 1
            if _turn(x, y, before[p], p, after[p]) <= 0 and _holds(x, y, a, b, c, p, pass_by):
                ear = False
            p = after[p]
        steps -= 1
        if steps <= 0:
            return True, steps
        if ear:
            triangles[found, 0], triangles[found, 1], triangles[found, 2] = a, b, c
            after[a], before[c] = c, a
            found, missed, pass_by, b = found + 1, 0, STRICT, after[c]  # the next but one, which makes fewer slivers
        else:
            missed, b = missed + 1, c
            if missed > n - found:
                if pass_by == TOUCHING:
                    return True, steps
                missed, pass_by = 0, TOUCHING
    triangles[found, 0], triangles[found, 1], triangles[found, 2] = before[b], b, after[b]
    return False, steps
