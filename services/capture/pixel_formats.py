"""The raw pixel formats of the kernel's cameras: their names, and how a frame's bytes are codes."""

from typing import Any, NamedTuple

import numpy as np

from vemlight.capture.frames import Mosaic
from vemlight.errors import UserError

BIG_ENDIAN = 1 << 31  # in a format's code


class PixelFormat(NamedTuple):
    """How a frame's bytes are codes."""

    name: str  # the kernel's four letters, followed by -BE for the big-endian form
    dtype: str
    mosaic: Mosaic
    bits: int


FOURCC_BY_BITS: dict[Mosaic, dict[int, str]] = {  # the kernel's four letters
    "mono": {8: "GREY", 10: "Y10 ", 12: "Y12 ", 16: "Y16 "},
    "BGGR": {8: "BA81", 10: "BG10", 12: "BG12", 16: "BYR2"},
    "GBRG": {8: "GBRG", 10: "GB10", 12: "GB12", 16: "GB16"},
    "GRBG": {8: "GRBG", 10: "BA10", 12: "BA12", 16: "GR16"},
    "RGGB": {8: "RGGB", 10: "RG10", 12: "RG12", 16: "RG16"},
}


def _formats() -> dict[int, PixelFormat]:
    formats = {}
    for mosaic, by_bits in FOURCC_BY_BITS.items():
        for bits, fourcc in by_bits.items():
            code = int.from_bytes(fourcc.encode(), "little")
            formats[code] = PixelFormat(fourcc.strip(), "<u1" if bits == 8 else "<u2", mosaic, bits)
            if bits > 8:
                formats[code | BIG_ENDIAN] = PixelFormat(fourcc.strip() + "-BE", ">u2", mosaic, bits)
    return formats


FORMATS = _formats()  # by the kernel's code


def mosaic_of(form: str) -> Mosaic | None:
    """The mosaic of the format called `form`, None for an empty name. Raises UserError for an unknown one."""
    if not form:
        return None
    for known in FORMATS.values():
        if known.name == form:
            return known.mosaic
    raise UserError(f"[capture] format = {form[:20]!r} is not known; it is one of {', '.join(f.name for f in FORMATS.values())}")


def codes_from_bytes(data: Any, form: PixelFormat, width: int, height: int, stride: int) -> np.ndarray:
    """The codes (height, width) uint8 or uint16, in this machine's byte order, of a frame's bytes with rows `stride` bytes apart.

    Raises ValueError when there are fewer bytes than that takes.
    """
    item = np.dtype(form.dtype).itemsize
    if stride < width * item or len(data) < stride * (height - 1) + width * item:
        raise ValueError(f"{len(data)} bytes are no frame of {width}x{height}")
    rows = np.frombuffer(data, np.uint8, stride * (height - 1) + width * item)
    if len(rows) < stride * height:
        rows = np.pad(rows, (0, stride * height - len(rows)))
    codes = rows.reshape(height, stride)[:, : width * item].copy().view(form.dtype)
    return codes.astype(codes.dtype.newbyteorder("="), copy=False)
