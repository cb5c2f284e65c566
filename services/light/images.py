"""Image files: radiance as OpenEXR and Radiance HDR, pictures as PNG, with the metadata that other programs read.

Every failure to read is one UserError naming the file, whatever the library below raises. A file is written under another name and
renamed when it is complete.
"""

import errno
import io
import os
from pathlib import Path
from typing import Any

import numpy as np

from vemlight.errors import UserError
from vemlight.file_kinds import BINARY, BINARY_UNTIL, file_kind
from vemlight.files import check_regular, notice, one_line, read_file, written_whole
from vemlight.light.exr import read_exr
from vemlight.light.image_limits import LIMITS, MAX_IMAGE_BYTES, check_chunks
from vemlight.light.pfm import read_pfm
from vemlight.light.primaries import REC709
from vemlight.light.quiet import silent
from vemlight.light.tiff_header import SIGNATURES, UPRIGHT, stored_tiff

EXIF_ORIENTATION = 0x0112
FORMATS = ("PNG", "TIFF", "JPEG")  # Pillow knows forty more, some of which start other programs


def read_radiance(path: Path, layer: str = "") -> tuple[np.ndarray, dict[str, Any]]:
    """Reads an image (height, width, 3) float32, linear Rec. 709, and the EXR's attributes (of .hdr its chromaticities).

    Gray files are repeated in three channels; alpha is left out. nan, inf and negative pixels are preserved. layer: of an EXR with several.
    Raises UserError for a file that is missing, damaged, too large or of another kind.
    """
    with np.errstate(all="ignore"):  # products of pixels and header that are beyond float32 are inf or nan, as pixels of a file may be
        if path.suffix.lower() == ".exr":
            return read_exr(path, layer)
        if path.suffix.lower() in (".hdr", ".pic"):
            from vemlight.light.radiance_hdr import read_radiance_hdr  # here, since its kernels load numba

            return read_radiance_hdr(path)
        if path.suffix.lower() == ".pfm":
            return read_pfm(path), {}
    check_regular(path, MAX_IMAGE_BYTES)
    raise UserError(f"{path}: radiance is read from .exr, .hdr and .pfm, not {path.suffix or 'a file without suffix'}; convert it")


def read_codes(path: Path) -> np.ndarray:
    """Reads an image's values without conversion, (height, width) or (height, width, 3) RGB: EXR, or 8 or 16 bits of PNG, TIFF, JPEG.

    Raises UserError for a file that is missing, damaged, too large or of another kind.
    """
    import cv2

    if path.suffix.lower() == ".exr":
        return read_radiance(path)[0]
    pixels = _stored_pixels(path, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    return pixels if pixels.ndim == 2 else np.ascontiguousarray(pixels[..., ::-1])


def read_photograph(path: Path) -> np.ndarray:
    """Reads a photograph's luma, (height, width) uint8: PNG, TIFF, JPEG. Raises UserError as `read_codes`."""
    import cv2

    return _stored_pixels(path, cv2.IMREAD_GRAYSCALE)


def read_picture(path: Path) -> np.ndarray:
    """Reads a picture to be seen, upright, (height, width, 3) uint8 RGB: PNG, TIFF, JPEG. Raises UserError as `read_codes`."""
    import cv2

    return np.ascontiguousarray(_stored_pixels(path, cv2.IMREAD_COLOR, upright=True)[..., ::-1])


def _stored_pixels(path: Path, flags: int, upright: bool = False) -> np.ndarray:
    """What OpenCV reads with `flags`, once the header has shown that it is not too large.

    Unless `upright`, pixels are where the sensor has them, whatever a camera's EXIF orientation says of how they should be shown; a notice
    says so.
    """
    import cv2
    from PIL import Image

    data = read_file(path, MAX_IMAGE_BYTES)
    check_chunks(path, data)
    tiff = stored_tiff(path, data) if data.startswith(SIGNATURES) else None
    data = tiff.data if tiff else data
    try:
        with silent(), Image.open(io.BytesIO(data), formats=FORMATS) as image:
            LIMITS.check(path, *image.size, len(data), pixel_bytes=6)
            if image.mode == "CMYK":
                raise UserError(f"{path}: its colours are CMYK, for print; export it as RGB")
            # getexif reads a PNG to its end
            orientation = tiff.orientation if tiff else image.getexif().get(EXIF_ORIENTATION, UPRIGHT)
        with silent():
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags | (0 if upright else cv2.IMREAD_IGNORE_ORIENTATION))
    except UserError:
        raise
    except (Image.UnidentifiedImageError, cv2.error) as error:  # whose texts are about Python objects and OpenCV's source
        raise UserError(f"{path}: {why_unreadable(data)}") from error
    except Exception as error:  # a hostile file raises whatever Pillow trips over: SyntaxError, struct.error, zlib.error and more
        raise UserError(f"{path}: is not a readable image ({one_line(error)}); give PNG, TIFF or JPEG") from error
    if pixels is None:
        raise UserError(f"{path}: {why_unreadable(data)}")
    if tiff and tiff.is_inverted:
        pixels = (255 if pixels.dtype == np.uint8 else 65_535) - pixels
    if tiff and upright:
        return np.ascontiguousarray(_turned(pixels, orientation))
    if orientation != UPRIGHT and not upright:
        notice(f"{path}: its EXIF orientation ({orientation}) is ignored: pixels stay where the sensor has them")
    return pixels


