"""PNG, JPEG, TIFF and raw photographs as frames: pictures by their transfer, or raw codes by a response file.

Raw codes are gray ones of a monochrome sensor, or of the mosaic that the settings' `format` names, or have three channels.
"""

from pathlib import Path

import numpy as np

from vemlight.capture.colour_coding import STILL, ColourCoding, colour_coding
from vemlight.capture.frames import Frame, FrameMaker, Mosaic
from vemlight.capture.pixel_formats import mosaic_of
from vemlight.capture.planes import planes_from_image
from vemlight.capture.sequence import STILL_SUFFIXES
from vemlight.errors import UserError
from vemlight.light.colour_tags import ColourTags
from vemlight.light.images import read_codes
from vemlight.light.raw_photograph import RAW_SUFFIXES, read_raw
from vemlight.light.still_tags import still_tags
from vemlight.settings import Capture

JPEG_SUFFIXES = (".jpg", ".jpeg")
LINEAR = ColourTags("linear", "bt709", "rgb", "full")
OF_CODES = ("transfer", "matrix", "range", "light", "peak", "stereo")  # settings that say nothing of radiance


def is_still(path: Path) -> bool:
    """Whether a file holds codes, and not radiance, by its suffix."""
    return path.suffix.lower() in (*STILL_SUFFIXES, *RAW_SUFFIXES)


def check_radiance_settings(settings: Capture, path: Path) -> None:
    """Raises UserError for settings that say how codes become light, where the file at `path` holds light."""
    if said := [key for key in OF_CODES if getattr(settings, key)]:
        raise UserError(f"{path}: holds radiance, of which --{said[0]} says nothing; leave {said[0]} out")


class StillReader:
    """Makes frames of the picture files of one source."""

    def __init__(self, settings: Capture, maker: FrameMaker) -> None:
        """Raises UserError for a [capture] format that is no mosaic."""
        self._settings, self._maker = settings, maker
        self._mosaic: Mosaic | None = mosaic_of(settings.format)
        self._coding: tuple[ColourTags, ColourCoding] | None = None

    def check(self, path: Path) -> None:
        """Raises UserError for a picture of which no frame can be made, without making it."""
        if self._is_raw_codes(path):
            self._maker.check_codes(str(path), read_codes(path).shape)
        else:
            self._coding_of(path)

    def frame(self, path: Path, time_s: float) -> Frame:
        """The frame of the picture at `path`. Raises UserError for one that cannot be read, or says not enough of its colours."""
        if path.suffix.lower() in RAW_SUFFIXES:
            return self._picture(path, read_raw(path), time_s)
        codes = read_codes(path)
        if not self._is_raw_codes(path):
            return self._picture(path, codes, time_s)
        if codes.ndim == 3 and self._mosaic:
            raise UserError(f"{path}: is in colour, which no mosaic is; leave out [capture] format")
        mono: Mosaic = "mono"
        mosaic = None if codes.ndim == 3 else self._mosaic or mono
        return self._maker.frame_from_codes(str(path), codes, mosaic, time_s)

    def _is_raw_codes(self, path: Path) -> bool:
        return self._maker.response is not None and not self._settings.transfer and path.suffix.lower() not in RAW_SUFFIXES

    def _picture(self, path: Path, codes: np.ndarray, time_s: float) -> Frame:
        if codes.dtype not in (np.uint8, np.uint16):
            raise UserError(f"{path}: has values of type {codes.dtype}; export it with 8 or 16 bits, or as EXR")
        planes = planes_from_image(codes, 8 * codes.dtype.itemsize)
        return self._maker.frame_from_planes(str(path), planes, self._coding_of(path), time_s)

    def _coding_of(self, path: Path) -> ColourCoding:
        if path.suffix.lower() in RAW_SUFFIXES:
            check_radiance_settings(self._settings, path)
            tags = LINEAR
        else:
            tags = still_tags(path)
        if not (self._settings.transfer or tags.transfer or path.suffix.lower() in JPEG_SUFFIXES):
            way_out = "say --transfer for a picture (srgb, or linear), or name the response file of raw codes by --response"
            raise UserError(f"{path}: does not say how its codes become light; {way_out}")
        if self._coding is None or self._coding[0] != tags:
            self._coding = tags, colour_coding(self._settings, str(path), tags, STILL)
        return self._coding[1]
