"""The map's luminance as numbers, small enough for a page that asks what is under the pointer."""

import struct

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.sphere import Coverage, cell_solid_angles
from vemlight.runtime import wire

MAX_CELLS = 16_384  # 64 kB of float32: two degrees of a hemisphere; 4,096 to 65,536 would do
# "sky1", rows, columns, coverage (0 hemisphere, 1 sphere), 0, cd/m2 per unit (0: not calibrated), luminance integrated over solid angle
HEAD = struct.Struct("<4s4Hff")
LARGEST = float(np.finfo(np.float32).max)
COVERAGES: tuple[Coverage, ...] = ("hemisphere", "sphere")


def sky_values(header: wire.MapMessage, radiance: np.ndarray) -> bytes:
    """HEAD, then the mean luminance of each cell of a polar map of at most MAX_CELLS cells, (rows, cols) float32, in the map's unit."""
    luminance = luminance_from_rgb(radiance.astype(np.float64))
    rows, cols = luminance.shape
    side = max(1.0, float(np.sqrt(rows * cols / MAX_CELLS)))
    fewer_rows, fewer_cols = max(1, int(rows / side)), max(1, int(cols / side))
    area = np.broadcast_to(cell_solid_angles(rows, cols, header.coverage)[:, None], luminance.shape)
    down, across = _overlaps(rows, fewer_rows), _overlaps(cols, fewer_cols)
    means = (down @ (luminance * area) @ across.T) / (down @ area @ across.T)
    total = min(float((luminance * area).sum()), LARGEST)
    head = HEAD.pack(b"sky1", fewer_rows, fewer_cols, COVERAGES.index(header.coverage), 0, header.luminance_scale or 0.0, total)
    return head + np.minimum(means, LARGEST).astype("<f4").tobytes()


def _overlaps(count: int, fewer: int) -> np.ndarray:
    """How much of each of `count` intervals lies in each of `fewer` that span the same, (fewer, count)."""
    edges, own = np.linspace(0, count, fewer + 1), np.arange(count)
    return np.clip(np.minimum(edges[1:, None], own + 1) - np.maximum(edges[:-1, None], own), 0, None)
