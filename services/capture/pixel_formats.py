"""The pixel formats of the kernel's and of GenICam's cameras: their names, and how a frame's bytes are codes, or planes of a picture."""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from vemlight.capture.mosaic import Mosaic
from vemlight.capture.planes import Planes, layout_of
from vemlight.errors import UserError
from vemlight.kernels import kernel

BIG_ENDIAN = 1 << 31  # in a format's code
MJPEG = "mjpeg"  # instead of a layout: each frame is a JPEG file
Packing = Literal["", "mipi", "lsb", "gige"]  # how codes of 10 to 14 bits lie without gaps between them; "": each in whole bytes


class PixelFormat(NamedTuple):
    """How a frame's bytes are codes."""

    name: str  # the kernel's four letters, followed by -BE for the big-endian form; or GenICam's name
    dtype: str
    mosaic: Mosaic | None  # None: a picture in colour
    bits: int
    packing: Packing = ""
    layout: str = ""  # FFmpeg's name of the layout of a picture in colour, or MJPEG
    is_swapped: bool = False  # the third plane comes before the second
    planes_apart: bool = False  # planes in buffers of their own (multi-planar)

    @property
    def stored_bits(self) -> int:
        """Bits that a pixel of codes takes."""
        return 12 if self.packing == "gige" else self.bits if self.packing else 8 * np.dtype(self.dtype).itemsize


FOURCC_BY_BITS: dict[Mosaic, dict[int, str]] = {  # the kernel's four letters
    "mono": {8: "GREY", 10: "Y10 ", 12: "Y12 ", 16: "Y16 "},
    "BGGR": {8: "BA81", 10: "BG10", 12: "BG12", 16: "BYR2"},
    "GBRG": {8: "GBRG", 10: "GB10", 12: "GB12", 16: "GB16"},
    "GRBG": {8: "GRBG", 10: "BA10", 12: "BA12", 16: "GR16"},
    "RGGB": {8: "RGGB", 10: "RG10", 12: "RG12", 16: "RG16"},
}
PACKED_FOURCC_BY_BITS: dict[Mosaic, dict[int, str]] = {  # MIPI's RAW10 and RAW12
    "mono": {10: "Y10P", 12: "Y12P"},
    "BGGR": {10: "pBAA", 12: "pBCC"},
    "GBRG": {10: "pGAA", 12: "pGCC"},
    "GRBG": {10: "pgAA", 12: "pgCC"},
    "RGGB": {10: "pRAA", 12: "pRCC"},
}
PFNC_MOSAICS: dict[str, Mosaic] = {"Mono": "mono", "BayerRG": "RGGB", "BayerGR": "GRBG", "BayerGB": "GBRG", "BayerBG": "BGGR"}
PFNC_CODES: tuple[tuple[str, int, Packing], ...] = (  # what follows these names, bits, packing (GenICam, Pixel Format Naming Convention)
    ("8", 8, ""), ("10", 10, ""), ("12", 12, ""), ("14", 14, ""), ("16", 16, ""), ("10p", 10, "lsb"), ("12p", 12, "lsb"),
    ("14p", 14, "lsb"), ("10Packed", 10, "gige"), ("12Packed", 12, "gige"),
)  # fmt: skip
PFNC_PICTURES = (("RGB8", "rgb24"), ("BGR8", "bgr24"), ("RGBa8", "rgba"), ("BGRa8", "bgra"))  # name, layout; the best first
PICTURES = (  # four letters, layout, second and third plane swapped, planes apart; the best first
    ("RGB3", "rgb24", False, False), ("BGR3", "bgr24", False, False), ("NV24", "nv24", False, False), ("422P", "yuv422p", False, False),
    ("YUYV", "yuyv422", False, False), ("UYVY", "uyvy422", False, False), ("YVYU", "yvyu422", False, False),
    ("NV16", "nv16", False, False), ("P010", "p010le", False, False), ("NV12", "nv12", False, False), ("NV21", "nv21", False, False),
    ("YU12", "yuv420p", False, False), ("YV12", "yuv420p", True, False), ("NM16", "nv16", False, True), ("NM12", "nv12", False, True),
    ("NM21", "nv21", False, True), ("YM12", "yuv420p", False, True), ("YM21", "yuv420p", True, True), ("YM16", "yuv422p", False, True),
    ("MJPG", MJPEG, False, False), ("JPEG", MJPEG, False, False),
)  # fmt: skip


