"""The map's luminance as numbers, small enough for a page that asks what is under the pointer."""

import struct

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.sphere import Coverage, cell_solid_angles
from vemlight.runtime import wire
from vemlight.viewer.fewer_cells import fewer_cells

MAX_CELLS = 16_384  # 64 kB of float32: two degrees of a hemisphere; 4,096 to 65,536 would do
# "sky1", rows, columns, coverage (0 hemisphere, 1 sphere), 0, cd/m2 per unit (0: not calibrated), luminance integrated over solid angle
HEAD = struct.Struct("<4s4Hff")
LARGEST = float(np.finfo(np.float32).max)
COVERAGES: tuple[Coverage, ...] = ("hemisphere", "sphere")


def sky_values(header: wire.MapMessage, radiance: np.ndarray) -> bytes:
    """HEAD, then the mean luminance of each cell of a polar map of at most MAX_CELLS cells, (rows, cols) float32, in the map's unit."""
    luminance = luminance_from_rgb(radiance.astype(np.float64))
    means = fewer_cells(luminance, header.coverage, MAX_CELLS)
    total = min(float(cell_solid_angles(len(luminance), luminance.shape[1], header.coverage) @ luminance.sum(axis=1)), LARGEST)
    head = HEAD.pack(b"sky1", means.shape[0], means.shape[1], COVERAGES.index(header.coverage), 0, header.luminance_scale or 0.0, total)
    return head + np.minimum(means, LARGEST).astype("<f4").tobytes()
