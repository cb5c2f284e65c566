"""What arrives of a soft light where each pixel has traced one ray: the mean over a neighbourhood of the same surface.

The rays of 4 x 4 pixels go to 16 places spread over a light. Any 5 x 5 pixels with half the weight at their rim hold each place once
(weights 1 2 2 2 1), so that on a plane the mean has no pattern.
"""

import numpy as np

from vemlight.kernels import kernel

# What a pixel's ray found: nothing, since it went below the surface; a caster; light. Of a sum of these, times weights that are 64
# together, the upper byte counts what is known and the lower byte what is lit.
UNKNOWN, DARK, LIT = np.uint16(0), np.uint16(256), np.uint16(257)
REACH = 2  # pixels
# Neighbours are of the same surface where their normals differ by less than 25 degrees and where they lie within so much of the distance to
# the eye of the pixel's plane.
SAME_NORMAL, SAME_PLANE = np.float32(np.cos(np.radians(25.0))), np.float32(0.006)


@kernel(nogil=True)
def filter_rows(found, surfaces, first, last, chosen, arriving):
    """Fills the rows from first to last of arriving (n, height, width) uint8, for the lights numbered `chosen` (m,), from what was found,
    (height, width, m) uint16."""
    height, width, count = found.shape
    sums = np.zeros(count, np.uint16)
    for y in range(first, last):
        for x in range(width):
            if surfaces.distances[y, x] == 0:
                continue
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
            for m in range(count):
                total = sums[m] >> 8
                arriving[chosen[m], y, x] = (255 * (sums[m] & 255) + (total >> 1)) // total if total else 0
