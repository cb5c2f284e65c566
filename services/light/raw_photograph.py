"""Raw photographs (DNG and makers' own) as linear Rec. 709; the package that reads them is optional (`vemlight[raw]`)."""

from pathlib import Path

import numpy as np

from vemlight.errors import UserError
from vemlight.files import check_regular, one_line
from vemlight.light.image_limits import LIMITS, MAX_IMAGE_BYTES
from vemlight.light.quiet import silent

RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".pef")


def read_raw(path: Path) -> np.ndarray:
    """(height, width, 3) uint16, linear Rec. 709 for daylight (D65), 65535 = the sensor's white; rows as the sensor has them.

    LibRaw takes out black, demosaics and turns the camera's colours; nothing is brightened. Raises UserError without the package, for a
    file that is damaged or too large, and for a camera that LibRaw does not know.
    """
    check_regular(path, MAX_IMAGE_BYTES)
    try:
        import rawpy
    except ImportError as error:
        raise UserError(f"{path}: is a raw photograph, and rawpy is not installed; pip install 'vemlight[raw]'") from error
    try:
        with silent(), rawpy.imread(str(path)) as raw:
            LIMITS.check(path, raw.sizes.width, raw.sizes.height, path.stat().st_size, 6)
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
    except UserError:
        raise
    except Exception as error:  # LibRaw's own errors have no common class but Exception
        raise UserError(f"{path}: cannot be read as a raw photograph ({one_line(error)}); convert it to DNG or TIFF") from error