def _formats() -> dict[int, PixelFormat]:
    formats = {}
    for mosaic, by_bits in FOURCC_BY_BITS.items():
        for bits, fourcc in by_bits.items():
            code = _code(fourcc)
            formats[code] = PixelFormat(fourcc.strip(), "<u1" if bits == 8 else "<u2", mosaic, bits)
            if bits > 8:
                formats[code | BIG_ENDIAN] = PixelFormat(fourcc.strip() + "-BE", ">u2", mosaic, bits)
    for mosaic, by_bits in PACKED_FOURCC_BY_BITS.items():
        for bits, fourcc in by_bits.items():
            formats[_code(fourcc)] = PixelFormat(fourcc, "<u1", mosaic, bits, packing="mipi")
    for fourcc, layout, is_swapped, apart in PICTURES:
        bits = 10 if layout == "p010le" else 8
        dtype = "<u2" if bits > 8 else "<u1"
        formats[_code(fourcc)] = PixelFormat(fourcc, dtype, None, bits, layout=layout, is_swapped=is_swapped, planes_apart=apart)
    return formats


def _code(fourcc: str) -> int:
    return int.from_bytes(fourcc.encode(), "little")


def _pfnc_formats() -> dict[str, PixelFormat]:
    formats = {}
    for kind, mosaic in PFNC_MOSAICS.items():
        for suffix, bits, packing in PFNC_CODES:
            formats[kind + suffix] = PixelFormat(kind + suffix, "<u2" if bits > 8 and not packing else "<u1", mosaic, bits, packing)
    return formats | {name: PixelFormat(name, "<u1", None, 8, layout=layout) for name, layout in PFNC_PICTURES}


FORMATS = _formats()  # by the kernel's code
PFNC_FORMATS = _pfnc_formats()  # by GenICam's name
PICTURE_RANK = {fourcc: rank for rank, (fourcc, *_) in enumerate(PICTURES)}


def mosaic_of(form: str) -> Mosaic | None:
    """The mosaic of the format called `form`, None for an empty name. Raises UserError for an unknown one, and for one in colour."""
    if not form:
        return None
    raw = [known for known in FORMATS.values() if known.mosaic]
    for known in raw:
        if known.name == form:
            return known.mosaic
    fault = "is in colour, which no mosaic is" if form in PICTURE_RANK else "is not known"
    raise UserError(f"[capture] format = {form[:20]!r} {fault}; it is one of {', '.join(f.name for f in raw)}")


