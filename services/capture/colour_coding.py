"""How the codes of a picture become linear Rec. 709: what the settings say, else what the picture's tags say, else BT.709.

Order: codes -> range and matrix -> inverse transfer, by a table -> display light of HLG -> primaries to Rec. 709 with D65.
"""

from typing import NamedTuple, get_args

import numpy as np

from vemlight.capture.response import Response
from vemlight.choices import Matrix, Primaries
from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.light.colour_tags import ColourTags
from vemlight.light.ocio import probed_space
from vemlight.light.primaries import PRIMARIES, rec709_from_primaries
from vemlight.light.transfers import OCIO, TRANSFERS, hlg_system_gamma
from vemlight.settings import Capture
from vemlight.toml import choice_hint

# Signals outside are as these: limited range reaches from -0.073 to 1.091, and a matrix beyond that for colours that no camera saw.
LOWEST, HIGHEST = -0.125, 1.125
# Entries of the table between them, with straight lines from one to the next: PQ, the steepest, is then right to 2e-4 from 0.01 cd/m2 on,
# and the table fits the first cache; 2048 to 16384 do.
ENTRIES = 5121
PER_SIGNAL = (ENTRIES - 1) / (HIGHEST - LOWEST)
LUMA = {"bt601": (0.299, 0.114), "bt709": (0.2126, 0.0722), "bt2020": (0.2627, 0.0593)}  # K_R and K_B of BT.601-7, BT.709-6, BT.2020-2
REC2020_LUMINANCE = (0.2627, 0.6780, 0.0593)
STILL = ColourTags("srgb", "bt709", "bt601", "full")  # of JPEG files without tags (JFIF 1.02)
VIDEO = ColourTags("bt709", "bt709", "bt709", "limited")  # of all others
HLG_PEAK = 1000.0  # cd/m2 of the display for which HLG's gamma is 1.2 (ITU-R BT.2100-2, note 5e)
CODE_LOGS = ("slog3", "vlog")  # whose makers count the signal in codes of the whole range, 0 to 1023


class ColourCoding(NamedTuple):
    """How signals become light. range, matrix: of the codes, which `signal_from_codes` takes."""

    range: str
    matrix: str
    table: np.ndarray  # (ENTRIES,) float32, light of signals even from LOWEST to HIGHEST
    rec709_from_light: np.ndarray  # (3, 3)
    display_gain: float  # HLG's display: peak and exponent of the scene's luminance; gain 0: no such step
    display_exponent: float
    luminance_scale: float | None  # cd/m2 per unit


def colour_coding(
    settings: Capture, name: str, tags: ColourTags, unsaid: ColourTags = VIDEO, response: Response | None = None
) -> ColourCoding:
    """The coding of pictures with these `tags`; `name` is for notices and errors, `unsaid` what holds where neither says anything.

    response: of the sensor, for each channel after range and matrix; it replaces the transfer. Raises UserError for a tag that is not read
    and no setting overrules, and for settings that do not go together.
    """
    setting = "response" if response else settings.transfer or None
    if response and settings.transfer:
        raise UserError(f"{name}: transfer and response both say what a code is worth; leave one of them out")
    transfer, assumed = _chosen(name, "transfer", setting, tags.transfer, unsaid.transfer)
    implied = None if response else _implied_primaries(settings, transfer)
    primaries, of_primaries = _chosen(name, "primaries", settings.primaries or implied, tags.primaries, unsaid.primaries)
    matrix, of_matrix = _chosen(name, "matrix", settings.matrix, tags.matrix, unsaid.matrix)
    range_, of_range = _chosen(name, "range", settings.range, tags.range, unsaid.range)
    if taken := [*assumed, *of_primaries, *of_matrix, *of_range]:
        unsaid_ones = " and ".join(filter(None, (", ".join(taken[:-1]), taken[-1])))
        notice(f"{name}: does not say its {unsaid_ones}; say it by --transfer, --primaries, --matrix, --range if that is wrong")
    if transfer in CODE_LOGS and range_ == "limited":
        notice(f"{name}: {transfer} in limited range: code 940 of 1023 counts as signal 1, as programs write it; --range full where the "
               f"camera's own film counts codes from 0 to 1023")  # fmt: skip
    if response:
        signals = np.linspace(LOWEST, HIGHEST, ENTRIES)
        light = np.clip(response.radiance(signals * response.top), 0, np.finfo(np.float32).max).astype(np.float32)
        return ColourCoding(range_, matrix, light, rec709_from_primaries(PRIMARIES[primaries]), 0.0, 0.0, response.luminance_scale)
    return _coding(settings, name, transfer, primaries, matrix, range_)


def white_entry(bits: int) -> float:
    """The place in the table from which a signal counts as the highest: 1, less half of the smallest step of codes of so many bits."""
    return (1 - 0.5 / (2**bits - 1) - LOWEST) * PER_SIGNAL


