"""Tone mapping: Reinhard's global operator or an exponential one, with statistics of the picture smoothed over time.

Reinhard et al. 2002, Photographic Tone Reproduction for Digital Images, equations 1 to 4: luminance is scaled by key / log-average to L
and compressed to L (1 + L / white^2) / (1 + L). Key and white follow from the log-average and from the lowest and highest luminance (1 %
and 99 % quantiles). All are smoothed as logarithms, so that brightening and darkening take equally long.

Lu et al. 2015, section 5: luminance over the frame's mean is L, mapped to 1 - exp(-L). Dark parts keep their contrast; what is several
times as bright as the mean becomes white.
"""

from typing import NamedTuple

import msgspec
import numpy as np

from vemlight.choices import Tone
from vemlight.light.colour import luminance_from_rgb, srgb_from_linear
from vemlight.renderer.gl.constants import MAX_RADIANCE

TIME_CONSTANT_S = 0.4  # of the eye's slower receptors (Krawczyk et al. 2005); leaves 4 % of a 10 Hz flicker
MAX_STEP_S = 0.25  # a longer gap, after dropped frames, counts as this, so that the first picture after it does not jump
MIDDLE_GREY = 0.18  # key of a picture whose log-average lies midway between its lowest and highest luminance
KEY_RANGE = 4.0  # by which the key goes up or down from middle grey: Reinhard 2003, equation 4
QUANTILES = (0.01, 0.99)  # of the lowest and highest luminance, so that single pixels do not set them
MIN_LUMINANCE = 1e-4  # times the median: what is darker is black beside it, and would lower the mean of logarithms without limit
MAX_STATISTICS_PIXELS = 65_536  # those of a larger picture are subsampled: quantiles are then good to 1 / sqrt(65,536 * 0.01), 4 %


class Adaptation(msgspec.Struct, frozen=True):
    """What the tone mapping is adapted to: natural logarithms of luminance. seen: false until a picture had any light."""

    log_average: float = 0.0
    log_low: float = 0.0
    log_high: float = 0.0
    log_mean: float = 0.0
    seen: bool = False

    @property
    def key(self) -> float:
        """The automatic key (Reinhard 2003, Parameter Estimation, equation 4), 0.045 to 0.72; middle grey for a flat picture."""
        span = self.log_high - self.log_low
        if span < 1e-6:  # any value in 1e-9 .. 1e-2 does
            return MIDDLE_GREY
        return float(MIDDLE_GREY * KEY_RANGE ** np.clip((2 * self.log_average - self.log_low - self.log_high) / span, -1, 1))


class ToneCurve(NamedTuple):
    """scale: from luminance to L. white: the L that becomes 1, where a white of 1 makes Reinhard's operator linear; None: exponential."""

    scale: float
    white: float | None


def adapt(adaptation: Adaptation | None, picture: np.ndarray, dt_s: float) -> Adaptation:
    """The adaptation to `picture`, (height, width, 4) linear or `subsampled` of it, `dt_s` seconds after `adaptation`.

    A picture without light leaves it as it was; the first one with light, or None for `adaptation`, sets it at once.
    """
    before = adaptation or Adaptation()
    values = np.sort(_luminance(picture))  # once, for median and quantiles
    lit = values[np.searchsorted(values, 0.0, side="right") :]
    if len(lit) == 0:
        return before
    logs = np.log(lit[np.searchsorted(lit, MIN_LUMINANCE * lit[len(lit) // 2]) :])
    low, high = np.interp(QUANTILES, np.linspace(0, 1, len(logs)), logs)
    now = (float(logs.mean(dtype=np.float64)), float(low), float(high), float(np.log(values.mean(dtype=np.float64))))
    if not before.seen:
        return Adaptation(*now, seen=True)
    weight = 1 - np.exp(-min(max(dt_s, 0.0), MAX_STEP_S) / TIME_CONSTANT_S)
    old = (before.log_average, before.log_low, before.log_high, before.log_mean)
    return Adaptation(*(float(a + weight * (b - a)) for a, b in zip(old, now, strict=True)), seen=True)


def subsample_grid(shape: tuple[int, ...]) -> tuple[int, int]:
    """The first row and column of a picture (height, width, ..) that `subsampled` has, and the stride from each to the next."""
    stride = max(int(np.ceil(np.sqrt(shape[0] * shape[1] / MAX_STATISTICS_PIXELS))), 1)
    return stride // 2, stride


def subsampled(picture: np.ndarray) -> np.ndarray:
    """Every n-th pixel of every n-th row of a picture, at most about MAX_STATISTICS_PIXELS: enough for its statistics."""
    first, stride = subsample_grid(picture.shape)
    return picture[first::stride, first::stride]


def _luminance(picture: np.ndarray) -> np.ndarray:
    """The luminance (n,) of a picture's pixels that show something, without nan, inf and negative values; alpha divided out."""
    pixels = picture.reshape(-1, 4)
    with np.errstate(all="ignore"):
        values = luminance_from_rgb(pixels[:, :3]) / pixels[:, 3]
    return values[(pixels[:, 3] > 0) & np.isfinite(values) & (values >= 0)]


def tone_curve(adaptation: Adaptation, exposure_stops: float, tone: Tone = "reinhard") -> ToneCurve:
    """The operator's parameters. White is the adapted highest luminance, at least 1 so that a flat picture is not all white."""
    if tone == "exponential":
        return ToneCurve(float(2.0**exposure_stops * np.exp(-adaptation.log_mean)), None)
    scale = adaptation.key * np.exp(-adaptation.log_average)
    white = max(1.0, float(scale * np.exp(adaptation.log_high)))
    return ToneCurve(float(scale * 2.0**exposure_stops), white)


def tone_mapped(picture: np.ndarray, adaptation: Adaptation, exposure_stops: float, tone: Tone = "reinhard") -> np.ndarray:
    """A picture (height, width, 4), linear with RGB times alpha, for a screen: (height, width, 4) uint8, sRGB with straight alpha.

    nan and negative values become 0, inf becomes white. The same function as tonemap.frag.
    """
    curve = tone_curve(adaptation, exposure_stops, tone)
    alpha = np.clip(picture[..., 3:], 0, 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        colour = np.where(alpha > 0, picture[..., :3] / alpha, 0)
    colour = np.minimum(np.where(colour > 0, colour, 0), np.float32(MAX_RADIANCE))
    level = curve.scale * luminance_from_rgb(colour.astype(np.float64))[..., None]
    gain = -np.expm1(-level) / np.maximum(level, 1e-300) if curve.white is None else (1 + level / curve.white**2) / (1 + level)
    colour = np.clip(curve.scale * colour * gain, 0, 1)
    encoded = srgb_from_linear(colour)
    return (np.concatenate([encoded, alpha], axis=-1) * 255 + 0.5).astype(np.uint8)
