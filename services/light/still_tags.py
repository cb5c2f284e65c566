"""What a PNG, JPEG or TIFF says of its colours: cICP and sRGB chunks, a linear gAMA, the name of its ICC profile, EXIF's colour space."""

import io
import struct
from pathlib import Path

from vemlight.files import notice, one_line, read_file
from vemlight.light.colour_tags import ColourTags, tags_from_numbers
from vemlight.light.image_limits import MAX_IMAGE_BYTES
from vemlight.light.quiet import silent

CICP = b"\0\0\0\4cICP"  # length and name of the chunk (PNG, third edition, 11.3.2.6)
CHUNKS_UNTIL = 65_536  # bytes in which it is looked for: it comes before the pixels
EXIF_IFD, EXIF_COLOUR_SPACE, EXIF_SRGB = 0x8769, 0xA001, 1
PROFILES = {  # what a profile's name contains
    "srgb": ColourTags("srgb", "bt709"),
    "display p3": ColourTags("srgb", "p3d65"),
}


def still_tags(path: Path) -> ColourTags:
    """The tags of a picture file; its codes are R, G, B of full range. A profile that is not known is named in a notice."""
    from PIL import Image

    data = read_file(path, MAX_IMAGE_BYTES)
    at = data.find(CICP, 8, CHUNKS_UNTIL) if data.startswith(b"\x89PNG") else -1
    if at >= 0 and len(data) >= at + 12:
        primaries, transfer, matrix, full = struct.unpack_from("4B", data, at + 8)
        return tags_from_numbers(transfer, primaries, matrix, 2 if full else 1)._replace(matrix="rgb")
    with silent(), Image.open(io.BytesIO(data), formats=("PNG", "TIFF", "JPEG")) as image:
        info = dict(image.info)
        said_srgb = image.getexif().get_ifd(EXIF_IFD).get(EXIF_COLOUR_SPACE) == EXIF_SRGB
    return _described(path, info, said_srgb)._replace(matrix="rgb", range="full")


def _described(path: Path, info: dict, said_srgb: bool) -> ColourTags:
    if profile := info.get("icc_profile"):
        name = _profile_name(profile)
        found = next((tags for part, tags in PROFILES.items() if part in name.lower()), None)
        if found is None:
            notice(f"{path}: its colour profile, {name or 'without a name'}, is not read; --transfer and --primaries say what it is")
        return found or ColourTags()
    if "srgb" in info or said_srgb:
        return ColourTags("srgb", "bt709")
    return ColourTags("linear", None) if info.get("gamma") == 1.0 else ColourTags()


def _profile_name(profile: bytes) -> str:
    from PIL import ImageCms

    try:
        return one_line(Exception(ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(io.BytesIO(profile)))))
    except (ImageCms.PyCMSError, OSError, ValueError):
        return ""
