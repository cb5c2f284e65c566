"""Planes of codes, as decoders and cameras give them, made into linear Rec. 709.

Every layout (planar, two planes, packed, subsampled or not, 8 to 16 bits) is one rule for where a component's code lies. Colour that is
stored for blocks of pixels holds in its whole block, so that what a block's mean was remains its mean. No image in float64 is made.
"""

import re
from typing import Any, NamedTuple

import numpy as np

from vemlight.capture.colour_coding import ENTRIES, LOWEST, PER_SIGNAL, REC2020_LUMINANCE, ColourCoding, signal_from_codes, white_entry
from vemlight.capture.scatter import MAP_PARTS, Threads
from vemlight.errors import UserError
from vemlight.kernels import kernel, subroutine


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
        blue, red = (Component(plane, 0, 1, across, down) for plane in (1, 2))
        return Layout((Component(0, 0, 1, 0, 0), blue, red), int(match[2] or 8), 0, False)
    if match := PLANAR_RGB.fullmatch(name):
        red, green, blue = (Component(plane, 0, 1, 0, 0) for plane in (2, 0, 1))
        return Layout((red, green, blue), int(match[1] or 8), 0, True)
    if match := GRAY.fullmatch(name):
        gray = Component(0, 0, 1, 0, 0)
        return Layout((gray, gray, gray), int(match[1] or 8), 0, True)
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


def linear_from_planes(
    planes: Planes, coding: ColourCoding, spans: np.ndarray, threads: Threads, pixels: np.ndarray | None = None
) -> LinearPicture:
    """Linear Rec. 709 of the pixels inside `spans` (height, 2): first column of each row and one past the last.

    Colours outside Rec. 709 have components below 0. pixels: of an earlier picture with the same spans, to be written again.
    """
    layout = planes.layout
    to_index = signal_from_codes(coding, layout.bits, layout.is_rgb) * PER_SIGNAL
    to_index[:, 3] -= LOWEST * PER_SIGNAL
    white = np.float32(white_entry(layout.bits))
    if pixels is None:
        pixels = np.zeros((planes.height, planes.width, 3), np.float32)
    ends = np.linspace(0, planes.height, MAP_PARTS + 1).astype(int)
    counts = np.zeros(planes.height, np.int64)
    components = [planes.samples[component.plane] for component in layout.components]
    places = tuple(component[1:] for component in layout.components)
    numbers = (to_index.astype(np.float32), coding.rec709_from_light.astype(np.float32))
    display = np.array([coding.display_gain, coding.display_exponent, *REC2020_LUMINANCE], np.float32)

    def job(rows: slice) -> None:
        begin, end = rows.start, rows.stop
        _linear_rows(pixels, *components, places, layout.shift, spans, *numbers, coding.table, display, white, counts, begin, end)

    threads.run(job, ends)
    return LinearPicture(pixels, int(counts.sum()))


def codes_from_planes(planes: Planes, coding: ColourCoding, spans: np.ndarray, threads: Threads) -> np.ndarray:
    """Red, green and blue of the pixels inside `spans` as entries of the coding's table, (height, width, 3) uint16."""
    layout = planes.layout
    to_index = signal_from_codes(coding, layout.bits, layout.is_rgb) * PER_SIGNAL
    to_index[:, 3] += 0.5 - LOWEST * PER_SIGNAL  # the nearest
    entries = np.zeros((planes.height, planes.width, 3), np.uint16)
    components = [planes.samples[component.plane] for component in layout.components]
    places = tuple(component[1:] for component in layout.components)

    def job(rows: slice) -> None:
        _entry_rows(entries, *components, places, layout.shift, spans, to_index.astype(np.float32), rows.start, rows.stop)

    threads.run(job, np.linspace(0, planes.height, MAP_PARTS + 1).astype(int))
    return entries


