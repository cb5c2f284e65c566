"""Planes of codes, as decoders and cameras give them, made into linear Rec. 709.

Every layout (planar, two planes, packed, subsampled or not, 8 to 16 bits) is one rule for where a component's code lies. Colour that is
stored for blocks of pixels holds in its whole block, so that what a block's mean was remains its mean. No image in float64 is made.
"""

import re
from typing import Any, NamedTuple

import numpy as np

from vemlight.capture.colour_coding import ENTRIES, HIGHEST, LOWEST, REC2020_LUMINANCE, ColourCoding, signal_from_codes
from vemlight.capture.scatter import MAP_PARTS, Threads
from vemlight.errors import UserError
from vemlight.kernels import kernel


class Component(NamedTuple):
    """Where the codes of one component lie: row y, column x at [y >> down, offset + (x >> across) * step] of its plane."""

    plane: int
    offset: int
    step: int
    across: int
    down: int


class Layout(NamedTuple):
    """How a frame's planes hold its pixels. components: R, G, B or Y, Cb, Cr; three times the same one for gray."""

    components: tuple[Component, Component, Component]
    bits: int
    shift: int  # right, from the sample as stored to the code
    is_rgb: bool  # gray, too: no matrix

    @property
    def item(self) -> int:
        """Bytes of a sample."""
        return 1 if self.bits + self.shift <= 8 else 2


class Planes(NamedTuple):
    """One frame's planes, each (rows, samples) uint8 or uint16, in this machine's byte order; rows may be longer than the picture."""

    samples: tuple[np.ndarray, ...]
    width: int
    height: int
    layout: Layout


SUBSAMPLING = {"420": (1, 1), "422": (1, 0), "444": (0, 0), "440": (0, 1), "411": (2, 0), "410": (2, 2)}  # log2 across, down
PLANAR = re.compile(r"yuv[aj]?(420|422|444|440|411|410)p(\d*)(?:le)?")
PLANAR_RGB = re.compile(r"gbra?p(\d*)(?:le)?")
GRAY = re.compile(r"gray(\d*)(?:le)?")
BIPLANAR = {"nv12": ("420", 8, 0), "nv16": ("422", 8, 0), "nv24": ("444", 8, 0), "p010": ("420", 10, 6), "p012": ("420", 12, 4),
            "p016": ("420", 16, 0), "p210": ("422", 10, 6), "p212": ("422", 12, 4), "p216": ("422", 16, 0), "p410": ("444", 10, 6),
            "p412": ("444", 12, 4), "p416": ("444", 16, 0)}  # fmt: skip
PACKED_YUV = {"yuyv422": (0, 1, 3), "uyvy422": (1, 0, 2), "yvyu422": (0, 3, 1)}  # offsets of Y, Cb, Cr in two pixels' bytes
PACKED_RGB = {"rgb24": ((0, 1, 2), 3, 8), "bgr24": ((2, 1, 0), 3, 8), "rgba": ((0, 1, 2), 4, 8), "bgra": ((2, 1, 0), 4, 8),
              "rgb0": ((0, 1, 2), 4, 8), "bgr0": ((2, 1, 0), 4, 8), "argb": ((1, 2, 3), 4, 8), "abgr": ((3, 2, 1), 4, 8),
              "0rgb": ((1, 2, 3), 4, 8), "0bgr": ((3, 2, 1), 4, 8), "rgb48": ((0, 1, 2), 3, 16), "bgr48": ((2, 1, 0), 3, 16),
              "rgba64": ((0, 1, 2), 4, 16), "bgra64": ((2, 1, 0), 4, 16)}  # fmt: skip


def layout_of(name: str) -> Layout | None:
    """The layout that FFmpeg calls by that name; None for those that are not read: palettes, floats, big-endian ones."""
    if match := PLANAR.fullmatch(name):
        across, down = SUBSAMPLING[match[1]]
        chroma = [Component(plane, 0, 1, across, down) for plane in (1, 2)]
        return Layout((Component(0, 0, 1, 0, 0), *chroma), int(match[2] or 8), 0, False)
    if match := PLANAR_RGB.fullmatch(name):
        red, green, blue = (Component(plane, 0, 1, 0, 0) for plane in (2, 0, 1))
        return Layout((red, green, blue), int(match[1] or 8), 0, True)
    if match := GRAY.fullmatch(name):
        return Layout((Component(0, 0, 1, 0, 0),) * 3, int(match[1] or 8), 0, True)
    short = name.removesuffix("le")
    if short in BIPLANAR or name == "nv21":
        ratio, bits, shift = BIPLANAR["nv12" if name == "nv21" else short]
        across, down = SUBSAMPLING[ratio]
        first, second = (1, 0) if name == "nv21" else (0, 1)
        return Layout(
            (Component(0, 0, 1, 0, 0), Component(1, first, 2, across, down), Component(1, second, 2, across, down)), bits, shift, False
        )
    if name in PACKED_YUV:
        luma, blue, red = PACKED_YUV[name]
        return Layout((Component(0, luma, 2, 0, 0), Component(0, blue, 4, 1, 0), Component(0, red, 4, 1, 0)), 8, 0, False)
    if short in PACKED_RGB:
        (red, green, blue), step, bits = PACKED_RGB[short]
        return Layout((Component(0, red, step, 0, 0), Component(0, green, step, 0, 0), Component(0, blue, step, 0, 0)), bits, 0, True)
    return None


