"""Transfer curves: light of a coded signal, by the name of the standard.

A signal V is 0 at black and 1 at nominal white, or at the top of a log curve. Units of the light: PQ cd/m2; HLG, BT.709, BT.1886, sRGB and
linear 1 = signal 1; logs the maker's scene-linear, in which mid gray is 0.18. Signals below 0 follow the curve's straight foot, where it
has one, and are black otherwise.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vemlight.light.colour import linear_from_srgb

Curve = Callable[[np.ndarray], np.ndarray]
PQ_PEAK = 10_000.0  # cd/m2 of signal 1 (SMPTE ST 2084:2014)


class Transfer(NamedTuple):
    """A curve, and what its name implies. primaries: of the camera's gamut, None where tags name them."""

    light_from_signal: Curve
    primaries: str | None = None
    luminance_scale: float | None = None  # cd/m2 per unit of light, where the standard says


def _linear(v: np.ndarray) -> np.ndarray:
    return v


def _bt709(v: np.ndarray) -> np.ndarray:
    """ITU-R BT.709-6, item 1.2, inverted, with the digits of BT.2020-2, table 4, for which its two branches meet."""
    a, b = 1.09929682680944, 0.018053968510807
    return np.where(v < 4.5 * b, v / 4.5, ((np.maximum(v, 0) + a - 1) / a) ** (1 / 0.45))


def _bt1886(v: np.ndarray) -> np.ndarray:
    """ITU-R BT.1886 (2011), annex 1, for a display whose black is 0."""
    return np.maximum(v, 0) ** 2.4


def _pq(v: np.ndarray) -> np.ndarray:
    """SMPTE ST 2084:2014, eq. 4.1: cd/m2."""
    m1, m2, c2, c3 = 2610 / 16384, 2523 / 4096 * 128, 2413 / 4096 * 32, 2392 / 4096 * 32
    c1 = c3 - c2 + 1
    power = np.clip(v, 0, 1) ** (1 / m2)
    return PQ_PEAK * (np.maximum(power - c1, 0) / (c2 - c3 * power)) ** (1 / m1)


def _hlg(v: np.ndarray) -> np.ndarray:
    """ITU-R BT.2100-2, table 5, inverse OETF: scene light, 1 at signal 1."""
    a = 0.17883277
    b, c = 1 - 4 * a, 0.5 - a * math.log(4 * a)
    v = np.maximum(v, 0)
    return np.where(v <= 0.5, v**2 / 3, (np.exp((v - c) / a) + b) / 12)


def _logc3(v: np.ndarray) -> np.ndarray:
    """ARRI, "ALEXA Log C Curve" (2012), exposure index 800."""
    cut, a, b, c, d, e, f = 0.010591, 5.555556, 0.052272, 0.247190, 0.385537, 5.367655, 0.092809
    return np.where(v > e * cut + f, (10 ** ((v - d) / c) - b) / a, (v - f) / e)


def _logc4(v: np.ndarray) -> np.ndarray:
    """ARRI, "LogC4 Logarithmic Color Space" (2022), section 2."""
    a, b, c = (2**18 - 16) / 117.45, (1023 - 95) / 1023, 95 / 1023
    s = 7 * math.log(2) * 2 ** (7 - 14 * c / b) / (a * b)
    t = (2 ** (14 * -c / b + 6) - 64) / a
    return np.where(v >= 0, (2 ** (14 * (v - c) / b + 6) - 64) / a, v * s + t)


def _slog3(v: np.ndarray) -> np.ndarray:
    """Sony, "Technical Summary for S-Gamut3.Cine/S-Log3 and S-Gamut3/S-Log3" (2014)."""
    foot = 171.2102946929
    return np.where(v >= foot / 1023, 10 ** ((v * 1023 - 420) / 261.5) * 0.19 - 0.01, (v * 1023 - 95) * 0.01125 / (foot - 95))


def _vlog(v: np.ndarray) -> np.ndarray:
    """Panasonic, "V-Log/V-Gamut Reference Manual" (2014)."""
    return np.where(v < 0.181, (v - 0.125) / 5.6, 10 ** ((v - 0.598206) / 0.241514) - 0.00873)


def _acescct(v: np.ndarray) -> np.ndarray:
    """Academy S-2016-001, "ACEScct", eq. 2."""
    return np.where(v > 0.155251141552511, 2 ** (v * 17.52 - 9.72), (v - 0.0729055341958355) / 10.5402377416545)


TRANSFERS = {
    "srgb": Transfer(linear_from_srgb),
    "bt709": Transfer(_bt709),
    "bt1886": Transfer(_bt1886),
    "pq": Transfer(_pq, luminance_scale=1.0),
    "hlg": Transfer(_hlg),
    "linear": Transfer(_linear),
    "logc3": Transfer(_logc3, "awg3"),
    "logc4": Transfer(_logc4, "awg4"),
    "slog3": Transfer(_slog3, "sgamut3"),
    "vlog": Transfer(_vlog, "vgamut"),
    "acescct": Transfer(_acescct, "ap1"),
}
OCIO = "ocio:"  # before the name of one of OpenColorIO's colour spaces


def hlg_system_gamma(peak_cd_m2: float) -> float:
    """Gamma of HLG's display (ITU-R BT.2100-2, note 5f, from 400 to 2000 cd/m2; beyond these BT.2390-8, section 6.2)."""
    if 400 <= peak_cd_m2 <= 2000:
        return 1.2 + 0.42 * math.log10(peak_cd_m2 / 1000)
    return 1.2 * 1.111 ** math.log2(peak_cd_m2 / 1000)
