"""Which surfaces a pixel shows beside its middle's: the neighbours of whose colours it has a part (SRAA, after Chajdas et al. 2011).

Where a pixel's other samples see a surface that a neighbouring pixel sees in its middle, the neighbour's colour stands for it.
"""

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.renderer.rays.surfaces import Surfaces

NEIGHBOURS = np.array([(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)])  # x, y of a pixel's
# Of the same surface: normals less than 37 degrees apart, and so much of the distance to the eye off the other's plane.
SAME_NORMAL, SAME_PLANE = np.float32(0.8), np.float32(0.004)


def nearest_neighbours(x: float, y: float) -> np.ndarray:
    """The numbers of the neighbours, those first that are nearest to a place in the pixel, 0 to 1."""
    return np.argsort(np.linalg.norm(NEIGHBOURS + 0.5 - (x, y), axis=1), kind="stable")


@kernel(nogil=True)
def add_sample(middles, seen, order, first, last, counts):
    """Adds a sample of each pixel to counts (height, width, 8) uint8 of rows from first to last: by surface, which neighbour has its part.

    middles, seen: Surfaces of the pixels' middles and of the sample. order: as nearest_neighbours has it.
    """
    height, width = middles.distances.shape
    for y in range(first, last):
        for x in range(width):
            if _same(middles, y, x, seen, y, x):
                continue
            for k in order:
                i, j = x + NEIGHBOURS[k, 0], y + NEIGHBOURS[k, 1]
                if 0 <= i < width and 0 <= j < height and _same(middles, j, i, seen, y, x):
                    counts[y, x, k] += 1
                    break


@subroutine
def _same(middles, j, i, seen, y, x):
    """Whether a pixel's middle shows the surface that a sample of another shows; or both none."""
    near, far = middles.distances[j, i], seen.distances[y, x]
    if near == 0 or far == 0:
        return near == far
    a, b = middles.smooth_normals[j, i], seen.smooth_normals[y, x]
    if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] < SAME_NORMAL:
        return False
    flat, p, q = middles.flat_normals[j, i], middles.places[j, i], seen.places[y, x]
    off = flat[0] * (q[0] - p[0]) + flat[1] * (q[1] - p[1]) + flat[2] * (q[2] - p[2])
    return abs(off) < SAME_PLANE * near


@kernel(nogil=True)
def smooth(picture, counts, samples, smoothed):
    """Fills smoothed with a picture (height, width, channels) whose pixels have the parts of their neighbours, of so many samples."""
    height, width, channels = picture.shape
    for y in range(height):
        for x in range(width):
            own = samples
            smoothed[y, x] = 0
            for k in range(len(NEIGHBOURS)):
                if counts[y, x, k]:
                    own -= counts[y, x, k]
                    for c in range(channels):
                        smoothed[y, x, c] += counts[y, x, k] * picture[y + NEIGHBOURS[k, 1], x + NEIGHBOURS[k, 0], c]
            for c in range(channels):
                smoothed[y, x, c] = (smoothed[y, x, c] + own * picture[y, x, c]) / samples


def warm(surfaces: Surfaces) -> None:
    """Compiles, or loads, what smooth edges take."""
    height, width = surfaces.distances.shape
    counts, picture = np.zeros((height, width, len(NEIGHBOURS)), np.uint8), np.zeros((height, width, 4), np.float32)
    add_sample(surfaces, surfaces, nearest_neighbours(0.3, 0.1), 0, height, counts)
    picture.flags.writeable = False  # as what is read back
    smooth(picture, counts, 1, np.empty_like(picture))
