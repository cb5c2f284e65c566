"""The exposure of a photograph, as its file says it: EXIF of JPEG, PNG and TIFF, the header of an EXR, LibRaw's reading of a raw one."""

import io
import math
from pathlib import Path
from typing import Any, NamedTuple

from vemlight.errors import UserError
from vemlight.files import one_line, read_file
from vemlight.light.image_limits import LIMITS, MAX_IMAGE_BYTES
from vemlight.light.images import FORMATS, why_unreadable
from vemlight.light.quiet import silent
from vemlight.light.raw_photograph import RAW_SUFFIXES, opened_raw

EXIF_IFD, EXPOSURE_TIME, F_NUMBER, SENSITIVITY = 0x8769, 0x829A, 0x829D, 0x8827
LONGEST_S, SHORTEST_S = 86_400.0, 1e-7  # of an exposure time that is believed
MAX_ISO, MAX_F_NUMBER = 1e8, 1e3


class PhotographExposure(NamedTuple):
    """time_s: of the shutter. iso: 100 where the file does not say. f_number: None where it does not, as with lenses without contacts."""

    time_s: float
    iso: float
    f_number: float | None

    @property
    def exposure_s(self) -> float:
        """The time of a lens of f/1 at ISO 100 for the same codes: t ISO / 100 / N^2; without N that of a lens as it is."""
        return self.time_s * self.iso / 100 / (self.f_number or 1.0) ** 2


def read_exposure(path: Path) -> PhotographExposure:
    """Raises UserError, which names the file, for one that does not say its exposure time, or an impossible one."""
    if path.suffix.lower() in RAW_SUFFIXES:
        with opened_raw(path) as raw:
            values = raw.other.shutter_speed, raw.other.iso_speed, raw.other.aperture
    elif path.suffix.lower() == ".exr":
        from vemlight.light.images import read_radiance

        header = read_radiance(path)[1]
        values = header.get("expTime"), header.get("isoSpeed"), header.get("aperture")
    else:
        values = _from_exif(path)
    time_s, iso, f_number = (_number(value) for value in values)
    if time_s == 0.0 or (time_s is None and values[0] is None):
        raise UserError(f"{path}: does not say its exposure time (EXIF); keep the camera's metadata, or leave the file out")
    if time_s is None or not SHORTEST_S <= time_s <= LONGEST_S:
        raise UserError(f"{path}: its exposure time is {str(values[0])[:20]}, which no shutter has; leave the file out")
    if (iso is not None and iso > MAX_ISO) or (f_number is not None and f_number > MAX_F_NUMBER):
        raise UserError(f"{path}: its ISO {iso} or f-number {f_number} is impossible; leave the file out")
    return PhotographExposure(time_s, iso or 100.0, f_number or None)


def _from_exif(path: Path) -> tuple[Any, Any, Any]:
    from PIL import Image, UnidentifiedImageError

    data = read_file(path, MAX_IMAGE_BYTES)
    try:
        with silent(), Image.open(io.BytesIO(data), formats=FORMATS) as image:
            LIMITS.check(path, *image.size, len(data), pixel_bytes=6)  # of a PNG, EXIF is looked for behind the pixels
            exif = image.getexif().get_ifd(EXIF_IFD)
    except UserError:
        raise
    except UnidentifiedImageError as error:
        raise UserError(f"{path}: {why_unreadable(data)}") from error
    except Exception as error:  # a hostile file raises whatever Pillow trips over
        raise UserError(f"{path}: is not a readable image ({one_line(error)}); give PNG, TIFF or JPEG") from error
    return exif.get(EXPOSURE_TIME), exif.get(SENSITIVITY), exif.get(F_NUMBER)


def _number(value: Any) -> float | None:
    """A finite number of 0 or more, the first of several; None for anything else."""
    if isinstance(value, tuple | list):
        value = value[0] if value else None
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number >= 0 else None
