"""A sequence on disk without a manifest: which files of a folder are its frames, and in which order."""

import itertools
import math
import re
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
    """The images in a `folder` without manifest, in order of their numbers, or of their names where some have none.

    Files of radiance take precedence, then pictures, then raw photographs: a PNG beside radiance is a picture of it, and one beside a .toml
    of its name is that calibration's.
    Names that begin with a dot are no frames: macOS writes such files beside the real ones. Numbers may go up in steps; those that are
    missing between them leave a gap in time, and a notice counts them. Raises UserError when there are no images.
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
    numbered = [(match[1], int(match[2]), p) for p in paths if (match := re.fullmatch(r"(.*?)(\d{1,15})", p.stem))]
    if len(numbered) < len(paths) or len({(prefix, number) for prefix, number, _ in numbered}) < len(paths):
        return [FrameFile(path, k) for k, path in enumerate(paths)]
    if len({prefix for prefix, _, _ in numbered}) > 1:
        return [FrameFile(path, k) for k, path in enumerate(paths)]
    numbered.sort(key=lambda row: row[1])
    numbers = [number for _, number, _ in numbered]
    step = math.gcd(*(number - numbers[0] for number in numbers[1:])) or 1
    files = [FrameFile(path, (number - numbers[0]) // step) for _, number, path in numbered]
    if missing := files[-1].offset + 1 - len(files):
        at = next(before for before, after in itertools.pairwise(files) if after.offset != before.offset + 1)
        frames = "1 frame is missing" if missing == 1 else f"{missing} frames are missing, the first of them"
        notice(f"{folder}: {frames} after {at.path.name}; the others keep their times")
    return files
