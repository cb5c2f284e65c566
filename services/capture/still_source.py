"""PNG, JPEG, TIFF and raw photographs as frames: pictures by their transfer, or raw codes by a response file.

Raw codes are gray ones of a monochrome sensor, or of the mosaic that the settings' `format` names, or have three channels.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from vemlight.capture.colour_coding import STILL, ColourCoding, colour_coding, light_of_rgb_codes
from vemlight.capture.exposure_merge import CodeValues, clipped_from, values_from_response
from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.mosaic import Mosaic, mosaic_from_attributes, whole_codes
from vemlight.capture.pixel_formats import mosaic_of
from vemlight.capture.planes import planes_from_image
from vemlight.capture.response import Log
from vemlight.capture.sequence import STILL_SUFFIXES
from vemlight.errors import UserError
from vemlight.light.colour_tags import ColourTags
from vemlight.light.images import read_codes, read_radiance
from vemlight.light.raw_photograph import RAW_SUFFIXES, read_raw, read_raw_mosaic
from vemlight.light.still_tags import still_tags
from vemlight.settings import Capture

JPEG_SUFFIXES = (".jpg", ".jpeg")
LINEAR = ColourTags("linear", "bt709", "rgb", "full")
EXPOSED = ("srgb", "bt709", "bt1886", "linear")  # curves of codes that an exposure multiplies the light of
OF_CODES = ("transfer", "matrix", "range", "light", "peak", "stereo")  # settings that say nothing of radiance


def is_still(path: Path) -> bool:
    """Whether a file holds codes, and not radiance, by its suffix."""
    return path.suffix.lower() in (*STILL_SUFFIXES, *RAW_SUFFIXES)


def check_radiance_settings(settings: Capture, path: Path) -> None:
    """Raises UserError for settings that say how codes become light, where the file at `path` holds light."""
    if said := [key for key in OF_CODES if getattr(settings, key)]:
        raise UserError(f"{path}: holds radiance, of which --{said[0]} says nothing; leave {said[0]} out")


class StillCodes(NamedTuple):
    """A still before its codes become light. codes: (height, width), of the mosaic or gray, or (height, width, 3)."""

    codes: np.ndarray
    mosaic: Mosaic | None
    values: CodeValues


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

    def codes(self, path: Path) -> StillCodes:
        """The codes of one exposure. Raises UserError as `frame`, and for codes of logs and displays."""
        suffix = path.suffix.lower()
        if suffix in RAW_SUFFIXES:
            check_radiance_settings(self._settings, path)
            raw = read_raw_mosaic(path)
            light = (np.arange(raw.white + 1) - raw.black) / (raw.white - raw.black)
            pattern: Mosaic = raw.pattern  # type: ignore[assignment]
            return StillCodes(raw.codes, pattern, CodeValues(light, clipped_from(raw.white), raw.white, 1, raw.rec709_from_camera, None))
        if suffix == ".exr":
            image, attributes = read_radiance(path)
            if attributes.get("vemlight:kind") != "codes":
                raise UserError(f"{path}: holds radiance, which has no exposure; leave out --brackets")
            mosaic = mosaic_from_attributes(str(path), attributes)
            return self.raw_codes(str(path), whole_codes(str(path), image, mosaic), mosaic, 0)
        codes = read_codes(path)
        if codes.dtype not in (np.uint8, np.uint16):
            raise UserError(f"{path}: has values of type {codes.dtype}, which are no codes; export it with 8 or 16 bits")
        if self._is_raw_codes(path):
            return self.raw_codes(str(path), codes, self._mosaic, int(suffix in JPEG_SUFFIXES))
        transfer = self._settings.transfer or still_tags(path).transfer
        if transfer and transfer not in EXPOSED:
            raise UserError(f"{path}: is {transfer}, whose codes no exposure multiplies; a bracket's are {', '.join(EXPOSED)}, or raw")
        coding, top = self._coding_of(path), 2 ** (8 * codes.dtype.itemsize) - 1
        light = light_of_rgb_codes(coding, 8 * codes.dtype.itemsize)
        reach = int(suffix in JPEG_SUFFIXES)
        values = CodeValues(light, clipped_from(top), top, reach, coding.rec709_from_light, coding.luminance_scale)
        return StillCodes(codes, "mono" if codes.ndim == 2 else None, values)

    def raw_codes(self, name: str, codes: np.ndarray, mosaic: Mosaic | None, reach: int) -> StillCodes:
        """A sensor's codes by the response file. Raises UserError without one, for that of a log sensor, and for codes above its own."""
        if codes.ndim == 3 and mosaic:
            raise UserError(f"{name}: is in colour, which no mosaic is; leave out [capture] format")
        response = self._maker.checked_response(name)
        if isinstance(response, Log):
            raise UserError(f"{name}: its response is that of a log sensor, which takes all light in one exposure; leave out brackets")
        if (highest := int(codes.max(initial=0))) > response.top:
            raise UserError(f"{name}: has code {highest} and the response {response.bits} bits; give the response of this sensor")
        mono: Mosaic = "mono"
        filters = None if codes.ndim == 3 else mosaic or mono
        return StillCodes(codes, filters, values_from_response(response, reach or int(filters not in (None, "mono"))))

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
