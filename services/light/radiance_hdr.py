"""Radiance pictures (.hdr, .pic): shared-exponent pixels, plain or run-length coded, in any of eight orientations.

Ward 1991, "Real Pixels", Graphics Gems II; Larson and Shakespeare 1998, "Rendering with Radiance"; the reference manual's filefmts, section
"picture". What the header says of the values (EXPOSURE, COLORCORR, FORMAT, PRIMARIES) is taken back out of them.
"""

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.errors import UserError
from vemlight.file_kinds import check_kind
from vemlight.files import notice, read_file
from vemlight.kernels import kernel
from vemlight.light.image_limits import LIMITS, MAX_IMAGE_BYTES, ImageLimits
from vemlight.light.primaries import D65, REC709, XYZ, rec709_from_primaries, rec709_from_xyz

MAX_HEADER_BYTES = 64 * 1024  # a history of thousands of commands fits; what is longer is another kind of file
RGBE, XYZE = "32-bit_rle_rgbe", "32-bit_rle_xyze"
RUN_WIDTHS = range(8, 32768)  # widths whose rows may be coded channel by channel
RESOLUTION = re.compile(rb"([+-])([XY]) +(\d+) +([+-])([XY]) +(\d+)\s*")


class RadianceHeader(NamedTuple):
    """What a header says.

    scale: (3,) by which stored values are divided, all EXPOSURE times COLORCORR. primaries: x, y of red, green, blue and white; None
    where it does not say.
    first, second: sign and axis of the scanlines and of the pixels in them, such as ("-", "Y") and ("+", "X"), with their counts.
    begin: the offset of the first pixel.
    """

    is_xyz: bool
    scale: np.ndarray
    primaries: tuple[float, ...] | None
    first: tuple[str, str, int]
    second: tuple[str, str, int]
    begin: int


def read_radiance_hdr(path: Path, limits: ImageLimits = LIMITS) -> tuple[np.ndarray, dict[str, Any]]:
    """The picture (height, width, 3) float32 in linear Rec. 709, in the radiance units of the scene, the top row first, and its attributes
    as an EXR would have them: the chromaticities, where the header says them.

    Raises UserError, by its cause, for a file that is cut off, damaged, larger than the limits or of another kind.
    """
    data = np.frombuffer(read_file(path, MAX_IMAGE_BYTES), np.uint8)
    header = _header(path, data)
    scanlines, width = header.first[2], header.second[2]
    limits.check(path, width, scanlines, data.size)
    codes, rows_done = _decode(data[header.begin :], scanlines, width)
    if rows_done < scanlines:
        raise UserError(f"{path}: is cut off or damaged in scanline {rows_done + 1} of {scanlines}; copy it again")

    pixels = _radiance_from_codes(codes).reshape(scanlines, width, 3)
    if header.first[1] == "X":  # scanlines are columns
        pixels = pixels.transpose(1, 0, 2)
    signs = {axis: sign for sign, axis, _ in (header.first, header.second)}
    pixels = pixels[:: 1 if signs["Y"] == "-" else -1, :: 1 if signs["X"] == "+" else -1]
    if not (header.scale == 1).all():
        pixels = pixels / header.scale
    if header.is_xyz:
        pixels = pixels @ rec709_from_xyz().T
    elif header.primaries and not np.allclose(header.primaries, REC709, atol=1e-3):
        try:
            pixels = pixels @ rec709_from_primaries(header.primaries).T
        except ValueError as error:
            raise UserError(f"{path}: its PRIMARIES: {error}; correct the header") from error
    primaries = (*XYZ, *D65) if header.is_xyz else header.primaries
    return np.ascontiguousarray(pixels, np.float32), {"chromaticities": primaries} if primaries else {}


