"""A recorded sequence on disk: frames in one folder with manifest.jsonl, one JSON object a frame, because EXR has no checksum."""

import hashlib
import io
import itertools
import math
import re
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import decoded_json, notice, read_file
from vemlight.light.image_limits import MAX_IMAGE_BYTES

MANIFEST = "manifest.jsonl"
MAX_MANIFEST_BYTES = 2**26  # 67 MB: 250,000 lines of 250 bytes, 2.8 hours at 25 frames a second
RADIANCE_SUFFIXES = (".exr", ".hdr", ".pic")
CODES_SUFFIX = ".png"


class ManifestEntry(msgspec.Struct, frozen=True):
    """One frame of a recording, as a line of its manifest."""

    name: Annotated[str, Meta(pattern=r"^[^/\\\x00]+$")]  # of the file, in the manifest's own folder
    sequence: Annotated[int, Meta(ge=0)]  # numbers of frames that the recorder had to drop are missing
    time_s: Annotated[float, Meta(ge=-1e12, le=1e12)]  # 30,000 years; only nan, inf and nonsense lie outside
    sha256: Annotated[str, Meta(pattern=r"^[0-9a-f]{64}$")]


def manifest_entry(path: Path, sequence: int, time_s: float) -> ManifestEntry:
    """The manifest's entry for the frame at `path`."""
    return ManifestEntry(path.name, sequence, time_s, hashlib.sha256(path.read_bytes()).hexdigest())


def manifest_line(path: Path, sequence: int, time_s: float) -> bytes:
    """The line of the manifest for the frame at `path`."""
    return msgspec.json.encode(manifest_entry(path, sequence, time_s)) + b"\n"


def read_manifest(folder: Path) -> list[ManifestEntry]:
    """The entries of the manifest in `folder`, in its order. A last line that was cut off while it was written is left out.

    Raises UserError for any other invalid line, and for frames that are missing.
    """
    path = folder / MANIFEST
    entries, lines = [], io.BytesIO(read_file(path, MAX_MANIFEST_BYTES))
    for number, line in enumerate(lines, 1):
        try:
            entries.append(decoded_json(line, ManifestEntry))
        except ValueError as error:
            if not line.endswith(b"\n"):
                break  # the recorder was stopped while writing it
            raise UserError(f"{path}: line {number}: {error}; copy the recording again") from error
    if not entries:
        raise UserError(f"{path}: lists no frames; record again")
    present = {p.name for p in folder.iterdir()}
    for entry in entries:
        if entry.name not in present:
            raise UserError(f"{folder}: frame {entry.name} is missing and in {MANIFEST}; copy the recording again")
    return entries


def check_digest(path: Path, sha256: str) -> None:
    """Raises UserError when the file at `path` is not what was recorded."""
    if hashlib.sha256(read_file(path, MAX_IMAGE_BYTES)).hexdigest() != sha256:
        raise UserError(f"{path}: is not what was recorded (sha256 differs from {MANIFEST}); copy it again")


class FrameFile(NamedTuple):
    """A frame of a folder without manifest. offset: frames after the first, counted by the numbers in the files' names."""

    path: Path
    offset: int


def frame_files(folder: Path) -> list[FrameFile]:
    """The images in a `folder` without manifest, in order of their numbers, or of their names where some have none.

    Files of radiance take precedence: a PNG beside them is a picture of them, and one beside a .toml of its name is that calibration's.
    Names that begin with a dot are no frames: macOS writes such files beside the real ones. Numbers may go up in steps; those that are
    missing between them leave a gap in time, and a notice counts them. Raises UserError when there are no images.
    """
    complete = sorted(p for p in folder.iterdir() if not p.stem.endswith(".part") and not p.name.startswith("."))
    paths = [p for p in complete if p.suffix.lower() in RADIANCE_SUFFIXES]
    if not paths:
        paths = [p for p in complete if p.suffix.lower() == CODES_SUFFIX and not p.with_suffix(".toml").exists()]
    if not paths:
        raise UserError(f"{folder}: holds no {', '.join(RADIANCE_SUFFIXES)} or {CODES_SUFFIX} files; name a folder of frames")
    numbered = [(match[1], int(match[2]), p) for p in paths if (match := re.fullmatch(r"(.*?)(\d+)", p.stem))]
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
