"""The sensor's response: radiance to code value and back, and its file.

Four kinds, each with its signal y in codes for radiance L, and the inverse:

    log         y = a + b ln(L + c)   (Joseph and Collins 2002, "Modeling, calibration, and correction of nonlinear
                                       illumination-dependent fixed pattern noise in logarithmic CMOS image sensors")
    linear      y = a + b L
    companding  straight lines between knee points (L, y)
    srgb        y = top times the transfer curve of IEC 61966-2-1; L = 1 is white

A code is the nearest whole y between 0 and top = 2^bits - 1; these two also represent all that was clipped. A response holds for frames
exposed by `exposure_s`; L of another exposure t has the code of L t / exposure_s.
"""

from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import read_toml, write_toml
from vemlight.light.colour import linear_from_srgb, srgb_from_linear


class SensorResponse(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True, tag_field="kind"):
    """What all kinds have in common. L is radiance in the unit of the maps made with it."""

    bits: Annotated[int, Meta(ge=1, le=16)]
    luminance_scale: float | None = None  # cd/m2 per unit of L; left out: unknown
    exposure_s: float = 1.0  # of the frames for which it holds: t, or t ISO / 100 / N^2 of photographs

    @property
    def top(self) -> int:
        """The largest code."""
        return 2**self.bits - 1

    def signal(self, radiance: np.ndarray) -> np.ndarray:
        """The signal y in codes, float64, before rounding and clipping, of radiance (0 or above) of any shape."""
        raise NotImplementedError

    def radiance(self, signal: np.ndarray) -> np.ndarray:
        """The inverse of `signal`, float64; below 0 for signals below that of darkness."""
        raise NotImplementedError


class Log(SensorResponse, frozen=True, tag="log"):
    a: float  # code of L + c = 1
    b: float  # codes per factor e of L + c
    c: float  # radiance whose code darkness has, by the sensor's dark current

    def signal(self, radiance: np.ndarray) -> np.ndarray:
        return self.a + self.b * np.log(radiance + self.c)

    def radiance(self, signal: np.ndarray) -> np.ndarray:
        with np.errstate(over="ignore"):
            return np.exp((signal - self.a) / self.b) - self.c


class Linear(SensorResponse, frozen=True, tag="linear"):
    a: float  # code of darkness
    b: float  # codes per unit of L

    def signal(self, radiance: np.ndarray) -> np.ndarray:
        return self.a + self.b * radiance

    def radiance(self, signal: np.ndarray) -> np.ndarray:
        return (signal - self.a) / self.b


class Companding(SensorResponse, frozen=True, tag="companding"):
    knees: tuple[tuple[float, float], ...]  # (L, y), both rising; the first and the last line continue beyond them

    def signal(self, radiance: np.ndarray) -> np.ndarray:
        return _on_lines(radiance, *np.array(self.knees).T)

    def radiance(self, signal: np.ndarray) -> np.ndarray:
        levels, codes = np.array(self.knees).T
        return _on_lines(signal, codes, levels)


class Srgb(SensorResponse, frozen=True, tag="srgb"):
    def signal(self, radiance: np.ndarray) -> np.ndarray:
        return self.top * srgb_from_linear(radiance)

    def radiance(self, signal: np.ndarray) -> np.ndarray:
        return linear_from_srgb(signal / self.top)


Response = Log | Linear | Companding | Srgb


def _on_lines(x: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    # piecewise linear through (xs, ys), extrapolated by the end pieces
    i = np.clip(np.searchsorted(xs, x, side="right") - 1, 0, len(xs) - 2)
    return ys[i] + (x - xs[i]) * (ys[i + 1] - ys[i]) / (xs[i + 1] - xs[i])


def read_response(path: Path) -> Response:
    """Reads a response file. Raises UserError for a missing or unknown key and for values that describe no response."""
    response: Response = read_toml(path, Response)  # type: ignore[arg-type]
    try:
        check_response(response)
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
    return response


def check_response(response: Response) -> None:
    """Raises UserError unless codes increase with radiance from 0 on."""
    numbers = [value for value in msgspec.to_builtins(response, enc_hook=float).values() if not isinstance(value, str | None)]
    if not all(np.all(np.isfinite(value)) for value in numbers):
        raise UserError("a number is nan or inf; replace it")
    if isinstance(response, Log | Linear) and response.b <= 0:
        raise UserError(f"b = {response.b:g} must be above 0, so that codes rise with radiance; correct it")
    if isinstance(response, Log) and response.c <= 0:
        raise UserError(f"c = {response.c:g} must be above 0: a log response without it has no code for darkness; correct it")
    if isinstance(response, Companding) and (len(response.knees) < 2 or np.min(np.diff(response.knees, axis=0)) <= 0):
        raise UserError("knees must be two or more pairs [radiance, code], both rising from one to the next; correct them")
    if response.luminance_scale is not None and response.luminance_scale <= 0:
        raise UserError(f"luminance_scale = {response.luminance_scale:g} must be above 0 cd/m2; leave it out when it is unknown")
    if response.exposure_s <= 0:
        raise UserError(f"exposure_s = {response.exposure_s:g} must be above 0 s; leave it out where frames have one exposure")


def write_response(path: Path, response: Response) -> None:
    """Writes the TOML file that `read_response` reads back to the same record, digit for digit."""
    write_toml(path, response)


def code_from_signal(signal: np.ndarray, response: Response) -> np.ndarray:
    """The nearest code, uint16, clipped to 0 .. 2^bits - 1."""
    return np.clip(np.rint(signal), 0, response.top).astype(np.uint16)


def code_from_radiance(radiance: np.ndarray, response: Response) -> np.ndarray:
    """Codes, uint16, of radiance (0 or above) of any shape."""
    return code_from_signal(response.signal(np.asarray(radiance, np.float64)), response)


def radiance_table(response: Response) -> np.ndarray:
    """Radiance of each code, (2^bits,) float32: the response inverted, 0 for codes below that of darkness."""
    radiance = response.radiance(np.arange(response.top + 1, dtype=np.float64))
    return np.clip(radiance, 0, np.finfo(np.float32).max).astype(np.float32)
