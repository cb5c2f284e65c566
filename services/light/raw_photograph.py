"""Raw photographs (DNG and makers' own) as linear Rec. 709; the package that reads them is optional (`vemlight[raw]`)."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.errors import UserError
from vemlight.files import check_regular, one_line
from vemlight.light.image_limits import LIMITS, MAX_IMAGE_BYTES
from vemlight.light.primaries import REC709, xyz_from_primaries
from vemlight.light.quiet import silent

RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".pef")


@contextmanager
def opened_raw(path: Path) -> Iterator[Any]:
    """LibRaw's object of a photograph, until the block ends.

    Raises UserError without the package, for a file that is damaged or too large, and for a camera that LibRaw does not know, also where
    the block finds that out.
    """
    check_regular(path, MAX_IMAGE_BYTES)
    try:
        import rawpy
    except ImportError as error:
        raise UserError(f"{path}: is a raw photograph, and rawpy is not installed; pip install 'vemlight[raw]'") from error
    try:
        with silent(), rawpy.imread(str(path)) as raw:
            LIMITS.check(path, raw.sizes.width, raw.sizes.height, path.stat().st_size, 6)
            yield raw
    except UserError:
        raise
    except Exception as error:  # LibRaw's own errors have no common class but Exception, and tell their reason in bytes
        reason = error.args[0].decode("ascii", "replace") if error.args and isinstance(error.args[0], bytes) else one_line(error)
        raise UserError(f"{path}: cannot be read as a raw photograph ({reason}); convert it to DNG or TIFF") from error


def read_raw(path: Path) -> np.ndarray:
    """(height, width, 3) uint16, linear Rec. 709 for daylight (D65), 65535 = the sensor's white; rows as the sensor has them.

    LibRaw takes out black, demosaics and turns the camera's colours; nothing is brightened. Raises UserError as `opened_raw`.
    """
    with opened_raw(path) as raw:
        import rawpy

        daylight = list(raw.daylight_whitebalance)
        return raw.postprocess(
            user_wb=daylight if any(daylight) else [1.0, 1.0, 1.0, 1.0],
            output_color=rawpy.ColorSpace.sRGB,
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            output_bps=16,
            user_flip=0,
        )


class RawMosaic(NamedTuple):
    """The sensor's own codes of a raw photograph.

    codes: (height, width) uint16, of all colours from the same black on. pattern: colours of the first two pixels of the first two rows.
    black, white: codes of darkness and full light. rec709_from_camera: (3, 3), daylight (D65) becomes white, unit of `read_raw`.
    """

    codes: np.ndarray
    pattern: str
    black: int
    white: int
    rec709_from_camera: np.ndarray


def read_raw_mosaic(path: Path) -> RawMosaic:
    """Raises UserError as `opened_raw`, and for a sensor without a mosaic of 2 x 2 pixels of red, green and blue."""
    with opened_raw(path) as raw:
        pixels, colours = raw.raw_image_visible, raw.raw_colors_visible[:2, :2]
        letters = raw.color_desc.decode("latin-1")
        pattern = "".join(letters[n] for n in colours.ravel())
        periodic = raw.raw_pattern is not None and raw.raw_pattern.shape == (2, 2)
        if not periodic or pattern not in ("RGGB", "BGGR", "GRBG", "GBRG"):
            fault = f"its sensor's colours are {pattern[:8]}, no mosaic of 2 x 2 pixels"
            raise UserError(f"{path}: {fault}; develop it to a linear TIFF of 16 bits")
        blacks = np.array(raw.black_level_per_channel)
        black, white = int(blacks.max()), int(raw.white_level)
        if not 0 <= black < white <= 65535:
            raise UserError(f"{path}: its black is {black} and its white {white}; convert it to DNG again")
        lift = (black - blacks)[raw.raw_colors_visible]
        codes = np.minimum(pixels.astype(np.int64) + lift, white).astype(np.uint16)
        return RawMosaic(codes, pattern, black, white, _rec709_from_camera(np.array(raw.rgb_xyz_matrix), raw.daylight_whitebalance))


def _rec709_from_camera(camera_from_xyz: np.ndarray, daylight: list[float]) -> np.ndarray:
    """As LibRaw does it: rows of camera_from_rec709 are scaled to white, and the least multiplier is 1."""
    gains = np.array(daylight[:3], np.float64)
    gains = gains / gains.min() if np.all(gains > 0) else np.ones(3)
    camera_from_rec709 = camera_from_xyz[:3] @ xyz_from_primaries(REC709)
    sums = camera_from_rec709.sum(axis=1, keepdims=True)
    if not (np.all(np.isfinite(sums)) and np.all(sums > 0)):
        return np.diag(gains)
    return np.linalg.inv(camera_from_rec709 / sums) @ np.diag(gains)
