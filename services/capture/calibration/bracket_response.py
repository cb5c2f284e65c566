"""`vemlight calibrate response --brackets`: a camera's response from photographs of one view, whose exposures are known.

A pixel seen in two exposures gives two codes whose light differs by the ratio of the times. ln f^-1(c) = gamma ln c + a polynomial of the
root of c makes the unknowns linear (after Mitsunaga and Nayar 1999, "Radiometric self calibration", whose polynomial is of f^-1 itself).
No luminance is measured, so 1 is the top code's light.
"""

import itertools
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vemlight.capture.exposure_groups import Photograph, exposure_groups
from vemlight.capture.response import Companding, check_response, write_response
from vemlight.capture.sequence import frame_files
from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.light.exposure_tags import read_exposure
from vemlight.light.images import read_codes
from vemlight.light.raw_photograph import RAW_SUFFIXES

DEGREE = 6  # of the polynomial of the root
BLOCK = 4  # pixels on a side of a block, whose mean has a quarter of a pixel's noise; edges are left out by EVENNESS
EVENNESS = 0.04  # of the top code: range of the codes of a block that counts as even, 10 codes of 255; 0.02 to 0.08 do
DARKEST, BRIGHTEST = 10 / 255, 245 / 255  # of the top code: below, rounding is a twentieth of a code; above, pixels may be clipped
BLOCKS_OF_A_CODE = 40  # a pair of exposures: so that a large wall does not count for all
MIN_BLOCKS = 500  # in all; with fewer no pair can be held back
MIN_SPAN = (0.1, 0.85)  # of the top code, that the codes must reach: beyond them the polynomial is no more than a guess
HELD_BACK = 3  # each third pair judges the fit
BINS = 16  # of held-back pairs, by the code of the shorter exposure; each has its median error
MAX_ERROR = 0.05  # of the worst bin, and of half of the pairs
REWEIGHTINGS = 10
FAINTEST_KNEES = 20  # codes that are knees each; from there on each is KNEE_STEP above the last, and lines are right to 0.1 %
KNEE_STEP = 1.05
SLOPE_STEP = 1.01  # of a code, for the slope at the ends of what is known
THIRDS = 3  # of a stop, the steps of shutters: 1/30 is 2^-5


class Pairs(NamedTuple):
    """Codes of the same blocks in two exposures, over the top code, (n,) each, and the logarithm of the ratio of the exposures."""

    longer: np.ndarray
    shorter: np.ndarray
    log_ratio: np.ndarray

    def where(self, rows: np.ndarray) -> "Pairs":
        return Pairs(*(column[rows] for column in self))


class _Fit(NamedTuple):
    """Coefficients of `_terms`, the worst error of held-back pairs and the sum of their bins', and how many pairs there were."""

    coefficients: np.ndarray
    error: float
    sum_of_errors: float
    count: int


class BracketResponseReport(NamedTuple):
    """What a calibration found. error: of the held-back pairs' ratios, see BINS. pairs: how many there were in all."""

    response: Companding
    error: float
    pairs: int
    photographs: int
    exact_times: bool  # shutter times were taken as thirds of stops, and not as they are rounded in the files


