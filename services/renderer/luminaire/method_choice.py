"""Which method draws a light field, and with how many samples: by the error that each leaves on walls across the axis.

The bound of the shift-invariant approximation (`shift_invariant.error_bound`) is 57 % for planes 10 spacings apart, and what it bounds is
mostly 5 to 15 %: neighbouring functions err in opposite directions. So where a lamp's bound does not settle it, both methods are tried.
"""

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.renderer.luminaire.estimator import interleaved_shifts, irradiance_receivers, shade
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.shift_invariant import DrawnBy, is_shift_invariant, radiance_images
from vemlight.renderer.luminaire.tables import SummedAreaTables, summed_area_tables

DISTANCES = (1.0, 2.0, 5.0, 20.0)  # of the walls, in distances between the planes: from where rooms begin to the far field
WALL_POINTS = 8  # on a side: 256 points on four walls, which tell an error to a tenth of itself
WALL_PART = 0.8  # of what the window of S spans there: its rim is dark
TRUTH_SAMPLES = 8192  # of a point: a noise of 1 to 2 %, far below the errors that are compared
EQUAL_SAMPLES = 128  # take three times as long as the approximation, so that a lamp is sampled only where that is clearly truer
NOISE = 0.1  # that is left to a pixel where the scene file names no number of samples; the grain of 4 x 4 pixels has a quarter of it
LEAST_BOX = 1e-3  # pixels: a point on S sees a single point of each image. 1e-6 to 1e-2 do
SAMPLE_COUNTS = (64, 128, 256, 512)  # more take a minute for a picture without a GPU


def chosen_method(field: LightField, method: str, samples: int | None) -> DrawnBy:
    """How to draw a light field. method: "auto", "sampled" or "shift-invariant"; samples: of a pixel, None: as NOISE needs.

    "auto" is shift-invariant where the bound allows it, and where its error is not above that of the samples, or of EQUAL_SAMPLES.
    """
    if method == "shift-invariant" or (method == "auto" and is_shift_invariant(field)):
        return DrawnBy(True, samples or SAMPLE_COUNTS[0])
    if method == "sampled" and samples:
        return DrawnBy(False, samples)
    walls = _Walls(field)
    shift_invariant_error = walls.error(walls.approximated())
    sampling_error = walls.error(walls.sampled(samples or EQUAL_SAMPLES))
    if method == "auto" and shift_invariant_error <= sampling_error:
        return DrawnBy(True, samples or SAMPLE_COUNTS[0], shift_invariant_error, sampling_error)
    if samples is None:
        samples = next((count for count in SAMPLE_COUNTS if walls.error(walls.sampled(count)) <= NOISE), SAMPLE_COUNTS[-1])
    return DrawnBy(False, samples, shift_invariant_error, sampling_error)


class _Walls:
    """Points on walls across the axis, and their irradiance as luminance."""

    def __init__(self, field: LightField) -> None:
        self._field, self._tables = field, summed_area_tables(field)
        low_s, low_t, high_s, high_t = field.window_m
        at = (np.arange(WALL_POINTS) + 0.5) / WALL_POINTS - 0.5
        rows, columns = np.divmod(np.arange(WALL_POINTS**2), WALL_POINTS)
        walls = []
        for distance in DISTANCES:
            x, y = (low_s + high_s) / 2 + at * WALL_PART * (high_s - low_s), (low_t + high_t) / 2 + at * WALL_PART * (high_t - low_t)
            walls.append(np.stack([distance * x[columns], distance * y[rows], np.full(len(rows), distance * field.distance_m)], axis=-1))
        self.points = np.concatenate(walls)
        self._shifts = np.tile(interleaved_shifts(rows, columns, 4), (len(DISTANCES), 1))
        self.truth = self.sampled(TRUTH_SAMPLES)

    def sampled(self, samples: int) -> np.ndarray:
        """By so many samples a point."""
        receivers = irradiance_receivers(self.points, np.tile([0.0, 0.0, -1.0], (len(self.points), 1)))
        return luminance_from_rgb(shade(self._tables, receivers, self._shifts, samples))

    def approximated(self) -> np.ndarray:
        """By the shift-invariant approximation."""
        return luminance_from_rgb(spots_irradiance(self._field, self._tables, self.points))

    def error(self, irradiance: np.ndarray) -> float:
        """Root of the mean square, over the walls, of each wall's RMS error over its mean; 0 of a lamp without light."""
        there, truth = (values.reshape(len(DISTANCES), -1) for values in (irradiance, self.truth))
        means = np.maximum(truth.mean(axis=1, keepdims=True), 1e-30)
        return float(np.sqrt((((there - truth) / means) ** 2).mean()))


def spots_irradiance(field: LightField, tables: SummedAreaTables, points: np.ndarray) -> np.ndarray:
    """The shift-invariant approximation's irradiance (n, 3) of points (n, 3) before the planes, of walls that face the lamp.

    Granier et al. 2003, equation 14: of each function its spot at its centre, times the mean of its image over what the point sees.
    """
    rows, cols, height, width, _ = field.images.shape
    images = radiance_images(field).reshape(rows * cols, height, width, 3)
    total = np.zeros((len(points), 3))
    ratio = (tables.distance / points[:, 2])[:, None]
    for image, low, high in zip(images, tables.support_low, tables.support_high, strict=True):
        sums = np.zeros((height + 1, width + 1, 3))
        sums[1:, 1:] = image.cumsum(axis=0, dtype=np.float64).cumsum(axis=1)
        ends = np.stack([end + ratio * (points[:, :2] - end) for end in (low, high)])  # (end, n, axis), on S
        ends = np.sort((ends - tables.window_low) / tables.pixel, axis=0)
        ends[1] = np.maximum(ends[1], ends[0] + LEAST_BOX)
        area = np.prod(ends[1] - ends[0], axis=-1)
        seen = [_sum_below(sums, ends[a, :, 0], ends[b, :, 1]) for a, b in ((1, 1), (0, 1), (1, 0), (0, 0))]
        mean = (seen[0] - seen[1] - seen[2] + seen[3]) / area[:, None]
        offset = (low + high) / 2 - points[:, :2]
        squared = (offset**2).sum(axis=-1) + points[:, 2] ** 2
        total += mean * (points[:, 2] ** 2 / squared**2)[:, None]
    return total * field.spacing_m**2


def _sum_below(sums: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The sum (n, 3) of an image's pixels left of x and below y, pixels, of its table (height + 1, width + 1, 3); between pixels linear."""
    height, width = sums.shape[0] - 1, sums.shape[1] - 1
    x, y = np.clip(x, 0, width), np.clip(y, 0, height)
    i, j = np.minimum(x.astype(np.int64), width - 1), np.minimum(y.astype(np.int64), height - 1)
    a, b = (x - i)[:, None], (y - j)[:, None]
    below, above = sums[j, i] * (1 - a) + sums[j, i + 1] * a, sums[j + 1, i] * (1 - a) + sums[j + 1, i + 1] * a
    return below * (1 - b) + above * b
