"""Fisheye images through their weights: one pass over the contributions of pixels to cells, by one thread or several.

Each thread adds to a part of the map of its own, and each cell's additions come in a fixed order: any number of threads gives the same
bytes.
"""

import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import wait as all_of

import numpy as np

from vemlight.capture.fisheye import MAP_PARTS, FisheyeToPolar
from vemlight.kernels import kernel


class Threads:
    """This thread and `count` - 1 others."""

    def __init__(self, count: int = 1):
        self.count = min(count, MAP_PARTS)
        self._others = ThreadPoolExecutor(self.count - 1, "scatter") if self.count > 1 else None

    def run(self, job: Callable[[slice], None], ends: np.ndarray) -> None:
        """Calls `job` with slices that make up ends[0] : ends[-1], each from one of the ends to another, and waits for all."""
        cuts = [int(ends[n * MAP_PARTS // self.count]) for n in range(self.count + 1)]
        if self._others is None:
            job(slice(cuts[0], cuts[-1]))
            return
        others = [self._others.submit(job, slice(*pair)) for pair in itertools.pairwise(cuts[1:])]
        job(slice(cuts[0], cuts[1]))
        for other in all_of(others).done:
            other.result()


ONE_THREAD = Threads()


def polar_from_fisheye(image: np.ndarray, weights: FisheyeToPolar, threads: Threads = ONE_THREAD) -> np.ndarray:
    """The polar map (rows, cols, 3) float32 of a fisheye image of radiance (height, width, 3) float32."""
    polar, flat = np.zeros((weights.rows * weights.cols, 3), np.float32), image.reshape(-1, 3)

    def job(entries: slice) -> None:
        _add_radiance(polar, flat, weights.pixel[entries], weights.cell[entries], weights.weight[entries])

    threads.run(job, weights.ends)
    return polar.reshape(weights.rows, weights.cols, 3)


@kernel(nogil=True)
def _add_radiance(polar, image, pixel, cell, weight):
    for m in range(len(pixel)):
        w, p, at = weight[m], pixel[m], cell[m]
        polar[at, 0] += w * image[p, 0]
        polar[at, 1] += w * image[p, 1]
        polar[at, 2] += w * image[p, 2]


def polar_from_codes(codes: np.ndarray, weights: FisheyeToPolar, table: np.ndarray, threads: Threads = ONE_THREAD) -> np.ndarray:
    """The polar map (rows, cols) float32 of one channel of raw codes, (height, width) uint8 or uint16.

    `table`: radiance of each code that the dtype has, (256,) or (65536,) float32, finite.
    """
    polar, flat = np.zeros(weights.rows * weights.cols, np.float32), codes.reshape(-1)

    def job(entries: slice) -> None:
        _add_codes(polar, flat, weights.pixel[entries], weights.cell[entries], weights.weight[entries], table)

    threads.run(job, weights.ends)
    return polar.reshape(weights.rows, weights.cols)


@kernel(nogil=True)
def _add_codes(polar, codes, pixel, cell, weight, table):
    for m in range(len(pixel)):
        polar[cell[m]] += weight[m] * table[codes[pixel[m]]]


def polar_from_gray(image: np.ndarray, weights: FisheyeToPolar, threads: Threads = ONE_THREAD) -> np.ndarray:
    """The polar map (rows, cols) float32 of one channel of radiance, (height, width) float32."""
    polar, flat = np.zeros(weights.rows * weights.cols, np.float32), image.reshape(-1)

    def job(entries: slice) -> None:
        _add_gray(polar, flat, weights.pixel[entries], weights.cell[entries], weights.weight[entries])

    threads.run(job, weights.ends)
    return polar.reshape(weights.rows, weights.cols)


@kernel(nogil=True)
def _add_gray(polar, image, pixel, cell, weight):
    for m in range(len(pixel)):
        polar[cell[m]] += weight[m] * image[pixel[m]]


@kernel
def clipped_counts(codes, runs, top):
    """Number of black and of saturated codes, and the highest code, of codes (height, width) inside `runs`.

    `runs` (m, 3): row, first column and one past the last; codes from `top` on are saturated.
    """
    black, saturated, highest = 0, 0, 0
    for k in range(len(runs)):
        row = codes[runs[k, 0], runs[k, 1] : runs[k, 2]]
        for x in range(len(row)):
            black += row[x] == 0
            saturated += row[x] >= top
            highest = max(highest, row[x])
    return black, saturated, highest