def calibrate_from_brackets(folder: Path, out: Path, *, bits: int = 0, accept: bool = False) -> BracketResponseReport:
    """Fits a response to the photographs in `folder` and writes the response file `out`; `bits` 0: those of the files, 8 or 16.

    Raises UserError for photographs that are no brackets, show too few codes, or contradict each other by more than MAX_ERROR, unless
    `accept` allows that.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: is no folder; name the folder of the bracketed photographs")
    paths = [file.path for file in frame_files(folder)]
    if raw := next((path for path in paths if path.suffix.lower() in RAW_SUFFIXES), None):
        raise UserError(f"{raw}: is a raw photograph, which is linear and needs no response; use it with --brackets as it is")
    tags = [read_exposure(path) for path in paths]
    groups = exposure_groups([Photograph(str(p), tag.exposure_s) for p, tag in zip(paths, tags, strict=True)], str(folder))
    images = [_code_image(path) for path in paths]
    if unlike := next((k for k, image in enumerate(images) if image.shape != images[0].shape or image.dtype != images[0].dtype), None):
        raise UserError(f"{paths[unlike]}: has another size or other codes than {paths[0].name}; leave one of them out")
    top = 2.0 ** (bits or 8 * images[0].dtype.itemsize) - 1
    if (highest := max(int(image.max(initial=0)) for image in images)) > top:
        raise UserError(f"--bits {bits}: the photographs have code {highest}; leave --bits out")
    bits = bits or 8 * images[0].dtype.itemsize
    fits = []
    for exact in (False, True):
        times = [_exact_time(tag.time_s) if exact else tag.time_s for tag in tags]
        exposures = [tag._replace(time_s=time_s).exposure_s for tag, time_s in zip(tags, times, strict=True)]
        pairs = _all_pairs([[(images[k] / top, exposures[k]) for k in group] for group in groups], top)
        fits.append((_judged(str(folder), pairs), exact))
    fit, exact = min(fits, key=lambda pair: pair[0].sum_of_errors)
    return BracketResponseReport(_accepted(str(folder), fit, bits, out, accept), fit.error, fit.count, len(paths), exact)


def calibrate_from_exposures(name: str, shots: list[tuple[np.ndarray, float]], bits: int, out: Path, accept: bool) -> BracketResponseReport:
    """The same from pictures that are at hand: codes over the top code, (height, width, channels), and exposure in s, falling."""
    fit = _judged(name, _all_pairs([shots], 2.0**bits - 1))
    return BracketResponseReport(_accepted(name, fit, bits, out, accept), fit.error, fit.count, len(shots), False)


def _accepted(name: str, fit: _Fit, bits: int, out: Path, accept: bool) -> Companding:
    """The response, written to `out`. Raises UserError for one that its held-back pairs refuse, or that does not rise."""
    if not fit.error <= MAX_ERROR and not accept:
        way_out = "lock white balance, use a tripod, leave out processed files, or accept it by --accept"
        raise UserError(f"{name}: ratios of exposures come out {fit.error:.1%} wrong, beyond {MAX_ERROR:.0%}; {way_out}")
    response = _response(fit.coefficients, bits)
    try:
        check_response(response)
    except UserError as wrong:
        raise UserError(f"{name}: its exposures give no response ({wrong}); take them with fixed white balance and focus") from wrong
    write_response(out, response)
    return response


def bracket_summary(report: BracketResponseReport) -> str:
    """The report in lines for a terminal."""
    times = "times taken as thirds of stops" if report.exact_times else "times as written"
    said = f"{report.photographs} photographs, {report.pairs} pairs of codes, {times}"
    return f"{said}\nheld-back ratios of exposures come out within {report.error:.2%}"


def _code_image(path: Path) -> np.ndarray:
    codes = read_codes(path)
    if codes.dtype not in (np.uint8, np.uint16):
        raise UserError(f"{path}: has values of type {codes.dtype}, which are no codes; export it with 8 or 16 bits")
    return codes.reshape(*codes.shape[:2], -1)


def _exact_time(time_s: float) -> float:
    """The power of two, in thirds of a stop, next to a shutter time."""
    return 2.0 ** (round(THIRDS * math.log2(time_s)) / THIRDS)


def _all_pairs(frames: list[list[tuple[np.ndarray, float]]], top: float) -> Pairs:
    """The pairs of neighbouring exposures of each frame: relative codes and exposure, falling within a frame."""
    rng, found = np.random.default_rng(0), []
    for shots in frames:
        for (longer, long_s), (shorter, short_s) in itertools.pairwise(shots):
            first, second = _even_blocks(longer, shorter)
            rows = rng.permutation(len(first))
            code = np.rint(first[rows] * min(top, 255)).astype(int)
            order = np.argsort(code, kind="stable")
            place = np.arange(len(code)) - np.searchsorted(code[order], code[order])  # of a block among those of its code
            rows = rows[order[place < BLOCKS_OF_A_CODE]]
            found.append(Pairs(first[rows], second[rows], np.full(len(rows), math.log(long_s / short_s))))
    return Pairs(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _even_blocks(longer: np.ndarray, shorter: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of the blocks that are even, and neither dark nor clipped, in both images, of all channels."""
    means, usable = [], None
    for image in (longer, shorter):
        height, width = (side // BLOCK * BLOCK for side in image.shape[:2])
        blocks = image[:height, :width].reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK, -1)
        low, high = blocks.min(axis=(1, 3)), blocks.max(axis=(1, 3))
        even = (high - low < EVENNESS) & (low > DARKEST) & (high < BRIGHTEST)
        usable = even if usable is None else usable & even
        means.append(blocks.mean(axis=(1, 3)))
    return means[0][usable], means[1][usable]


