"""The sensor's response: radiance to code value and back, and its file.

Log sensors answer y = a + b ln(L + c) (Joseph and Collins 2002, "Modeling, calibration, and correction of nonlinear illumination-dependent
fixed pattern noise in logarithmic CMOS image sensors": offset, gain and bias); linear ones y = a + b L. A code is the nearest whole y
between 0 and 2^bits - 1; the first and the last of these also stand for all that was clipped.
"""

from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from services.files import BadInput, read_toml, written_whole


class Response(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One sensor's response, as its TOML file has it. L is radiance in the unit of the maps that come of it."""

    kind: Literal["log", "linear"]
    bits: Annotated[int, Meta(ge=1, le=16)]
    a: float  # code of the dark (linear); of L + c = 1 (log)
    b: float  # codes per unit of L (linear); per factor e of L + c (log)
    c: float = 0.0  # log: the radiance that the dark looks like
    luminance_scale: float | None = None  # cd/m2 per unit of L; left out: not known

    @property
    def top(self) -> int:
        """The largest code."""
        return 2**self.bits - 1


def read_response(path: Path) -> Response:
    """The response file at `path`. Raises BadInput for a missing or unknown key and for values that make no response."""
    response = read_toml(path, Response)
    try:
        check_response(response)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    return response


def check_response(response: Response) -> None:
    """Raises BadInput unless codes rise with radiance from 0 on."""
    scale = response.luminance_scale
    if not np.all(np.isfinite([response.a, response.b, response.c, scale or 1.0])):
        raise BadInput("a number is nan or inf; mend it")
    if response.b <= 0:
        raise BadInput(f"b = {response.b:g} must be above 0, so that codes rise with radiance")
    if response.kind == "log" and response.c <= 0:
        raise BadInput(f"c = {response.c:g} must be above 0: a log response without it has no code for the dark")
    if scale is not None and scale <= 0:
        raise BadInput(f"luminance_scale = {scale:g} must be above 0 cd/m2; leave it out when it is not known")


def write_response(path: Path, response: Response) -> None:
    """Writes the TOML file that `read_response` reads back to the same record, digit for digit."""
    rows = {key: value for key, value in msgspec.to_builtins(response, enc_hook=float).items() if value is not None}
    with written_whole(path) as part:
        part.write_text("".join(f"{key} = {_quoted(value)}\n" for key, value in rows.items()), encoding="utf-8")


def _quoted(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)


def signal_from_radiance(radiance: np.ndarray, response: Response) -> np.ndarray:
    """The sensor's answer y in codes, before it is rounded and clipped, float64; radiance of any shape, 0 or above."""
    radiance = np.asarray(radiance, np.float64)
    if response.kind == "log":
        return response.a + response.b * np.log(radiance + response.c)
    return response.a + response.b * radiance


def code_from_signal(signal: np.ndarray, response: Response) -> np.ndarray:
    """The nearest code, uint16, clipped to 0 .. 2^bits - 1."""
    return np.clip(np.rint(signal), 0, response.top).astype(np.uint16)


def code_from_radiance(radiance: np.ndarray, response: Response) -> np.ndarray:
    """Code values uint16 of radiance (0 or above) of any shape."""
    return code_from_signal(signal_from_radiance(radiance, response), response)


def radiance_table(response: Response) -> np.ndarray:
    """Radiance of each code, (2^bits,) float32: the response inverted, 0 for codes below that of the dark."""
    y = np.arange(response.top + 1, dtype=np.float64)
    if response.kind == "log":
        with np.errstate(over="ignore"):
            radiance = np.exp((y - response.a) / response.b) - response.c
    else:
        radiance = (y - response.a) / response.b
    return np.clip(radiance, 0, np.finfo(np.float32).max).astype(np.float32)


def radiance_from_code(code: np.ndarray, response: Response) -> np.ndarray:
    """Radiance float32 of code values (any integer dtype, any shape). Raises BadInput for codes above 2^bits - 1."""
    code = np.asarray(code)
    if code.size and (code.min() < 0 or code.max() > response.top):
        found = f"codes run from {code.min()} to {code.max()}"
        raise BadInput(f"{found} and the response has {response.bits} bits; give the response of this sensor")
    return radiance_table(response)[code]


def clipped_counts(code: np.ndarray, response: Response) -> tuple[int, int]:
    """How many code values sit at the lowest code and how many at the highest."""
    return int(np.count_nonzero(code == 0)), int(np.count_nonzero(code == response.top))
