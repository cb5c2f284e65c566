"""Photographs as cameras write them, with their exposure."""

import io
import struct
import zlib
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

EXIF_IFD, EXPOSURE_TIME, SENSITIVITY, F_NUMBER = 0x8769, 0x829A, 0x8827, 0x829D


def with_chunk(png, name, data):
    """A PNG with a chunk behind its header."""
    chunk = struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
    return png[:33] + chunk + png[33:]


def exif(exposure_s=None, iso=None, f_number=None) -> bytes:
    """EXIF with these tags, and the maker's name."""
    made = Image.Exif()
    made[0x010F] = "Own"
    tags = made.get_ifd(EXIF_IFD)
    for tag, value in ((EXPOSURE_TIME, exposure_s), (F_NUMBER, f_number)):
        if value is not None:
            tags[tag] = value if isinstance(value, IFDRational) else IFDRational(value).limit_rational(10**6)
            tags[tag] = IFDRational(*tags[tag]) if isinstance(tags[tag], tuple) else tags[tag]
    if iso is not None:
        tags[SENSITIVITY] = iso
    return made.tobytes()


def write_photograph(path: Path, codes: np.ndarray, exposure_s=None, iso=None, f_number=None, quality: int = 95) -> None:
    """Codes (height, width) or (height, width, 3), uint8, or uint16 as PNG, as a file with EXIF."""
    tags = exif(exposure_s, iso, f_number)
    if path.suffix != ".png":
        Image.fromarray(codes).save(path, exif=tags, quality=quality, subsampling=0)
        return
    import cv2

    _, png = cv2.imencode(".png", codes if codes.ndim == 2 else codes[..., ::-1])
    path.write_bytes(with_chunk(png.tobytes(), b"eXIf", tags.removeprefix(b"Exif\0\0")))


def dng(codes, black, white, exposure_s=None):
    """A minimal DNG: one strip of a 16-bit RGGB mosaic, whose camera's colours are CIE XYZ."""
    height, width = codes.shape
    data = codes.astype("<u2").tobytes()
    rational = b"".join(struct.pack("<ii", round(value * 10_000), 10_000) for value in np.eye(3).ravel())
    neutral = b"".join(struct.pack("<II", round(value * 10_000), 10_000) for value in (0.9505, 1.0, 1.0888))
    entries = [(254, 4, 1, 0), (256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, 16), (259, 3, 1, 1), (262, 3, 1, 32803),
               (271, 2, 4, b"Own\0"),
               (272, 2, 4, b"Cam\0"), (273, 4, 1, "strip"), (277, 3, 1, 1), (278, 4, 1, height), (279, 4, 1, len(data)),
               *([] if exposure_s is None else [(33434, 5, 1, struct.pack("<II", round(exposure_s * 1e7), 10**7))]),
               (33421, 3, 2, struct.pack("<HH", 2, 2)), (33422, 1, 4, bytes((0, 1, 1, 2))), (50706, 1, 4, bytes((1, 4, 0, 0))),
               (50708, 2, 8, b"Own Cam\0"), (50714, 4, 1, black), (50717, 4, 1, white), (50721, 10, 9, rational), (50728, 5, 3, neutral),
               (50778, 3, 1, 21)]  # fmt: skip
    offset = 8 + 2 + 12 * len(entries) + 4
    table, behind = io.BytesIO(), io.BytesIO()
    for tag, kind, count, value in entries:
        if isinstance(value, bytes) and len(value) > 4:
            place = struct.pack("<I", offset + behind.tell())
            behind.write(value)
        elif isinstance(value, bytes):
            place = value.ljust(4, b"\0")
        else:
            place = (tag, value)
        table.write(struct.pack("<HHI", tag, kind, count))
        strip = offset + sum(len(v) for *_, v in entries if isinstance(v, bytes) and len(v) > 4)
        table.write(place if isinstance(place, bytes) else struct.pack("<I", strip if value == "strip" else value))
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + table.getvalue() + bytes(4) + behind.getvalue() + data
