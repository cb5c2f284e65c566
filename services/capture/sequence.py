"""A sequence on disk without a manifest: which files of a folder are its frames, and in which order."""

import itertools
import math
import re
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.light.raw_photograph import RAW_SUFFIXES

RADIANCE_SUFFIXES = (".exr", ".hdr", ".pic", ".pfm")
STILL_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")


class FrameFile(NamedTuple):
    """A frame of a folder without manifest. offset: frames after the first, counted by the numbers in the files' names."""

    path: Path
    offset: int


def frame_files(folder: Path) -> list[FrameFile]:
    """The images in a `folder` without manifest, in order of their numbers, or of their names where those are not numbers of one sequence.

    Files of radiance take precedence, then pictures, then raw photographs: a PNG beside radiance is a picture of it, and one beside a .toml
    of its name is that calibration's. Names that begin with a dot are no frames: macOS writes such files beside the real ones. Numbers may
    go up in steps; those that are missing between them leave a gap in time. A notice tells of steps, of gaps, and of other names. Raises
    UserError when there are no images, and for frames that are there twice.
    """
    complete = sorted(p for p in folder.iterdir() if not p.stem.endswith(".part") and not p.name.startswith("."))
    paths = [p for p in complete if p.suffix.lower() in RADIANCE_SUFFIXES]
    if not paths:
        paths = [p for p in complete if p.suffix.lower() in STILL_SUFFIXES and not p.with_suffix(".toml").exists()]
    if not paths:
        paths = [p for p in complete if p.suffix.lower() in RAW_SUFFIXES]
    if not paths:
        suffixes = ", ".join((*RADIANCE_SUFFIXES, *STILL_SUFFIXES, *RAW_SUFFIXES))
        raise UserError(f"{folder}: holds none of {suffixes}; name a folder of frames, or a film")
    (stem, times), *_ = Counter(path.stem for path in paths).most_common(1)
    if times > 1:
        kinds = ", ".join(sorted({path.suffix for path in paths}))
        raise UserError(f"{folder}: holds {stem} more than once ({kinds}); keep the frames of one kind")
    numbers = _numbers([path.stem for path in paths])
    if numbers is None:
        notice(f"{folder}: its names are not numbers of one sequence; its {len(paths)} frames come in the order of the names")
        return [FrameFile(path, k) for k, path in enumerate(paths)]
    numbered = sorted(zip(numbers, paths, strict=True))
    first = numbered[0][0]
    step = math.gcd(*(number - first for number, _ in numbered)) or 1
    files = [FrameFile(path, (number - first) // step) for number, path in numbered]
    if step > 1:
        notice(f"{folder}: its numbers go up by {step}; its {len(files)} frames follow each other at the rate of the sequence")
    if missing := files[-1].offset + 1 - len(files):
        at = next(before for before, after in itertools.pairwise(files) if after.offset != before.offset + 1)
        frames = "1 frame is missing" if missing == 1 else f"{missing} frames are missing, the first of them"
        notice(f"{folder}: {frames} after {at.path.name}; the others keep their times")
    return files


def _numbers(stems: list[str]) -> list[int] | None:
    """The number of each of a sequence's names: the digits in which alone they differ.

    None where names differ in letters, in several numbers or in none.
    """
    parts = [re.split(r"(\d{1,15})", stem) for stem in stems]
    if len({tuple(part[::2]) for part in parts}) > 1:
        return None
    values = list(zip(*([int(digits) for digits in part[1::2]] for part in parts), strict=True))
    if len(stems) == 1:
        return list(values[-1]) if values else [0]
    varying = [column for column in values if len(set(column)) > 1]
    return list(varying[0]) if len(varying) == 1 and len(set(varying[0])) == len(stems) else None
