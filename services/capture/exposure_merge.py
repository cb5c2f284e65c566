"""Exposures of one view merged into its radiance: each pixel's mean over the exposures, weighted by what noise leaves of each.

Of a code the sensor's curve gives the light, radiance times exposure. Its variance has four parts: reading, shot noise, and the step of
the code by the curve's slope; a code that is clipped weighs nothing (Mann and Picard 1995, "On being undigital with digital cameras";
weights of least variance: Granados et al. 2010, "Optimal HDR reconstruction with linear digital cameras").
"""

from typing import NamedTuple

import numpy as np

from vemlight.capture.response import Response
from vemlight.kernels import kernel

FULL_WELL = 15_000.0  # electrons of the top code; sensors of webcams and cameras have 5,000 to 60,000, and weights need no more than that
READ_NOISE = 3.0  # electrons
QUANTISING = 1 / 12  # codes^2, of rounding
CLIPPED = 250 / 255  # of the top code: from here on a pixel may be clipped, by its neighbours' demosaicing or the codes' compression
RATIO_NOISE = 0.1  # relative noise of a pixel that is well exposed, at most; beyond, the median of Poisson's law is below its mean
MAX_RATIO_ERROR = 0.01  # of the median over such pixels; more is no better than the rounding that is to be corrected
MEDIAN_ERROR = (np.pi / 2) ** 0.5  # of a median, in standard errors of the mean, for Gaussian noise
MAX_ROUNDING = 0.10  # by which a shutter time as it is written may differ from the true one: 1/30 is 1/32, 1/13 is 1/12.7


class CodeValues(NamedTuple):
    """What a sensor's codes are worth.

    light: (top + 1,) float64, radiance times exposure of each code, rising; below 0 below the code of darkness. clipped_from: the first
    code that may be clipped. saturated_from: the first that counts as the highest. reach: pixels around a clipped one whose codes it may
    have changed, 0 or 1. rec709_from_light: (3, 3), of merged colours. luminance_scale: cd/m2 per unit of radiance, where known. step:
    between two codes of the device, where `light` has more.
    """

    light: np.ndarray
    clipped_from: int
    saturated_from: int
    reach: int
    rec709_from_light: np.ndarray
    luminance_scale: float | None
    step: float = 1.0

    @property
    def top(self) -> int:
        """The highest code."""
        return len(self.light) - 1

    @property
    def dark(self) -> int:
        """The code of darkness."""
        return max(int(np.searchsorted(self.light, 0.0, side="right")) - 1, 0)

    @property
    def electron(self) -> float:
        """Light of one electron, where the code that is the highest has FULL_WELL of them."""
        return float(self.light[self.saturated_from] - min(self.light[0], 0.0)) / FULL_WELL


def values_from_response(response: Response, reach: int) -> CodeValues:
    """Of a sensor's raw codes, or the codes of each channel; the response holds for its own exposure_s."""
    light = response.radiance(np.arange(response.top + 1, dtype=np.float64)) * response.exposure_s
    return CodeValues(light, clipped_from(response.top), response.top, reach, np.eye(3), response.luminance_scale)


def clipped_from(top: int) -> int:
    """The first code that may be clipped."""
    return int(np.ceil(CLIPPED * top))


def relative_variance(values: CodeValues) -> np.ndarray:
    """Variance of each code's light, (top + 1,) float64, in its unit squared."""
    light = values.light
    step = np.gradient(light) * values.step
    return values.electron * (values.electron * READ_NOISE**2 + np.maximum(light, 0)) + QUANTISING * step**2


def merge_tables(values: CodeValues, exposures: np.ndarray) -> np.ndarray:
    """For each exposure and code its weight times radiance, and its weight: (exposures, top + 1, 2) float32.

    exposures: (n,) float64, falling. A clipped code has no weight, but in the shortest exposure, which is the last: what is clipped there,
    too, is as it says.
    """
    weight = np.square(exposures)[:, None] / relative_variance(values)
    weight[:-1, values.clipped_from :] = 0
    weight /= weight.max()
    return np.stack([weight * values.light / exposures[:, None], weight], axis=-1).astype(np.float32)


def merged(codes: np.ndarray, clipped: np.ndarray | None, tables: np.ndarray, spans: np.ndarray, image: np.ndarray) -> None:
    """Writes the radiance of `spans` (height, 2), first column and one past the last of each row, to `image`, of float32.

    codes: (exposures, height, width), or with three channels (exposures, height, width, 3), which need `clipped`. clipped: (exposures,
    height, width) bool, pixels that are left out; of the last exposure none is.
    """
    if clipped is None:
        _merge_gray(codes, tables, spans, image)
    elif codes.ndim == 3:
        _merge_mosaic(codes, clipped, tables, spans, image)
    else:
        _merge_colours(codes, clipped, tables, spans, image)


