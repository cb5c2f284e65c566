"""`vemlight calibrate response`: the sensor's response from patches of known luminance.

The patches come from a CSV file, or are the six gray ones of a ColorChecker in a frame. The result maps codes to cd/m2. Patches marked
check are left out of the fit and judge it. One that contradicts the others is left out with a line, and the others must fit.
"""

import itertools
import math
from pathlib import Path
from typing import Literal, NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares

from vemlight.capture.calibration.colorchecker import LIGHTNESS, gray_codes
from vemlight.capture.calibration.patches import Patch
from vemlight.capture.calibration.response_outliers import (
    CODE_TOLERANCE,
    bends_up,
    luminance_errors,
    signal_errors,
    without_outliers,
)
from vemlight.capture.response import Companding, Linear, Log, Response, Srgb, check_response, write_response
from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.light.images import write_png

Kind = Literal["log", "linear", "companding", "srgb"]
MAX_CHECK_ERROR = 0.05  # of a check patch's luminance: as much as luminance meters differ
MIN_PATCHES: dict[Kind, int] = {"log": 4, "linear": 2, "companding": 2, "srgb": 1}  # to fit: the unknowns, and one more for log's c
UNKNOWNS: dict[Kind, int] = {"log": 3, "linear": 2, "srgb": 1}
LOSS_CODES = 2.0  # for log, whose noise is uniform in codes: patches farther off count linearly; 1 to 5 do
LOG_OFFSETS = 120  # candidates for c over the patches' range and three decades below, a tenth of a decade or less apart; 60 or more do
REWEIGHTINGS = 8  # of the least absolute errors: the candidates' order is settled after 4
MIN_DEVIATION = 1e-3  # codes, below which an error has full weight; 1e-6 to 0.1 do
CHECK_PATCHES = (1, 4)  # of the six gray patches: one bright, one dark, and neither at an end


class ResponseReport(NamedTuple):
    """What a calibration found."""

    response: Response
    errors: list[tuple[Patch, float]]  # each check patch and its luminance's relative error
    worst: float  # the largest of these, without sign


def calibrate_response(
    patches: list[Patch], out: Path, *, kind: Kind = "log", bits: int = 0, accept: bool = False, picture: Path | None = None
) -> ResponseReport:
    """Fits a response to the patches, writes the response file `out` and, if named, a PNG of the fit.

    `bits` 0 takes the smallest of 8, 10, 12, 14 and 16 that holds the codes, and a notice says so. Raises UserError for patches whose codes
    do not rise with luminance, too few of them, none to check, and an error above 5 % at a check patch, or at one that was fitted and is
    off by more than noise, unless `accept` allows it.
    """
    bits = bits or _bits_that_hold(patches)
    if (highest := max((p.code for p in patches), default=0)) >= 2 ** (bits + 1):  # no noise of the highest code
        raise UserError(f"a patch has code {highest:g}, and {bits} bits end at {2**bits - 1}; correct it, or --bits")
    usable = [p for p in patches if 0 < p.code < 2**bits - 1]  # codes at the ends may have been clipped
    if clipped := len(patches) - len(usable):
        notice(f"{clipped} patches at the lowest or highest code are left out: they may have been clipped")
    fit = sorted((p for p in usable if not p.check), key=lambda p: p.luminance)
    check = [p for p in usable if p.check]
    fit = _agreeing(fit, kind, bits)
    _check_patches(fit, check, kind)
    response = fit_response(fit, kind, bits)
    try:
        check_response(response)
    except UserError as error:
        raise UserError(f"the patches give no {kind} response ({error}); check them") from error
    errors = list(zip(check, luminance_errors(response, check).tolist(), strict=True))
    worst = max(abs(error) for _, error in errors)
    if picture:
        write_png(picture, fit_picture(response, patches)[..., ::-1])
    if not accept:
        _check_errors(response, fit, errors, kind)
    write_response(out, response)
    return ResponseReport(response, errors, worst)


def _bits_that_hold(patches: list[Patch]) -> int:
    highest = max((patch.code for patch in patches), default=0.0)
    bits = next((b for b in (8, 10, 12, 14, 16) if highest < 2**b), 16)
    notice(f"codes are taken to have {bits} bits, the fewest that hold the brightest patch's {highest:g}; --bits says otherwise")
    return bits