def with_bright_white(coding: ColourCoding, bits: int, gain: float) -> ColourCoding:
    """The coding in which signals that count as the highest have so many times their light in addition. bits: of a code."""
    if not gain:
        return coding
    table = coding.table.copy()
    table[int(np.ceil(white_entry(bits))) :] *= np.float32(1 + gain)
    return coding._replace(table=table)


def _chosen(name: str, what: str, setting: str | None, tag: str | None, unsaid: str | None) -> tuple[str, list[str]]:
    """The name that holds, and "WHAT (taken as NAME)" where nothing says it. Raises UserError for a tag that is not read."""
    if setting:
        return setting, []
    if tag and tag.startswith("tag "):
        raise UserError(f"{name}: its {what} is {tag}, which is not read; convert it, or say --{what} if that is wrong")
    return (tag, []) if tag else (str(unsaid), [f"{what} (taken as {unsaid})"])


def _implied_primaries(settings: Capture, transfer: str) -> str | None:
    if transfer.startswith(OCIO):
        if settings.primaries:
            raise UserError(f"--primaries, [capture] primaries: {transfer} has its own; leave primaries out")
        return OCIO
    if transfer not in TRANSFERS:
        raise UserError(f"--transfer, [capture] transfer: {transfer[:40]} is no choice; {choice_hint(transfer, (*TRANSFERS, 'ocio:NAME'))}")
    return TRANSFERS[transfer].primaries


def _coding(settings: Capture, name: str, transfer: str, primaries: str, matrix: str, range_: str) -> ColourCoding:
    signals = np.linspace(LOWEST, HIGHEST, ENTRIES)
    gain = exponent = 0.0
    if settings.light and transfer not in ("hlg", "bt709"):
        raise UserError(f"--light, [capture] light: is for hlg and bt709, and {name} is {transfer}; leave it out")
    if settings.light == "display" and transfer == "bt709":
        transfer = "bt1886"
    if transfer.startswith(OCIO):
        space = probed_space(transfer.removeprefix(OCIO))
        light, rec709_from_light, scale = (
            np.interp(signals, np.linspace(0, 1, len(space.light)), space.light),
            space.rec709_from_light,
            None,
        )
    else:
        curve = TRANSFERS[transfer]
        light, rec709_from_light, scale = (
            curve.light_from_signal(signals),
            rec709_from_primaries(PRIMARIES[primaries]),
            curve.luminance_scale,
        )
    if transfer == "hlg" and settings.light == "display":
        gain = settings.peak or HLG_PEAK
        exponent, scale = hlg_system_gamma(gain) - 1, 1.0
    elif settings.peak:
        raise UserError(f"--peak, [capture] peak: is of an HLG display, and {name} is {transfer} without --light display; leave it out")
    return ColourCoding(range_, matrix, light.astype(np.float32), rec709_from_light, gain, exponent, scale)


def signal_from_codes(coding: ColourCoding, bits: int, is_rgb: bool) -> np.ndarray:
    """(3, 4) float64: signals R', G', B' of three codes and 1. is_rgb: the codes are R, G, B, and not Y, Cb, Cr.

    ITU-R BT.709-6, items 3 and 4; BT.2100-2, table 9, for full range.
    """
    limited, unit, top = coding.range == "limited", 2.0 ** (bits - 8), 2.0**bits - 1
    low, span, chroma_span = (16 * unit, 219 * unit, 224 * unit) if limited else (0.0, top, top)
    if is_rgb or coding.matrix == "rgb":
        rgb = np.column_stack([np.eye(3) / span, np.full(3, -low / span)])
        return rgb if is_rgb else rgb @ np.eye(4)[[2, 0, 1, 3]]  # planes in the order G, B, R (H.273, matrix 0)
    kr, kb = LUMA[coding.matrix]
    kg = 1 - kr - kb
    rgb_from_ycc = np.array([[1, 0, 2 - 2 * kr], [1, -2 * kb * (1 - kb) / kg, -2 * kr * (1 - kr) / kg], [1, 2 - 2 * kb, 0]])
    ycc = np.diag([1 / span, 1 / chroma_span, 1 / chroma_span])
    middle = 2.0 ** (bits - 1)
    return rgb_from_ycc @ np.column_stack([ycc, [-low / span, -middle / chroma_span, -middle / chroma_span]])


def light_of_rgb_codes(coding: ColourCoding, bits: int) -> np.ndarray:
    """Light of each code of R, G or B, (2^bits,) float64."""
    (per_code, *_, offset), *_ = signal_from_codes(coding, bits, is_rgb=True)
    return np.interp(per_code * np.arange(2**bits) + offset, np.linspace(LOWEST, HIGHEST, ENTRIES), coding.table.astype(np.float64))


assert set(get_args(Primaries)) <= set(PRIMARIES)
assert set(get_args(Matrix)) == {*LUMA, "rgb"}
