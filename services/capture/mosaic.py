"""Raw codes of a sensor, and the colour filters before its pixels: which there are, and how a file says them."""

from typing import Any, Literal, get_args

import numpy as np

from vemlight.capture.fisheye import BayerPattern
from vemlight.errors import UserError

Mosaic = Literal["mono"] | BayerPattern  # colour filters before a sensor's pixels; "mono": none
MOSAICS: tuple[Mosaic, ...] = ("mono", *get_args(BayerPattern))
ALL_CODES = 2**16  # a table for uint16 codes needs no check of its index


def mosaic_from_attributes(name: str, attributes: dict[str, Any]) -> Mosaic | None:
    """The mosaic that a frame's header names; None for three channels. Raises UserError for one that is not known."""
    mosaic = attributes.get("vemlight:mosaic")
    if mosaic not in (None, *MOSAICS):
        raise UserError(f"{name}: vemlight:mosaic = {str(mosaic)[:40]!r} is not known; it is one of {', '.join(MOSAICS)}")
    return mosaic


def whole_codes(name: str, image: np.ndarray, mosaic: Mosaic | None) -> np.ndarray:
    """A file's float pixels as uint16 codes: (height, width) of a mosaic, else (height, width, 3). Raises UserError for other values."""
    if mosaic:
        image = np.ascontiguousarray(image[..., 0])
    codes = np.where((image >= 0) & (image < ALL_CODES), image, 0).astype(np.uint16)
    if not np.array_equal(codes, image):
        raise UserError(f"{name}: holds values that are no whole codes; leave the response out if it is radiance")
    return codes
