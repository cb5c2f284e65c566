"""A recorded sequence on disk: frames in one folder with manifest.jsonl, one JSON object a frame, because EXR has no checksum."""

import hashlib
import itertools
import re
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from vemlight.errors import UserError

MANIFEST = "manifest.jsonl"
SUFFIXES = (".exr", ".hdr", ".pic")
PNG = ".png"  # raw codes


class Entry(msgspec.Struct, frozen=True):
    """One frame of a recording, as a line of its manifest."""

    name: Annotated[str, Meta(pattern=r"^[^/\\\x00]+$")]  # of the file, in the manifest's own folder
    sequence: Annotated[int, Meta(ge=0)]  # what the recorder had to drop is missing here
    time_s: Annotated[float, Meta(ge=-1e12, le=1e12)]
    sha256: Annotated[str, Meta(pattern=r"^[0-9a-f]{64}$")]


def file_entry(path: Path, sequence: int, time_s: float) -> Entry:
    """The manifest's entry for the frame at `path`."""
    return Entry(path.name, sequence, time_s, hashlib.sha256(path.read_bytes()).hexdigest())


def read_manifest(folder: Path) -> list[Entry]:
    """The entries of the manifest in `folder`, in its order. Raises UserError for a line that is none and for frames that are gone."""
    path = folder / MANIFEST
    entries, lines = [], path.read_bytes().splitlines(keepends=True)
    for number, line in enumerate(lines, 1):
        try:
            entries.append(msgspec.json.decode(line, type=Entry))
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            if number == len(lines) and not line.endswith(b"\n"):
                break  # it was being written when the power went
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
    if hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
        raise UserError(f"{path}: is not what was recorded (sha256 differs from {MANIFEST}); copy it again")


def frame_paths(folder: Path) -> list[Path]:
    """The images in a `folder` without manifest, in order.

    Raises UserError when there are none, or when numbered files leave a number out.
    """
    whole = sorted(p for p in folder.iterdir() if not p.stem.endswith(".part"))
    paths = [p for p in whole if p.suffix.lower() in SUFFIXES]
    if not paths:  # pictures beside frames of radiance are for the eye, and so are those of a calibration beside its file
        paths = [p for p in whole if p.suffix.lower() == PNG and not p.with_suffix(".toml").exists()]
    if not paths:
        raise UserError(f"{folder}: holds no {', '.join(SUFFIXES)} or {PNG} files; name a folder of frames")
    numbered = [(match[1], match[2], p) for p in paths if (match := re.fullmatch(r"(.*?)(\d+)", p.stem))]
    if len(numbered) < len(paths) or len({prefix for prefix, _, _ in numbered}) > 1:
        return paths
    numbered.sort(key=lambda row: int(row[1]))
    for (_, digits, path), (_, after, _) in itertools.pairwise(numbered):
        if int(after) != int(digits) + 1:
            missing = f"{int(digits) + 1:0{len(digits)}d}"
            raise UserError(f"{folder}: frame {missing} is missing after {path.name}; copy it again or renumber the rest")
    return [path for _, _, path in numbered]
