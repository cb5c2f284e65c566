"""Colour: luminance of linear Rec. 709 values and the sRGB transfer curve.

The one home of these numbers: shaders read them from the include that vemlight.renderer.gl.constants generates, the viewer's page from
`/constants.js`, which the viewer serves.

References: ITU-R BT.709-6 (2015), item 3.2, luminance of primaries and D65 white; IEC 61966-2-1 (1999), the sRGB transfer curve.
"""

import numpy as np

LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722])  # of red, green and blue, Rec. 709 primaries with D65 white
LUMINANCE_RED, LUMINANCE_GREEN, LUMINANCE_BLUE = (float(weight) for weight in LUMINANCE_WEIGHTS)  # for compiled loops

# sRGB code c in 0..1 of linear light x: SRGB_SLOPE x up to SRGB_LINEAR_END, (1 + SRGB_OFFSET) x^(1 / SRGB_GAMMA) - SRGB_OFFSET beyond.
SRGB_SLOPE = 12.92
SRGB_OFFSET = 0.055
SRGB_GAMMA = 2.4
SRGB_LINEAR_END = 0.0031308
SRGB_CODED_END = 0.04045  # the code there, as the standard rounds it: 12.92 * 0.0031308 = 0.04044994


def luminance_from_rgb(rgb: np.ndarray) -> np.ndarray:
    """Luminance Y of linear Rec. 709 colours (..., 3), in their unit and, for floats, their dtype."""
    return rgb @ LUMINANCE_WEIGHTS.astype(rgb.dtype if rgb.dtype.kind == "f" else np.float64)


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """sRGB codes of linear values of any shape; 0 to 1 map to 0 to 1, what lies outside goes on along the curve."""
    curve = (1 + SRGB_OFFSET) * np.maximum(linear, SRGB_LINEAR_END) ** (1 / SRGB_GAMMA) - SRGB_OFFSET
    return np.where(linear <= SRGB_LINEAR_END, SRGB_SLOPE * linear, curve)


def linear_from_srgb(coded: np.ndarray) -> np.ndarray:
    """Linear values of sRGB codes of any shape, 0 to 1: the inverse of `srgb_from_linear` to 3e-8, the standard's own rounding."""
    curve = ((np.maximum(coded, SRGB_CODED_END) + SRGB_OFFSET) / (1 + SRGB_OFFSET)) ** SRGB_GAMMA
    return np.where(coded <= SRGB_CODED_END, coded / SRGB_SLOPE, curve)