def _header(path: Path, data: np.ndarray) -> RadianceHeader:
    """Reads the lines up to the resolution. Raises UserError for what is none."""
    text = data[:MAX_HEADER_BYTES].tobytes()
    scale, is_xyz, primaries, at = np.ones(3), False, None, 0
    if not text:
        raise UserError(f"{path}: is empty; copy it again")
    check_kind(path, text, "a Radiance picture")
    known = text.startswith(b"#?")
    while True:
        end = text.find(b"\n", at)
        if end < 0:
            what = "has no end to its header; copy it again" if known else "is no Radiance picture; give the kind that its suffix says"
            raise UserError(f"{path}: {what}")
        indented, line = text[at : at + 1] in b"\t ", text[at:end].strip(b"\r\t ")
        at = end + 1
        if not line:
            break
        if indented:  # of the pictures that this one was made of, as pcomb writes them: what they were is in the pixels
            continue
        key, _, value = line.partition(b"=")
        match key.strip().upper():
            case b"FORMAT":
                name, known = value.strip().lower().decode("ascii", "replace"), True
                if name not in (RGBE, XYZE):
                    raise UserError(f"{path}: FORMAT={name[:40]}: is neither {RGBE} nor {XYZE}; convert it")
                is_xyz = name == XYZE
            case b"EXPOSURE":
                scale = scale * _numbers(path, line, 1)
            case b"COLORCORR":
                scale = scale * _numbers(path, line, 3)
            case b"PRIMARIES":
                stated = _numbers(path, line, 8)
                primaries = tuple(stated.tolist()) if stated.any() else None  # some programs write eight zeros for "not known"
            case b"GAMMA" if value.strip() not in (b"1", b"1.0", b"1.000000"):
                shown = value.strip()[:20].decode("ascii", "replace")
                notice(f"{path}: says GAMMA={shown}, which is no field of the format; its values are taken as linear")
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise UserError(f"{path}: its EXPOSURE and COLORCORR make a factor of {scale.tolist()}; correct the header")
    end = text.find(b"\n", at)
    found = RESOLUTION.fullmatch(text[at : max(end, 0)])
    if found is None or found[2] == found[5]:
        what = "its header is followed by no resolution such as -Y 512 +X 1024; copy it again" if known else "is no Radiance picture"
        raise UserError(f"{path}: {what}")
    sides = [(found[k].decode(), found[k + 1].decode(), int(found[k + 2][:9])) for k in (1, 4)]
    return RadianceHeader(is_xyz, scale, primaries, sides[0], sides[1], end + 1)


def _numbers(path: Path, line: bytes, count: int) -> np.ndarray:
    """The numbers behind the = of a header line. Raises UserError unless there are `count`."""
    try:
        numbers = np.array([float(word) for word in line.partition(b"=")[2].split()])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        shown = line[:60].decode("ascii", "replace")
        raise UserError(f"{path}: {shown}: needs {count} number{'s' if count > 1 else ''}; correct the header")
    return numbers


def _decode(data: np.ndarray, scanlines: int, width: int) -> tuple[np.ndarray, int]:
    """The pixels' four bytes (scanlines, width, 4) uint8 and how many scanlines were whole."""
    # The shortest code of a row, runs of one pixel, has four bytes: nothing is allocated for a file that cannot hold its rows.
    if len(data) < 4 * scanlines:
        return np.empty((0, width, 4), np.uint8), len(data) // max(4 * width, 1)
    codes = np.zeros((scanlines, width, 4), np.uint8)
    return codes, _decode_rows(data, codes, width in RUN_WIDTHS)


@kernel(nogil=True)
def _decode_rows(data: np.ndarray, codes: np.ndarray, may_be_by_channel: bool) -> int:
    """Fills `codes` (scanlines, width, 4) and returns how many scanlines were whole.

    Each scanline is coded by channel (it begins with 2, 2 and its width), or pixel by pixel, where a pixel (1, 1, 1, n) repeats the one
    before it n times, and n << 8 times if it follows such a pixel.
    """
    at, scanlines, width = 0, codes.shape[0], codes.shape[1]
    for y in range(scanlines):
        row = codes[y]
        by_channel = may_be_by_channel and at + 4 <= data.size and data[at] == 2 and data[at + 1] == 2 and data[at + 2] < 128
        if by_channel:
            if (np.int64(data[at + 2]) << 8) + data[at + 3] != width:
                return y
            at += 4
            for channel in range(4):
                x = 0
                while x < width:
                    if at + 1 >= data.size:
                        return y
                    count = np.int64(data[at])
                    at += 1
                    if count > 128:
                        count -= 128
                        if x + count > width:
                            return y
                        for k in range(count):
                            row[x + k, channel] = data[at]
                        at += 1
                    else:
                        if count == 0 or x + count > width or at + count > data.size:
                            return y
                        for k in range(count):
                            row[x + k, channel] = data[at + k]
                        at += count
                    x += count
            continue
        x, shift = 0, 0
        while x < width:
            if at + 4 > data.size:
                return y
            if data[at] == 1 and data[at + 1] == 1 and data[at + 2] == 1:
                count = np.int64(data[at + 3]) << shift
                if x == 0 or x + count > width:
                    return y
                for k in range(x, x + count):
                    for channel in range(4):
                        row[k, channel] = row[x - 1, channel]
                x += count
                shift += 8
                if shift > 24:
                    return y
            else:
                for channel in range(4):
                    row[x, channel] = data[at + channel]
                x += 1
                shift = 0
            at += 4
    return scanlines


def _radiance_from_codes(codes: np.ndarray) -> np.ndarray:
    """(.., 3) float32 of (.., 4) codes: mantissa and a half, times 2^(exponent - 136); an exponent of 0 is black (Ward 1991)."""
    unit = np.ldexp(np.float32(1), codes[..., 3].astype(np.int32) - (128 + 8))
    unit[codes[..., 3] == 0] = 0
    return (codes[..., :3].astype(np.float32) + np.float32(0.5)) * unit[..., None]
