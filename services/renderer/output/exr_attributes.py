"""How a rendered picture is kept in OpenEXR: half or 32-bit floats, and the attributes by which other programs place it in time.

Source: "Standard Optional Attributes", openexr.com. What is not known is left out.
"""

import datetime
from fractions import Fraction
from typing import Any

import numpy as np

from vemlight.choices import ExrFloats

HALF_MAX = 65504.0  # a half's largest number
MAX_DENOMINATOR = 1001  # of frame rates: 30000/1001 and the like


def exr_pixels(picture: np.ndarray, floats: ExrFloats) -> np.ndarray:
    """The picture as it is to be written: in halves, unless "float" is asked for or a number is beyond a half's largest."""
    if floats == "half" and np.abs(picture).max(initial=0) <= HALF_MAX:
        return picture.astype(np.float16)
    return picture.astype(np.float32)


def time_attributes(sequence: int, time_s: float, fps: float | None = None, captured_ns: int | None = None) -> dict[str, Any]:
    """Number and time of a picture. fps: the source's frame rate, where it is known; captured_ns: realtime of a live capture."""
    attributes: dict[str, Any] = {"imageCounter": sequence % 2**31, "vemlight:sequence": str(sequence), "vemlight:time_s": repr(time_s)}
    if fps is not None:
        attributes |= {"framesPerSecond": Fraction(fps).limit_denominator(MAX_DENOMINATOR), "timeCode": time_code(time_s, fps)}
    if captured_ns is not None:
        at = datetime.datetime.fromtimestamp(captured_ns // 10**9, datetime.UTC)
        attributes |= {"capDate": at.strftime("%Y:%m:%d %H:%M:%S"), "utcOffset": 0.0, "vemlight:time_ns": str(captured_ns)}
    return attributes


def time_code(time_s: float, fps: float) -> Any:
    """SMPTE time code without drop frames, which counts at most 30 frames a second: of a faster source each number stands for several."""
    import OpenEXR

    counted = max(1, round(fps))
    number = round(time_s * fps)
    seconds, frame = divmod(number, counted)
    shown = frame * 30 // counted if counted > 30 else frame
    return OpenEXR.TimeCode(seconds // 3600 % 24, seconds // 60 % 60, seconds % 60, shown, *14 * [0])  # flags and user's bits: none