@kernel(nogil=True)
def _entry_rows(entries, first, second, third, places, shift, spans, to_index, begin, end):
    (a_at, a_step, a_across, a_down), (b_at, b_step, b_across, b_down), (c_at, c_step, c_across, c_down) = places
    (ra, rb, rc, r1), (ga, gb, gc, g1), (ba, bb, bc, b1) = _row4(to_index, 0), _row4(to_index, 1), _row4(to_index, 2)
    none, last = np.float32(0), np.float32(ENTRIES - 1)
    for y in range(begin, end):
        row_a, row_b, row_c, row = first[y >> a_down], second[y >> b_down], third[y >> c_down], entries[y]
        for x in range(spans[y, 0], spans[y, 1]):
            a = np.float32(row_a[a_at + (x >> a_across) * a_step] >> shift)
            b = np.float32(row_b[b_at + (x >> b_across) * b_step] >> shift)
            c = np.float32(row_c[c_at + (x >> c_across) * c_step] >> shift)
            row[x, 0] = np.uint16(min(max(ra * a + rb * b + rc * c + r1, none), last))
            row[x, 1] = np.uint16(min(max(ga * a + gb * b + gc * c + g1, none), last))
            row[x, 2] = np.uint16(min(max(ba * a + bb * b + bc * c + b1, none), last))


@kernel(nogil=True)
def _linear_rows(pixels, first, second, third, places, shift, spans, to_index, rec709, table, display, white, counts, begin, end):
    # numbers of the loop are copied out of their arrays, which `pixels` might overlap for all that the compiler knows
    (a_at, a_step, a_across, a_down), (b_at, b_step, b_across, b_down), (c_at, c_step, c_across, c_down) = places
    (ra, rb, rc, r1), (ga, gb, gc, g1), (ba, bb, bc, b1) = _row4(to_index, 0), _row4(to_index, 1), _row4(to_index, 2)
    (rr, rg, rb_), (gr, gg, gb_), (br, bg, bb_) = _row3(rec709, 0), _row3(rec709, 1), _row3(rec709, 2)
    gain, exponent, of_red, of_green, of_blue = display[0], display[1], display[2], display[3], display[4]
    last, none = np.float32(len(table) - 1.001), np.float32(0)
    for y in range(begin, end):
        row_a, row_b, row_c, row = first[y >> a_down], second[y >> b_down], third[y >> c_down], pixels[y]
        saturated = 0
        for x in range(spans[y, 0], spans[y, 1]):
            a = np.float32(row_a[a_at + (x >> a_across) * a_step] >> shift)
            b = np.float32(row_b[b_at + (x >> b_across) * b_step] >> shift)
            c = np.float32(row_c[c_at + (x >> c_across) * c_step] >> shift)
            r, g, b = ra * a + rb * b + rc * c + r1, ga * a + gb * b + gc * c + g1, ba * a + bb * b + bc * c + b1
            saturated += (r >= white) + (g >= white) + (b >= white)
            r, g, b = min(max(r, none), last), min(max(g, none), last), min(max(b, none), last)
            i, j, k = np.uint32(r), np.uint32(g), np.uint32(b)
            r = table[i] + (r - np.float32(i)) * (table[i + np.uint32(1)] - table[i])
            g = table[j] + (g - np.float32(j)) * (table[j + np.uint32(1)] - table[j])
            b = table[k] + (b - np.float32(k)) * (table[k + np.uint32(1)] - table[k])
            if gain > none:
                shown = gain * max(of_red * r + of_green * g + of_blue * b, none) ** exponent
                r, g, b = shown * r, shown * g, shown * b
            row[x, 0] = rr * r + rg * g + rb_ * b
            row[x, 1] = gr * r + gg * g + gb_ * b
            row[x, 2] = br * r + bg * g + bb_ * b
        counts[y] = saturated


@subroutine
def _row3(matrix, n):
    return matrix[n, 0], matrix[n, 1], matrix[n, 2]


@subroutine
def _row4(matrix, n):
    return matrix[n, 0], matrix[n, 1], matrix[n, 2], matrix[n, 3]