@kernel
def _merge_gray(codes, tables, spans, image):
    exposures, height, _ = codes.shape
    for y in range(height):
        for x in range(spans[y, 0], spans[y, 1]):
            light, weight = np.float32(0), np.float32(0)
            for e in range(exposures):
                code = codes[e, y, x]
                light += tables[e, code, 0]
                weight += tables[e, code, 1]
            image[y, x] = light / weight


@kernel
def _merge_mosaic(codes, clipped, tables, spans, image):
    exposures, height, _ = codes.shape
    last = exposures - 1
    for y in range(height):
        for x in range(spans[y, 0], spans[y, 1]):
            light, weight = np.float32(0), np.float32(0)
            for e in range(last):
                if not clipped[e, y, x]:
                    code = codes[e, y, x]
                    light += tables[e, code, 0]
                    weight += tables[e, code, 1]
            code = codes[last, y, x]
            image[y, x] = (light + tables[last, code, 0]) / (weight + tables[last, code, 1])


@kernel
def _merge_colours(codes, clipped, tables, spans, image):
    exposures, height, _, _ = codes.shape
    for y in range(height):
        for x in range(spans[y, 0], spans[y, 1]):
            red, green, blue = np.float32(0), np.float32(0), np.float32(0)
            of_red, of_green, of_blue = np.float32(0), np.float32(0), np.float32(0)
            for e in range(exposures):
                if e == exposures - 1 or not clipped[e, y, x]:
                    r, g, b = codes[e, y, x, 0], codes[e, y, x, 1], codes[e, y, x, 2]
                    red, of_red = red + tables[e, r, 0], of_red + tables[e, r, 1]
                    green, of_green = green + tables[e, g, 0], of_green + tables[e, g, 1]
                    blue, of_blue = blue + tables[e, b, 0], of_blue + tables[e, b, 1]
            image[y, x, 0], image[y, x, 1], image[y, x, 2] = red / of_red, green / of_green, blue / of_blue


def clipped_pixels(codes: np.ndarray, values: CodeValues) -> np.ndarray:
    """Pixels of which any channel may be clipped, and those in reach of one, (height, width) bool.

    One channel alone would give a wrong colour: what it lost, the others kept. codes: (height, width) or (height, width, 3).
    """
    mask = _any_from(codes.reshape(*codes.shape[:2], -1), values.clipped_from)
    if values.reach and mask.any():
        import cv2

        mask = cv2.dilate(mask.view(np.uint8), np.ones((3, 3), np.uint8)).view(bool)
    return mask


@kernel
def _any_from(codes, level):
    height, width, channels = codes.shape
    mask = np.empty((height, width), np.bool_)
    for y in range(height):
        for x in range(width):
            clipped = False
            for c in range(channels):
                clipped |= codes[y, x, c] >= level
            mask[y, x] = clipped
    return mask


@kernel
def count_from(codes, level, spans):
    """How many codes (height, width, channels) inside the spans are at or above a level."""
    count = 0
    for y in range(len(codes)):
        for x in range(spans[y, 0], spans[y, 1]):
            for c in range(codes.shape[2]):
                count += codes[y, x, c] >= level
    return count


def measured_ratio(longer: np.ndarray, shorter: np.ndarray, values: CodeValues, told: float) -> float | None:
    """The ratio of two exposures by their pictures, as the median over pixels well exposed in both; None where there are too few.

    longer, shorter: codes of any shape, the same pixels. told: the ratio that is written, above 1. Which pixels are well exposed is asked
    of the longer exposure, whose noise is smaller: asked of the shorter, noise itself would choose.
    """
    light = values.light
    at_short = np.interp(light / told, light, np.arange(values.top + 1))  # codes that the shorter exposure should have
    noise = np.sqrt(np.interp(at_short, np.arange(values.top + 1), relative_variance(values)))
    relative = noise / np.maximum(light / told, noise)
    good = relative < RATIO_NOISE
    good[values.clipped_from :] = False
    used = good[longer]
    pixels = longer[used]
    if not len(pixels) or MEDIAN_ERROR * np.sqrt(np.mean(relative[pixels] ** 2) / len(pixels)) > MAX_RATIO_ERROR:
        return None
    ratio = np.median(light[shorter[used]] / light[pixels])
    return float(1 / ratio) if ratio > 0 else None