def planes_from_video_frame(name: str, frame: Any) -> Planes:
    """The planes of a frame that PyAV decoded, not copied. Raises UserError, with the file's `name`, for a layout that is not read."""
    layout = layout_of(frame.format.name)
    if layout is None or any(plane.line_size <= 0 for plane in frame.planes):
        raise UserError(f"{name}: its pixels are {frame.format.name}, which is not read; convert it to yuv422p10, yuv444p12 or rgb48")
    dtype = np.uint8 if layout.item == 1 else np.uint16
    samples = tuple(np.frombuffer(plane, dtype).reshape(-1, plane.line_size // layout.item) for plane in frame.planes)
    return Planes(samples, frame.width, frame.height, layout)


def planes_from_image(pixels: np.ndarray, bits: int) -> Planes:
    """The planes of a still (height, width) or (height, width, 3) RGB, uint8 or uint16 of so many bits."""
    height, width = pixels.shape[:2]
    layout = layout_of("rgb24" if pixels.ndim == 3 else "gray")
    assert layout is not None
    return Planes((np.ascontiguousarray(pixels).reshape(height, -1),), width, height, layout._replace(bits=bits))


class LinearPicture(NamedTuple):
    """pixels: (height, width, 3) float32, linear Rec. 709, 0 outside the spans. saturated: values in them at or above signal 1."""

    pixels: np.ndarray
    saturated: int


def linear_from_planes(planes: Planes, coding: ColourCoding, spans: np.ndarray, threads: Threads) -> LinearPicture:
    """Linear Rec. 709 of the pixels inside `spans` (height, 2): first column of each row and one past the last.

    Colours outside Rec. 709 have components below 0.
    """
    layout = planes.layout
    signals = signal_from_codes(coding, layout.bits, layout.is_rgb)
    to_index = signals * ((ENTRIES - 1) / (HIGHEST - LOWEST))
    to_index[:, 3] += -LOWEST * (ENTRIES - 1) / (HIGHEST - LOWEST)
    # signal 1 itself, less half of the smallest step: a code above it is white
    white = np.float32(((1 - 0.5 / (2**layout.bits - 1)) - LOWEST) * (ENTRIES - 1) / (HIGHEST - LOWEST))
    pixels = np.zeros((planes.height, planes.width, 3), np.float32)
    ends = np.linspace(0, planes.height, MAP_PARTS + 1).astype(int)
    counts = np.zeros(planes.height, np.int64)
    components = [planes.samples[component.plane] for component in layout.components]
    places = np.array([component[1:] for component in layout.components])
    display = np.array([coding.display_gain, coding.display_exponent, *REC2020_LUMINANCE], np.float32)

    def job(rows: slice) -> None:
        _linear_rows(pixels, *components, places, layout.shift, spans, to_index.astype(np.float32), coding.table,
                     coding.rec709_from_light.astype(np.float32), display, white, counts, rows.start, rows.stop)  # fmt: skip

    threads.run(job, ends)
    return LinearPicture(pixels, int(counts.sum()))


@kernel(nogil=True)
def _linear_rows(pixels, first, second, third, places, shift, spans, to_index, table, rec709, display, white, counts, begin, end):
    last = np.float32(len(table) - 1.001)
    for y in range(begin, end):
        row0, row1, row2 = first[y >> places[0, 3]], second[y >> places[1, 3]], third[y >> places[2, 3]]
        saturated = 0
        for x in range(spans[y, 0], spans[y, 1]):
            a = np.float32(row0[places[0, 0] + (x >> places[0, 2]) * places[0, 1]] >> shift)
            b = np.float32(row1[places[1, 0] + (x >> places[1, 2]) * places[1, 1]] >> shift)
            c = np.float32(row2[places[2, 0] + (x >> places[2, 2]) * places[2, 1]] >> shift)
            r = to_index[0, 0] * a + to_index[0, 1] * b + to_index[0, 2] * c + to_index[0, 3]
            g = to_index[1, 0] * a + to_index[1, 1] * b + to_index[1, 2] * c + to_index[1, 3]
            b = to_index[2, 0] * a + to_index[2, 1] * b + to_index[2, 2] * c + to_index[2, 3]
            saturated += (r >= white) + (g >= white) + (b >= white)
            r, g, b = min(max(r, np.float32(0)), last), min(max(g, np.float32(0)), last), min(max(b, np.float32(0)), last)
            i, j, k = np.int32(r), np.int32(g), np.int32(b)
            r = table[i] + (r - np.float32(i)) * (table[i + 1] - table[i])
            g = table[j] + (g - np.float32(j)) * (table[j + 1] - table[j])
            b = table[k] + (b - np.float32(k)) * (table[k + 1] - table[k])
            if display[0] > 0:
                scene = max(display[2] * r + display[3] * g + display[4] * b, np.float32(0))
                gain = display[0] * scene ** display[1]
                r, g, b = gain * r, gain * g, gain * b
            pixels[y, x, 0] = rec709[0, 0] * r + rec709[0, 1] * g + rec709[0, 2] * b
            pixels[y, x, 1] = rec709[1, 0] * r + rec709[1, 1] * g + rec709[1, 2] * b
            pixels[y, x, 2] = rec709[2, 0] * r + rec709[2, 1] * g + rec709[2, 2] * b
        counts[y] = saturated
