"""The solid angle that each pixel of a fisheye image shares with each cell of a polar map.

Counted in subpixels, finer where cells are narrow, and then balanced: the shares of a pixel add up to its solid angle exactly (power is
conserved), those of a cell that the lens sees whole to the cell's as nearly as the rounds below get (an even sky stays even).
"""

import math

import numpy as np
from numba import njit

LOOKUP = 4096  # angles of the radius table; between two of them the line is off by (3 / 4096)^2 / 8 = 7e-8 rad at most
FINE = 8  # subpixels a side, at least, where a pixel crosses an edge of the map
FINER = 8  # across the narrowest cell
FINEST = 128  # next to the zenith, where cells are narrower than that
CLEAR = 4.0  # pixels from the zenith on, an edge that crosses a pixel is straight: it bends by 1 / (8 x 4) of a pixel at most
ROUNDS = 40  # of balancing; the evenness then reached is in the tests


@njit(cache=True)
def shares(solid, f, c, angles, reach, rotation, rows, cols, span, first, step, size):
    """(pixel, cell, solid angle shared) of the pixels of one lattice, pixel by pixel, int32, int32 and float64.

    `solid` (height, width): of each pixel, 0 where it is not lit; f and c (2,): the lens's; `angles`: off the axis in rad at even steps of
    the radius from 0 to `reach`, in units of f; `rotation` (3, 3): world from camera; `first`, `step` and `size`, x and y: the lattice.
    """
    height, width = solid.shape
    room = 2 * height * width // (step[0] * step[1]) + 4 * rows * cols
    pixel, cell, share = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room)
    found, hits = np.empty(rows * cols, np.int32), np.zeros(rows * cols, np.int32)
    above, below = np.empty((width // step[0] + 2, 5)), np.empty((width // step[0] + 2, 5))
    ready, m = math.inf, 0
    for y in range(first[1], height, step[1]):
        # corners of this row of pixels; the ones above are those below the row before, where rows touch
        if ready == y - size[1] / 2:
            above, below = below, above
        else:
            _corners(above, y - size[1] / 2, first[0], size[0], f, c, angles, reach, rotation, rows, cols, span)
        ready = y + size[1] / 2
        _corners(below, ready, first[0], size[0], f, c, angles, reach, rotation, rows, cols, span)
        for n, x in enumerate(range(first[0], width, step[0])):
            if solid[y, x] == 0:
                continue
            side = math.sqrt(solid[y, x]) * max(size[0], size[1])
            total, count = _found(found, hits, above[n], above[n + 1], below[n], below[n + 1], side, rows, cols, span)
            if m + count > len(cell):
                pixel, cell, share = _doubled(pixel), _doubled(cell), _doubled(share)
            for q in range(count):
                pixel[m], cell[m] = y * width + x, found[q]
                share[m] = solid[y, x] * size[0] * size[1] * hits[found[q]] / total
                hits[found[q]] = 0
                m += 1
    return pixel[:m].copy(), cell[:m].copy(), share[:m].copy()


@njit(cache=True)
def _doubled(array):
    # numpy's own `append` takes seconds to compile
    longer = np.empty(2 * len(array), array.dtype)
    longer[: len(array)] = array
    return longer


@njit(cache=True)
def _corners(corners, y, first_x, size_x, f, c, angles, reach, rotation, rows, cols, span):
    # x, y, z of the world, and row and column of the map, of a row of pixel corners, (n, 5)
    for n in range(len(corners)):
        px, py = (first_x + (n - 0.5) * size_x - c[0]) / f[0], (y - c[1]) / f[1]
        radius = math.hypot(px, py)
        at = min(radius / reach * (len(angles) - 1), len(angles) - 1.000001)
        i = int(at)
        theta = angles[i] + (at - i) * (angles[i + 1] - angles[i])
        across = math.sin(theta) / radius if radius > 0 else 0.0
        dx, dy, dz = px * across, py * across, math.cos(theta)
        for k in range(3):
            corners[n, k] = rotation[k, 0] * dx + rotation[k, 1] * dy + rotation[k, 2] * dz
        corners[n, 3], corners[n, 4] = _place(corners[n, 0], corners[n, 1], corners[n, 2], rows, cols, span)


@njit(cache=True)
def _place(x, y, z, rows, cols, span):
    # continuous row and column of the map
    phi = math.atan2(y, x)
    return math.atan2(math.hypot(x, y), z) / span * rows, (phi if phi >= 0 else phi + 2 * math.pi) / (2 * math.pi) * cols


@njit(cache=True)
def _found(found, hits, a, b, c, d, side, rows, cols, span):
    # lists the cells that a pixel with corners a b, above c d, overlaps, and counts their subpixels; of how many, and cells
    sine = min(math.hypot(a[0], a[1]), math.hypot(d[0], d[1]))
    # columns counted from that of the first corner, so that none lies across the seam
    low = high = 0.0
    for other in (b[4], c[4], d[4]):
        along = (other - a[4] + 1.5 * cols) % cols - 0.5 * cols
        low, high = min(low, along), max(high, along)
    left, right = math.floor(a[4] + low), math.floor(a[4] + high)
    top, bottom = math.floor(min(a[3], b[3], c[3], d[3])), math.floor(max(a[3], b[3], c[3], d[3]))
    if sine < CLEAR * side or bottom - top > 1 or right - left > 1:
        return _counted(found, hits, a, b, c, d, side, rows, cols, span)
    if top >= rows:
        return 1, 0
    if top == bottom and left == right:
        found[0] = int(top) * cols + int(left) % cols
        hits[found[0]] = 1
        return 1, 1
    return _crossed(found, hits, a, b, c, d, int(top), int(bottom), int(left), int(right), rows, cols, span)


@njit(cache=True)
def _crossed(found, hits, a, b, c, d, top, bottom, left, right, rows, cols, span):
    # a pixel that one edge between rows crosses at most, and one between columns; how far from them is bilinear over the pixel
    theta, phi = bottom * span / rows, right * 2 * math.pi / cols
    sin_theta, cos_theta, sin_phi, cos_phi = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
    down, on = np.ones((2, 2)), np.ones((2, 2))
    for k in range(4):
        corner = a if k == 0 else b if k == 1 else c if k == 2 else d
        if bottom > top:
            down[k // 2, k % 2] = math.hypot(corner[0], corner[1]) * cos_theta - corner[2] * sin_theta
        if right > left:
            on[k // 2, k % 2] = corner[1] * cos_phi - corner[0] * sin_phi
    below = ahead = both = 0
    for v in range(FINE):
        t = (v + 0.5) / FINE
        down_0, down_1 = down[0, 0] + t * (down[1, 0] - down[0, 0]), down[0, 1] + t * (down[1, 1] - down[0, 1])
        on_0, on_1 = on[0, 0] + t * (on[1, 0] - on[0, 0]), on[0, 1] + t * (on[1, 1] - on[0, 1])
        for u in range(FINE):
            s = (u + 0.5) / FINE
            is_below, is_ahead = down_0 + s * (down_1 - down_0) >= 0, on_0 + s * (on_1 - on_0) >= 0
            below += is_below
            ahead += is_ahead
            both += is_below and is_ahead
    total, count = FINE * FINE, 0
    parts = (total - below - ahead + both, ahead - both, below - both, both)
    for k in range(4):
        row = bottom if k // 2 else top
        if parts[k] > 0 and row < rows:
            found[count] = row * cols + (right if k % 2 else left) % cols
            hits[found[count]] = parts[k]
            count += 1
    return total, count


@njit(cache=True)
def _counted(found, hits, a, b, c, d, side, rows, cols, span):
    # any pixel: subpixel by subpixel
    sine = max(math.hypot(a[0], a[1]), math.hypot(d[0], d[1]))
    narrow = min(span / rows, 2 * math.pi / cols * max(sine - 1.5 * side, 1e-9))
    fine, count = min(max(FINE, int(FINER * side / narrow)), FINEST), 0
    for v in range(fine):
        t = (v + 0.5) / fine
        for u in range(fine):
            s = (u + 0.5) / fine
            p, q, r, w = (1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t
            x, y = p * a[0] + q * b[0] + r * c[0] + w * d[0], p * a[1] + q * b[1] + r * c[1] + w * d[1]
            row, col = _place(x, y, p * a[2] + q * b[2] + r * c[2] + w * d[2], rows, cols, span)
            if row < rows:
                at = int(row) * cols + min(int(col), cols - 1)
                if hits[at] == 0:
                    found[count] = at
                    count += 1
                hits[at] += 1
    return fine * fine, count


@njit(cache=True)
def balance(pixel, cell, share, cells):
    """Scales the shares in place, entries of a pixel next to each other, so that those of each cell add up to its solid angle in `cells`
    (0: to whatever they will) and those of each pixel to what they did before.

    Sinkhorn and Knopp (1967): to one margin, then to the other; the pixels' margin comes last and is exact.
    """
    # pixels in one cell only never change
    fixed = np.zeros(len(cells))
    starts, ends, own = np.empty(len(pixel), np.int64), np.empty(len(pixel), np.int64), np.empty(len(pixel))
    several, begin = 0, 0
    for m in range(1, len(pixel) + 1):
        if m < len(pixel) and pixel[m] == pixel[begin]:
            continue
        if m - begin > 1:
            starts[several], ends[several], own[several] = begin, m, share[begin:m].sum()
            several += 1
        else:
            fixed[cell[begin]] += share[begin]
        begin = m
    for _ in range(ROUNDS):
        total = fixed.copy()
        for n in range(several):
            for m in range(starts[n], ends[n]):
                total[cell[m]] += share[m]
        factor = np.ones(len(cells))
        for at in range(len(cells)):
            if cells[at] > 0 and total[at] > 0:
                factor[at] = cells[at] / total[at]
        for n in range(several):
            scaled = 0.0
            for m in range(starts[n], ends[n]):
                share[m] *= factor[cell[m]]
                scaled += share[m]
            for m in range(starts[n], ends[n]):
                share[m] *= own[n] / scaled
