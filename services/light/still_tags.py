"""What a PNG, JPEG or TIFF says of its colours: cICP, sRGB, gAMA and cHRM chunks, an ICC profile, EXIF's colour space."""

import io
from pathlib import Path

import numpy as np

from vemlight.files import notice, one_line, read_file
from vemlight.light.colour_tags import ColourTags, tags_from_numbers
from vemlight.light.icc_profile import tags_of_profile
from vemlight.light.image_limits import MAX_IMAGE_BYTES, PNG_CHUNK, PNG_SIGNATURE
from vemlight.light.primaries import PRIMARIES
from vemlight.light.quiet import silent

EXIF_IFD, EXIF_COLOUR_SPACE, EXIF_SRGB = 0x8769, 0xA001, 1
GAIN_MAPS = (b"hdrgm:Version", b"urn:iso:std:iso:ts:21496", b"urn:com:apple:photo:2020:aux:hdrgainmap")  # that lie behind a JPEG
CHROMATICITY_TOLERANCE = 0.002  # files round to 0.001; bt709 and smpte170m are 0.01 apart


def still_tags(path: Path) -> ColourTags:
    """The tags of a picture file; its codes are R, G, B of full range. A notice names a profile and a gain map that are not read."""
    from PIL import Image

    data = read_file(path, MAX_IMAGE_BYTES)
    cicp = _png_chunk(data, b"cICP")
    if len(cicp) == 4:  # PNG, third edition, 11.3.2.6
        primaries, transfer, matrix, full = cicp
        return tags_from_numbers(transfer, primaries, matrix, 2 if full else 1)._replace(matrix="rgb")
    with silent(), Image.open(io.BytesIO(data), formats=("PNG", "TIFF", "JPEG")) as image:
        info = dict(image.info)
        is_jpeg = image.format in ("JPEG", "MPO")
        said_srgb = image.getexif().get_ifd(EXIF_IFD).get(EXIF_COLOUR_SPACE) == EXIF_SRGB
    if is_jpeg and any(mark in data for mark in GAIN_MAPS):
        notice(f"{path}: has a gain map, which is not read: light above white is missing; export it as EXR to keep it")
    return _described(path, info, said_srgb)._replace(matrix="rgb", range="full")


def _png_chunk(data: bytes, wanted: bytes) -> bytes:
    """The content of a PNG's first chunk of that name before its pixels; empty where there is none."""
    at = len(PNG_SIGNATURE) if data.startswith(PNG_SIGNATURE) else len(data)
    while at + PNG_CHUNK.size <= len(data):
        length, name = PNG_CHUNK.unpack_from(data, at)
        if name in (wanted, b"IDAT"):
            return data[at + PNG_CHUNK.size : at + PNG_CHUNK.size + length] if name == wanted else b""
        at += PNG_CHUNK.size + length + 4  # a checksum follows
    return b""


def _described(path: Path, info: dict, said_srgb: bool) -> ColourTags:
    if profile := info.get("icc_profile"):
        tags = tags_of_profile(profile)
        if tags.transfer is None or tags.primaries is None:
            name = _profile_name(profile) or "without a name"
            notice(f"{path}: its colour profile, {name}, is not read; --transfer and --primaries say what it is")
            return ColourTags()
        return tags
    if "srgb" in info or said_srgb:
        return ColourTags("srgb", "bt709")
    primaries = _primaries_of(info.get("chromaticity"))
    if not (gamma := info.get("gamma")):
        return ColourTags(None, primaries)
    return ColourTags("linear" if gamma == 1.0 else f"tag gAMA {gamma:g}", primaries)


def _primaries_of(chromaticity: tuple[float, ...] | None) -> str | None:
    """The name of a PNG's cHRM: x, y of white, red, green and blue."""
    if chromaticity is None:
        return None
    stated = (*chromaticity[2:], *chromaticity[:2])
    named = (name for name, numbers in PRIMARIES.items() if np.allclose(stated, numbers, rtol=0, atol=CHROMATICITY_TOLERANCE))
    return next(named, f"tag cHRM {' '.join(f'{number:g}' for number in stated)}")


def _profile_name(profile: bytes) -> str:
    from PIL import ImageCms

    try:
        return one_line(Exception(ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(io.BytesIO(profile)))))
    except (ImageCms.PyCMSError, OSError, ValueError):
        return ""