def codes_from_bytes(data: Any, form: PixelFormat, width: int, height: int, stride: int) -> np.ndarray:
    """The codes (height, width) uint8 or uint16, in this machine's byte order, of a frame's bytes with rows `stride` bytes apart.

    Raises ValueError when there are fewer bytes than that takes.
    """
    bits = form.stored_bits
    length = -(-width * bits // 8)
    if form.packing in ("lsb", "gige") and width * bits % 8 and stride == length:
        # rows of these without padding follow each other bit by bit, and may begin within a byte
        whole = -(-width * height * bits // 8)
        rows, across = _rows(data, 0, whole, 1, whole, (width, height)), width * height
    else:
        rows, across = _rows(data, 0, length, height, stride, (width, height)), width
    if form.packing == "mipi":
        return _unpacked(rows, width, form.bits)
    if form.packing:
        unpacked = _unpacked_lsb(rows, across, form.bits) if form.packing == "lsb" else _unpacked_gige(rows, across, form.bits)
        return unpacked.reshape(height, width)
    codes = rows[:, :length].copy().view(form.dtype)
    return codes.astype(codes.dtype.newbyteorder("="), copy=False)


def _rows(data: Any, start: int, length: int, height: int, stride: int, size: tuple[int, int]) -> np.ndarray:
    """(height, stride) uint8: rows of `length` bytes that are `stride` apart, from `start` on; the last one may end with its pixels.

    size: of the picture, for the error.
    """
    if stride < length or len(data) < start + stride * (height - 1) + length:
        raise ValueError(f"{len(data)} bytes are no frame of {size[0]}x{size[1]}")
    rows = np.frombuffer(data, np.uint8, min(len(data) - start, stride * height), start)
    if len(rows) < stride * height:
        rows = np.pad(rows, (0, stride * height - len(rows)))
    return rows.reshape(height, stride)


@kernel
def _unpacked(rows, width, bits):
    """Codes of 10 bits, four in five bytes with the low bits in the fifth, the first pixel's lowest; or of 12 bits, two in three bytes."""
    codes = np.empty((len(rows), width), np.uint16)
    group = 4 if bits == 10 else 2
    low_bits = bits - 8
    for y in range(len(rows)):
        for x in range(width):
            at, place = x // group * (group + 1), x % group
            high, low = np.uint16(rows[y, at + place]), rows[y, at + group] >> (place * low_bits)
            codes[y, x] = (high << low_bits) | (low & ((1 << low_bits) - 1))
    return codes


@kernel
def _unpacked_lsb(rows, width, bits):
    """Codes of PFNC's 10p, 12p and 14p: one after the other from the lowest bit on."""
    codes = np.empty((len(rows), width), np.uint16)
    last = rows.shape[1] - 1
    for y in range(len(rows)):
        if bits == 12:  # the usual one, in a fifth of the time: 0.6 ms for 2 megapixels
            for x in range(width):
                at = x // 2 * 3
                if x % 2 == 0:
                    codes[y, x] = rows[y, at] | (np.uint16(rows[y, at + 1]) & 15) << 8
                else:
                    codes[y, x] = rows[y, at + 1] >> 4 | np.uint16(rows[y, at + 2]) << 4
            continue
        for x in range(width):
            at, shift = (x * bits) >> 3, (x * bits) & 7
            three = np.uint32(rows[y, at]) | np.uint32(rows[y, at + 1]) << 8 | np.uint32(rows[y, min(at + 2, last)]) << 16
            codes[y, x] = (three >> shift) & ((1 << bits) - 1)
    return codes


@kernel
def _unpacked_gige(rows, width, bits):
    """Codes of GigE Vision's 10Packed and 12Packed: two in three bytes, high bits around a byte of low ones, the first pixel's lowest."""
    codes = np.empty((len(rows), width), np.uint16)
    low_bits = bits - 8
    for y in range(len(rows)):
        for x in range(width):
            at, second = x // 2 * 3, x % 2
            low = (rows[y, at + 1] >> (4 * second)) & ((1 << low_bits) - 1)
            codes[y, x] = np.uint16(rows[y, at + 2 * second]) << low_bits | low
    return codes


def planes_from_bytes(data: Sequence[Any], form: PixelFormat, width: int, height: int, strides: Sequence[int]) -> Planes:
    """The planes of a picture in colour, copied out of a frame's buffers: one, or one a plane where they lie apart.

    strides: bytes between rows, of each buffer. Raises ValueError when there are fewer bytes than that takes.
    """
    layout = layout_of(form.layout)
    assert layout is not None
    samples, start = [], 0
    for plane in range(max(component.plane for component in layout.components) + 1):
        (*_, step, across, down) = next(component for component in layout.components if component.plane == plane)
        pixels, count = -(-width // 2**across), -(-height // 2**down)
        length = pixels * step * layout.item
        if form.planes_apart:
            buffer, stride, start = data[plane], strides[plane], 0
        else:  # V4L2: chroma has as many bytes of padding in proportion
            buffer, stride = data[0], strides[0] * step // layout.components[0].step >> across
        samples.append(_rows(buffer, start, length, count, stride, (width, height)).copy().view(np.uint8 if layout.item == 1 else "<u2"))
        start += stride * count
    if form.is_swapped:
        samples[1:] = samples[:0:-1]
    return Planes(tuple(samples), width, height, layout)
