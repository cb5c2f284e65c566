"""The EXR attributes of a recorded polar map."""

from fractions import Fraction
from typing import Any

import msgspec

from vemlight.capture.exr_header import BRIGHT_CELLS, ESTIMATED_LUX, bright_cells_text
from vemlight.capture.frames import Frame


def map_attributes(frame: Frame, fps: float) -> dict[str, Any]:
    """The EXR attributes of a polar map."""
    attributes: dict[str, Any] = {
        "vemlight:kind": "polar",
        "vemlight:coverage": frame.coverage,
        BRIGHT_CELLS: bright_cells_text(frame.bright_cells),
        "vemlight:black": frame.black,
        "vemlight:saturated": frame.saturated,
        "framesPerSecond": Fraction(fps).limit_denominator(1001),
    }
    if frame.masks:
        attributes["vemlight:masks"] = msgspec.json.encode(frame.masks).decode()
    if frame.clipped:
        attributes["vemlight:clipped"] = 1
    if frame.estimated_lux:
        attributes[ESTIMATED_LUX] = repr(frame.estimated_lux)
    if frame.luminance_scale is not None:
        attributes |= {"whiteLuminance": frame.luminance_scale, "vemlight:luminance_scale": repr(frame.luminance_scale)}
    return attributes