def _agreeing(fit: list[Patch], kind: Kind, bits: int) -> list[Patch]:
    """The patches to fit without those that contradict the others, of which a notice tells."""
    if kind == "companding" or len(fit) < MIN_PATCHES[kind]:
        return fit
    agreeing, outliers = without_outliers(fit, lambda patches: fit_response(patches, kind, bits), UNKNOWNS[kind])
    response = fit_response(agreeing, kind, bits) if outliers else None
    for patch in outliers:
        assert response is not None
        off = float(signal_errors(response, [patch])[0])
        notice(f"the patch of {patch.luminance:g} cd/m2 (code {patch.code:g}) is left out: {off:+.0f} codes off what the others say")
    return agreeing


def _check_errors(response: Response, fit: list[Patch], errors: list[tuple[Patch, float]], kind: Kind) -> None:
    """Raises UserError for a patch whose luminance comes out wrong."""
    patch, error = max(errors, key=lambda pair: abs(pair[1]))
    mend = "measure again, fit another kind, or accept it"
    if not abs(error) <= MAX_CHECK_ERROR:
        raise UserError(f"the check patch of {patch.luminance:g} cd/m2 comes out {error:+.1%}, beyond {MAX_CHECK_ERROR:.0%}; {mend}")
    if kind == "companding":
        if bent := bends_up(fit):
            where = f"{bent.luminance:g} cd/m2 (code {bent.code:g})"
            raise UserError(f"the response grows steeper at {where}, which no companding sensor's does; {mend}")
        return
    for patch, error, off in zip(fit, luminance_errors(response, fit), signal_errors(response, fit), strict=True):
        if not abs(error) <= MAX_CHECK_ERROR and abs(off) > CODE_TOLERANCE:
            detail = f"the patch of {patch.luminance:g} cd/m2 (code {patch.code:g}) comes out {error:+.1%}, beyond {MAX_CHECK_ERROR:.0%}"
            raise UserError(f"{detail}, with the fit that the others ask for; {mend}")


def _check_patches(fit: list[Patch], check: list[Patch], kind: Kind) -> None:
    if len(fit) < MIN_PATCHES[kind]:
        raise UserError(f"{len(fit)} patches to fit, not clipped, and a {kind} response needs {MIN_PATCHES[kind]}; measure more")
    if not check:
        raise UserError("no patch is marked check; keep one or two out of the fit to judge it")
    for darker, brighter in itertools.pairwise(fit):
        if brighter.code < darker.code - CODE_TOLERANCE:
            pair = f"{brighter.luminance:g} cd/m2 gave code {brighter.code:g} and {darker.luminance:g} cd/m2 gave {darker.code:g}"
            raise UserError(f"codes do not rise with luminance: {pair}; check the patches")


def response_summary(report: ResponseReport) -> str:
    """The report in lines for a terminal."""
    checks = [f"  {patch.luminance:g} cd/m2 (code {patch.code:g}): {error:+.2%}" for patch, error in report.errors]
    return "\n".join([f"{report.response}", f"check patches, worst {report.worst:.2%}:", *checks])


def fit_response(fit: list[Patch], kind: Kind, bits: int) -> Response:
    """The response of a kind that fits patches in order of luminance best. Raises UserError when a log's codes do not rise."""
    code, luminance = np.array([p.code for p in fit]), np.array([p.luminance for p in fit])
    weight = np.sqrt([p.weight for p in fit])
    if kind == "log":
        return _fit_log(code, luminance, weight, bits)
    if kind == "linear":
        # (y / b - a / b) / L = 1: each patch counts by its relative error
        rows = np.column_stack([code, -np.ones_like(code)]) * (weight / luminance)[:, None]
        inverse, offset = np.linalg.lstsq(rows, weight, rcond=None)[0]
        b = 1 / inverse if inverse else 0.0
        return Linear(bits=bits, a=float(offset * b), b=float(b), luminance_scale=1.0)
    if kind == "srgb":
        # luminance of white, by the median: a single bad patch does not change it
        white = np.median(luminance / Srgb(bits=bits).radiance(code))
        return Srgb(bits=bits, luminance_scale=float(white))
    return _fit_companding(code, luminance, weight**2, bits)


def _fit_companding(code: np.ndarray, luminance: np.ndarray, weight: np.ndarray, bits: int) -> Companding:
    # each patch is a knee; those that noise has put level or out of order are merged
    knees: list[list[float]] = []
    for level, y, w in zip(luminance, code, weight, strict=True):
        knees.append([level, y, w])
        while len(knees) > 1 and (knees[-1][1] <= knees[-2][1] or knees[-1][0] <= knees[-2][0]):
            (l1, y1, w1), (l2, y2, w2) = knees.pop(), knees.pop()
            knees.append([(l1 * w1 + l2 * w2) / (w1 + w2), (y1 * w1 + y2 * w2) / (w1 + w2), w1 + w2])
    return Companding(bits=bits, knees=tuple((float(level), float(y)) for level, y, _ in knees), luminance_scale=1.0)


