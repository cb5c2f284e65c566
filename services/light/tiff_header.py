"""What a TIFF says of how its samples are stored, where decoders go by it silently or not at all.

OpenCV turns pixels by Orientation 2 to 8 also where it is told not to, mixes up colours that lie in planes of their own, takes 0 for
black where it is white, and multiplies colours by an alpha that they are not multiplied by.
Format: TIFF 6.0 (1992), and BigTIFF, which has wider numbers.
"""

import struct
from pathlib import Path
from typing import NamedTuple

from vemlight.errors import UserError
from vemlight.files import notice

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
BITS, COMPRESSION, PHOTOMETRIC, ORIENTATION, PLANAR, EXTRA, SAMPLE_FORMAT = 258, 259, 262, 274, 284, 338, 339
PREMULTIPLIED = 1  # of EXTRA: colours are times the alpha behind them
UPRIGHT = 1
DEFAULTS = ((BITS, 1), (SAMPLE_FORMAT, 1), (PHOTOMETRIC, 2), (ORIENTATION, UPRIGHT), (PLANAR, 1), (COMPRESSION, 1), (EXTRA, 0))
FORMATS_OF_TYPE = {1: "B", 3: "H", 4: "I", 16: "Q"}  # of whole numbers
MAX_VALUES = 16  # of a tag that is read here: one for each channel
WHITE_IS_ZERO, BLACK_IS_ZERO = 0, 1
COLOURS = {0: "gray", 1: "gray", 2: "RGB", 3: "a palette", 6: "YCbCr"}  # that are read
OTHER_COLOURS = {4: "a mask", 5: "CMYK", 8: "CIE L*a*b*", 9: "ICC L*a*b*", 10: "ITU L*a*b*", 32803: "a mosaic", 34892: "linear raw"}
COMPRESSIONS = (1, 2, 3, 4, 5, 7, 8, 32773, 32946)  # none, fax, LZW, JPEG, deflate, PackBits
OTHER_COMPRESSIONS = {6: "old JPEG", 34887: "LERC", 34925: "LZMA", 50000: "Zstandard", 50001: "WebP", 50002: "JPEG XL", 52546: "JPEG XL"}
NUMBERS = {2: "signed whole numbers", 3: "floating-point numbers", 5: "complex numbers", 6: "complex numbers"}


class StoredTiff(NamedTuple):
    """data: the file, made to say that it is upright, that black is 0 and that alpha changes nothing. orientation: what it
    said. is_inverted: white was 0."""

    data: bytes
    orientation: int
    is_inverted: bool


def stored_tiff(path: Path, data: bytes) -> StoredTiff:
    """The first picture of a TIFF. Raises UserError, by its cause, for samples that are not read; a notice tells of more pictures."""
    try:
        tags, more = _tags(data)
        bits, (number, *_), (colours, *_), (order, *_), (planar, *_), (packed, *_), extra = (
            tags.get(tag, ((default,), 0, ""))[0] for tag, default in DEFAULTS
        )
    except (struct.error, KeyError, ValueError, OverflowError) as error:  # OverflowError: offsets of 64 bits
        raise UserError(f"{path}: its TIFF header is cut off or damaged; copy it again") from error
    if number in NUMBERS:
        raise UserError(
            f"{path}: holds {NUMBERS[number]} of {bits[0]} bits, and codes are read; export light as EXR, codes as 8 or 16 bits"
        )
    if fault := _fault(bits, colours, planar, packed):
        raise UserError(f"{path}: {fault}; export it as RGB or gray of 8 or 16 bits, with LZW or without compression")
    if more:
        notice(f"{path}: holds more than one picture; the first is taken")
    if PREMULTIPLIED in extra:
        notice(f"{path}: its colours are multiplied by its alpha, and are taken as they stand; export it without alpha")
    plain = bytearray(data)
    for tag, value in ((ORIENTATION, UPRIGHT), (PHOTOMETRIC, BLACK_IS_ZERO), (EXTRA, PREMULTIPLIED)):
        if tag in tags and (tag != PHOTOMETRIC or colours == WHITE_IS_ZERO):
            _, at, form = tags[tag]
            struct.pack_into(form, plain, at, value)
    return StoredTiff(bytes(plain), order, colours == WHITE_IS_ZERO)


def _fault(bits: tuple[int, ...], colours: int, planar: int, packed: int) -> str:
    """Why samples are not read, empty where they are."""
    if set(bits) not in ({8}, {16}):
        return f"has samples of {' and '.join(map(str, sorted(set(bits))))} bits"
    if colours not in COLOURS:
        return f"its colours are {OTHER_COLOURS.get(colours, f'of kind {colours} (PhotometricInterpretation)')}"
    if planar != 1 and len(bits) > 1:
        return "its colours lie in planes of their own (PlanarConfiguration 2)"
    if packed not in COMPRESSIONS:
        return f"is compressed by {OTHER_COMPRESSIONS.get(packed, f'method {packed}')}"
    return ""


def _tags(data: bytes) -> tuple[dict[int, tuple[tuple[int, ...], int, str]], bool]:
    """Whole numbers of the first directory: values, where they lie, and the format of one; and whether another directory follows."""
    byte_order = "<" if data.startswith(b"II") else ">"
    is_big = 43 in data[2:4]
    at_form, count_form, entry_form, inline = ("Q", "Q", "HHQ", 8) if is_big else ("I", "H", "HHI", 4)
    (at,) = struct.unpack_from(byte_order + at_form, data, 8 if is_big else 4)
    (count,) = struct.unpack_from(byte_order + count_form, data, at)
    at += struct.calcsize("<" + count_form)
    tags: dict[int, tuple[tuple[int, ...], int, str]] = {}
    for _ in range(min(count, 65_535)):
        tag, kind, length = struct.unpack_from(byte_order + entry_form, data, at)
        value_at = at + struct.calcsize("<" + entry_form)
        at = value_at + inline
        if tag not in dict(DEFAULTS):
            continue
        form, length = byte_order + FORMATS_OF_TYPE[kind], min(length, MAX_VALUES)
        if not length:
            raise ValueError("a tag without a value")
        if length * struct.calcsize(form) > inline:
            (value_at,) = struct.unpack_from(byte_order + at_form, data, value_at)
        tags[tag] = struct.unpack_from(f"{byte_order}{length}{form[1:]}", data, value_at), value_at, form
    return tags, any(data[at : at + inline])
