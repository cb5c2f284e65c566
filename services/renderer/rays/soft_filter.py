"""What arrives of a soft light where each pixel has traced one ray: the mean over a neighbourhood of the same surface.

The rays of 4 x 4 pixels go to 16 places spread over a light. Any 5 x 5 pixels with half the weight at their rim hold each place once
(weights 1 2 2 2 1), so that on a plane the mean has no pattern.
"""

import numpy as np

from vemlight.kernels import kernel, subroutine

# What a pixel's ray found: nothing, since it went below the surface; a caster; light. Of a sum of these, times weights that are 64
# together, the upper byte counts what is known and the lower byte what is lit.
UNKNOWN, DARK, LIT = np.uint16(0), np.uint16(256), np.uint16(257)
REACH = 2  # pixels
TILE = 4  # pixels on a side, 16 rays
SEEN_DARK, SEEN_LIT = 1, 2  # bits of what the rays of a tile found
# Neighbours are of the same surface where their normals differ by less than 25 degrees and where they lie within so much of the distance to
# the eye of the pixel's plane.
SAME_NORMAL, SAME_PLANE = np.float32(np.cos(np.radians(25.0))), np.float32(0.006)


@kernel(nogil=True)
def tile_states(found, first, last, states):
    """Fills the rows of tiles of the picture's rows from first to last of states (rows, columns, m) uint8: SEEN_DARK and SEEN_LIT."""
    height, width, _ = found.shape
    for top in range(first, last, TILE):
        for left in range(0, width, TILE):
            state = states[top // TILE, left // TILE]
            for y in range(top, min(top + TILE, height)):
                for x in range(left, min(left + TILE, width)):
                    for m in range(len(state)):
                        known = found[y, x, m] != UNKNOWN
                        state[m] |= known * (SEEN_LIT if found[y, x, m] == LIT else SEEN_DARK)


@kernel(nogil=True)
def filter_rows(found, states, surfaces, first, last, chosen, arriving):
    """Fills the rows from first to last, which begin with a row of tiles, of arriving (n, height, width) uint8, for the lights numbered
    `chosen` (m,), from what was found, (height, width, at least m) uint16, and the states of tiles.

    Where all rays of a tile and of its neighbours found the same, so does the filter.
    """
    height, width, count = found.shape
    sums, around = np.zeros(count, np.uint16), np.zeros(len(chosen), np.uint8)
    for top in range(first, last, TILE):
        for left in range(0, width, TILE):
            states_around(states, top // TILE, left // TILE, 1, around)
            bottom, right = min(top + TILE, height), min(left + TILE, width)
            mixed = False
            for m in range(len(chosen)):
                arriving[chosen[m], top:bottom, left:right] = 255 if around[m] & SEEN_LIT else 0
                mixed |= around[m] == SEEN_DARK | SEEN_LIT
            if mixed:
                for y in range(top, bottom):
                    for x in range(left, right):
                        if surfaces.distances[y, x] != 0:
                            _sum_neighbours(found, surfaces, y, x, sums)
                            for m in range(len(chosen)):
                                total = sums[m] >> 8
                                arriving[chosen[m], y, x] = (255 * (sums[m] & 255) + (total >> 1)) // total if total else 0


@subroutine
def states_around(states, row, column, reach, around):
    """Fills around (m,) with what the rays of a tile and of those up to `reach` tiles away found."""
    around[:] = 0
    for j in range(max(row - reach, 0), min(row + reach + 1, states.shape[0])):
        for i in range(max(column - reach, 0), min(column + reach + 1, states.shape[1])):
            for m in range(len(around)):
                around[m] |= states[j, i, m]


@subroutine
def _sum_neighbours(found, surfaces, y, x, sums):
    """Fills sums with what the pixels about one found that lie on the same surface, by their weights."""
    height, width, count = found.shape
    sums[:] = 0
    normal, place, near = surfaces.smooth_normals[y, x], surfaces.places[y, x], SAME_PLANE * surfaces.distances[y, x]
    flat = surfaces.flat_normals[y, x]
    for j in range(max(y - REACH, 0), min(y + REACH + 1, height)):
        for i in range(max(x - REACH, 0), min(x + REACH + 1, width)):
            other, there = surfaces.smooth_normals[j, i], surfaces.places[j, i]
            if normal[0] * other[0] + normal[1] * other[1] + normal[2] * other[2] < SAME_NORMAL:
                continue
            off = flat[0] * (there[0] - place[0]) + flat[1] * (there[1] - place[1]) + flat[2] * (there[2] - place[2])
            if abs(off) > near:
                continue
            weight = np.uint16((1 if abs(j - y) == REACH else 2) * (1 if abs(i - x) == REACH else 2))
            for m in range(count):
                sums[m] += weight * found[j, i, m]