def _fit_log(code: np.ndarray, luminance: np.ndarray, weight: np.ndarray, bits: int) -> Log:
    # for a given c, a and b are linear: least absolute errors choose among candidates; then all three are refined
    best = (math.inf, np.zeros(3))
    for c in np.geomspace(luminance.min() * 1e-3, luminance.max(), LOG_OFFSETS):
        rows = np.column_stack([np.ones_like(code), np.log(luminance + c)])
        a, b = _least_absolute(rows, code, weight)
        score = float(np.sum(weight * np.abs(rows @ [a, b] - code)))
        if b > 0 and score < best[0]:
            best = score, np.array([a, b, math.log(c)])
    if best[0] == math.inf:
        raise UserError("codes do not rise with luminance; check the patches")

    def errors(parameters: np.ndarray) -> np.ndarray:
        a, b, log_c = parameters
        return weight * (a + b * np.log(luminance + math.exp(log_c)) - code)

    low = [-np.inf, 0, math.log(luminance.min() * 1e-6)]
    a, b, log_c = least_squares(errors, best[1], bounds=(low, np.inf), loss="soft_l1", f_scale=LOSS_CODES, x_scale="jac").x
    return Log(bits=bits, a=float(a), b=float(b), c=math.exp(log_c), luminance_scale=1.0)


def _least_absolute(rows: np.ndarray, goal: np.ndarray, weight: np.ndarray) -> np.ndarray:
    # least absolute errors by iteratively reweighted least squares
    w = weight.copy()
    for _ in range(REWEIGHTINGS):
        found = np.linalg.lstsq(rows * w[:, None], goal * w, rcond=None)[0]
        w = np.sqrt(weight / np.maximum(np.abs(rows @ found - goal), MIN_DEVIATION))
    return found


def gray_patches(codes: np.ndarray, chart: np.ndarray, white_luminance: float) -> list[Patch]:
    """The six gray patches of a ColorChecker in a frame of codes (height, width) or (.., 3).

    `chart`: centres of its patches, (4, 6, 2), as `find_chart` and `chart_from_corners` return them; `white_luminance`: that of the white
    patch, cd/m2. Patches 2 and 5 of the row are marked check. Raises UserError for a chart that lies partly outside the frame.
    """
    relative = ((LIGHTNESS[-1] + 16) / 116) ** 3  # CIE 1976, above L* = 8
    levels = relative / relative[0] * white_luminance
    return [Patch(float(code), float(levels[n]), n in CHECK_PATCHES) for n, code in enumerate(gray_codes(codes, chart))]


def fit_picture(response: Response, patches: list[Patch]) -> np.ndarray:
    """Image (480, 640, 3) uint8, BGR: code against luminance (log scale): the fit, patches to fit (green) and to check (orange)."""
    image = np.full((480, 640, 3), 255, np.uint8)
    levels = np.array([p.luminance for p in patches])
    low, high = math.floor(math.log10(levels.min())) - 0.2, math.ceil(math.log10(levels.max())) + 0.2

    def place(luminance: float, code: float) -> tuple[int, int]:
        return round(60 + 560 * (math.log10(luminance) - low) / (high - low)), round(430 - 400 * code / response.top)

    for decade in range(math.ceil(low), math.floor(high) + 1):
        x = place(10.0**decade, 0)[0]
        cv2.line(image, (x, 30), (x, 430), (225, 225, 225), 1)
        cv2.putText(image, f"{10.0**decade:g}", (x - 12, 448), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (60, 60, 60), 1, cv2.LINE_AA)
    for code in np.linspace(0, response.top, 5):
        y = place(10.0**low, code)[1]
        cv2.line(image, (60, y), (620, y), (225, 225, 225), 1)
        cv2.putText(image, f"{code:.0f}", (12, y + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (60, 60, 60), 1, cv2.LINE_AA)
    at = np.logspace(low, high, 400)
    signal = np.clip(response.signal(at / (response.luminance_scale or 1.0)), 0, response.top)
    line = np.array([place(x, y) for x, y in zip(at, signal, strict=True)], np.int32)
    cv2.polylines(image, [line], False, (160, 90, 20), 1, cv2.LINE_AA)
    for p in patches:
        cv2.circle(image, place(p.luminance, p.code), 4, (0, 140, 255) if p.check else (60, 160, 60), -1, cv2.LINE_AA)
    cv2.putText(image, "code against luminance, cd/m2", (60, 470), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (60, 60, 60), 1, cv2.LINE_AA)
    return image