def _judged(name: str, pairs: Pairs) -> _Fit:
    """A fit to two thirds of the pairs, judged by the others. Raises UserError for too few."""
    count = len(pairs.longer)
    if count < MIN_BLOCKS:
        fault = f"{count} even places are well exposed in two photographs, and {MIN_BLOCKS} are needed"
        raise UserError(f"{name}: {fault}; take closer exposures")
    codes = np.concatenate([pairs.longer, pairs.shorter])
    low, high = np.quantile(codes, [0.01, 0.99])
    if low > MIN_SPAN[0] or high < MIN_SPAN[1]:
        notice(f"{name}: its codes reach from {low:.0%} to {high:.0%} of the range; beyond them the response is extrapolated")
    held = np.random.default_rng(1).permutation(count) % HELD_BACK == 0
    coefficients = _fitted(pairs.where(~held))
    judges = pairs.where(held)
    wrong = np.expm1(_residuals(coefficients, judges))
    bins = np.array_split(wrong[np.argsort(judges.shorter, kind="stable")], BINS)
    of_bins = [abs(float(np.median(one))) for one in bins]
    return _Fit(coefficients, max(*of_bins, float(np.median(np.abs(wrong)))), sum(of_bins), count)


def _terms(x: np.ndarray) -> np.ndarray:
    """ln x and the powers of its root, (n, 1 + DEGREE)."""
    return np.column_stack([np.log(x), np.sqrt(x)[:, None] ** np.arange(1, DEGREE + 1)])


def _residuals(coefficients: np.ndarray, pairs: Pairs) -> np.ndarray:
    return (_terms(pairs.longer) - _terms(pairs.shorter)) @ coefficients - pairs.log_ratio


def _fitted(pairs: Pairs) -> np.ndarray:
    """Least absolute errors by reweighted least squares: what moved between two exposures counts little. Dark codes are rounded more."""
    rows, goal = _terms(pairs.longer) - _terms(pairs.shorter), pairs.log_ratio
    rounding = 1 / np.hypot(1 / pairs.longer, 1 / pairs.shorter)
    weight = rounding
    for _ in range(REWEIGHTINGS):
        found = np.linalg.lstsq(rows * weight[:, None], goal * weight, rcond=None)[0]
        off = np.abs(rows @ found - goal) * rounding
        weight = rounding / np.sqrt(1 + np.square(off / max(2 * float(np.median(off)), 1e-9)))
    return found


def _response(coefficients: np.ndarray, bits: int) -> Companding:
    """Knees of the fitted curve, 1 at the top code."""
    top = 2**bits - 1
    unit = top / 255
    codes = [k * unit for k in range(1, FAINTEST_KNEES + 1)]
    while codes[-1] * KNEE_STEP < top:
        codes.append(codes[-1] * KNEE_STEP)
    x = np.array([*codes[:-1], top]) / top
    # beyond the codes that were fitted the curve goes on as the power that it is there, between a line and a cube
    known = np.clip(x, DARKEST, BRIGHTEST)
    ends = np.array([DARKEST, BRIGHTEST])
    slopes = np.clip((_terms(ends * SLOPE_STEP) - _terms(ends)) @ coefficients / math.log(SLOPE_STEP), 1.0, 3.0)
    light = _terms(known) @ coefficients + np.log(x / known) * slopes[(x > DARKEST).astype(int)]
    light = np.exp(light - light[-1])
    knees = [(0.0, 0.0), *((float(level), float(code)) for level, code in zip(light, x * top, strict=True))]
    return Companding(bits=bits, knees=tuple(knees))
