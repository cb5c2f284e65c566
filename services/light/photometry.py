"""Far-field photometry from files: EULUMDAT (.ldt) and IES LM-63 (.ies)."""

import codecs
import re
from pathlib import Path

import numpy as np

from vemlight.errors import UserError
from vemlight.files import notice, read_file
from vemlight.light.eulumdat import read_eulumdat
from vemlight.light.far_field import FarField
from vemlight.light.lm63 import read_lm63

PHOTOMETRY_SUFFIXES = (".ldt", ".ies")
MAX_BYTES = 2**22  # 721 x 361 angles of 12 characters have 3 MB; the numbers take ten times as much in memory
MAX_CANDELA = 1e12  # a lighthouse has 10^7; products with it stay finite in float32
MAX_NEGATIVE = 0.01  # of the largest intensity: noise around 0, set to 0 with a word; more is another fault. Any value in 1e-3 .. 0.1 does
END_OF_FILE = "\x1a"  # Ctrl-Z of DOS


def read_photometry(path: Path, lamp_set: int = 0) -> FarField:
    """The far field in a .ldt or .ies file. lamp_set: of a .ldt with several, from 1; 0: the first, and a notice says so.

    Raises UserError, naming file and fault, for anything else.
    """
    text = _text(read_file(path, MAX_BYTES))
    suffix = path.suffix.lower()
    if suffix not in PHOTOMETRY_SUFFIXES:
        raise UserError(f"{path}: photometry is read from .ldt and .ies; convert it")
    if lamp_set and suffix != ".ldt":
        raise UserError(f"{path}: lamp_set chooses among the lamps of a .ldt file; leave it out")
    try:
        with np.errstate(all="ignore"):  # of numbers so large that what they make is inf or nan
            far, notes = read_eulumdat(text, lamp_set) if suffix == ".ldt" else read_lm63(text)
    except (ValueError, IndexError, OverflowError) as error:
        raise UserError(f"{path}: is no valid photometry ({' '.join(str(error).split())[:160]}); export it again") from error
    brightest, darkest = far.candela.max(), far.candela.min()
    if not (darkest >= -MAX_NEGATIVE * brightest and brightest <= MAX_CANDELA and np.all(np.isfinite(far.size_m)) and min(far.size_m) >= 0):
        raise UserError(f"{path}: has intensities or dimensions that are negative, nan, inf or above {MAX_CANDELA:.0e} cd; export it again")
    if brightest <= 0:
        raise UserError(f"{path}: has no intensity above 0 cd; export it again")
    if darkest < 0:
        notes.append(f"has intensities down to {darkest:.3g} cd, which are taken as 0")
    for line in notes:
        notice(f"{path}: {line}")
    return far._replace(candela=np.maximum(far.candela, 0), name=far.name or path.stem)


def _text(data: bytes) -> str:
    """A file's text with lines ended by \\n: of DOS, Unix or the old Mac, up to DOS's end of file, in UTF-8, Latin-1 or UTF-16."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = data.decode("utf-16", "replace")
    else:
        data = data.removeprefix(codecs.BOM_UTF8)
        try:
            text = data.decode()
        except UnicodeDecodeError:
            text = data.decode("latin-1")
    return re.sub(r"\r+\n|\r", "\n", text.partition(END_OF_FILE)[0]).rstrip("\0")