def _turned(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Pixels as they are to be seen, by the number that says where their first row and column lie (TIFF 6.0, Orientation)."""
    if orientation in (5, 6, 7, 8):
        pixels = np.swapaxes(pixels, 0, 1)
    return pixels[:: -1 if orientation in (3, 4, 7, 8) else 1, :: -1 if orientation in (2, 3, 6, 7) else 1]


def why_unreadable(data: bytes) -> str:
    """Why no pixels came of a file, by its first bytes, and the way out."""
    found = file_kind(data[:BINARY_UNTIL])
    if found in ("a PNG picture", "a TIFF picture", "a JPEG picture"):
        return f"is {found} that is cut off, damaged, or coded in a rare way; copy it again, or export it with 8 or 16 bits"
    return f"is not a readable image{f' but {found}' if found and found != BINARY else ''}; give PNG, TIFF or JPEG"


def write_exr(path: Path, pixels: np.ndarray, attributes: dict[str, Any] | None = None) -> None:
    """Writes (height, width), (.., 3) or (.., 4) pixels as Y, RGB or RGBA; float16 stays half, all else becomes 32-bit float.

    `attributes` join the standard ones (chromaticities, colorInteropID) in the header; integers above 31 bits must come as strings.
    Raises OSError when the disk refuses.
    """
    import OpenEXR

    dtype = np.float16 if pixels.dtype == np.float16 else np.float32
    header: dict[str, Any] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709,
        "colorInteropID": "lin_rec709_scene",
        **(attributes or {}),
    }
    name = "Y" if pixels.ndim == 2 else {3: "RGB", 4: "RGBA"}[pixels.shape[2]]
    with written_whole(path) as part:
        try:
            with OpenEXR.File(header, {name: np.ascontiguousarray(pixels, dtype)}) as file:
                file.write(str(part))
        except RuntimeError as error:
            if os.strerror(errno.ENOSPC) in str(error):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path)) from error
            raise OSError(f"{path}: {one_line(error)}") from error


def write_png(path: Path, pixels: np.ndarray) -> None:
    """Writes (height, width), (.., 3) or (.., 4) uint8 or uint16 pixels, RGB order. Raises OSError when the disk refuses."""
    import cv2

    order = pixels if pixels.ndim == 2 else pixels[..., [2, 1, 0, 3][: pixels.shape[2]]]
    done, data = cv2.imencode(".png", order)
    if not done:
        raise OSError(f"{path}: the PNG encoder refused an image of shape {pixels.shape}")
    with written_whole(path) as part:
        part.write_bytes(data.tobytes())
