"""The manifest of a recording: manifest.jsonl beside the frames, because EXR has no checksum.

A journal (services/journal.py): the first line names the calibration, then one line a frame, and the last counts them. A recording whose
last line is missing was cut off. Manifests of other programs and of earlier versions have lines of frames only, without chain.
"""

import hashlib
import io
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import decoded_json, notice, read_file, sha256_of
from vemlight.journal import JOURNAL_START, KEY, FileName, Journal, Sha256, checked_lines
from vemlight.light.image_limits import MAX_IMAGE_BYTES

MANIFEST = "manifest.jsonl"
MAX_MANIFEST_BYTES = 2**27  # 134 MB: 400,000 lines of 330 bytes, 4.4 hours at 25 frames a second
MARK = b'{"recording":'  # the beginning of a manifest with chain


class RecordingStart(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The first line: lens and response files."""

    recording: Literal["vemlight.recording/1"] = "vemlight.recording/1"
    files: dict[FileName, Sha256]


class ManifestEntry(msgspec.Struct, frozen=True):
    """One frame of a recording."""

    name: FileName
    sequence: Annotated[int, Meta(ge=0)]  # numbers of frames that the recorder had to drop are missing
    time_s: Annotated[float, Meta(ge=-1e12, le=1e12)]  # 30,000 years; only nan, inf and nonsense lie outside
    sha256: Sha256


class RecordingEnd(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The last line: how many frames there are, and what else was written beside them."""

    frames: Annotated[int, Meta(ge=0)]
    files: dict[FileName, Sha256] = {}


class RecordingManifest(NamedTuple):
    """What a manifest says.

    start: None where there is no chain. end: None where the recording was cut off. damaged_line: the first, from 1, if there is any.
    """

    start: RecordingStart | None
    entries: list[ManifestEntry]
    end: RecordingEnd | None
    damaged_line: int | None
    reason: str = ""


def manifest_entry(path: Path, sequence: int, time_s: float) -> ManifestEntry:
    """The manifest's entry for the frame at `path`."""
    return ManifestEntry(path.name, sequence, time_s, sha256_of(path))


class ManifestWriter:
    """Writes the manifest of a new recording. Each line is on the disk when its call returns; OSError when the disk refuses."""

    def __init__(self, folder: Path, calibration: list[Path]) -> None:
        """calibration: lens and response files in the folder."""
        self._folder, self._frames = folder, 0
        self._journal = Journal(folder / MANIFEST)
        self._journal.keep(JOURNAL_START, can_be_made_again=False)
        self._journal.append(msgspec.json.encode(RecordingStart(files={path.name: sha256_of(path) for path in calibration})))

    def add(self, path: Path, sequence: int, time_s: float) -> None:
        """Adds a frame, whose file is on the disk."""
        self._journal.append(msgspec.json.encode(manifest_entry(path, sequence, time_s)))
        self._frames += 1

    def close(self, beside: tuple[Path, ...] = ()) -> None:
        """Writes the last line. beside: other files of the folder that belong to the recording."""
        files = {path.name: sha256_of(path) for path in beside}
        try:
            self._journal.append(msgspec.json.encode(RecordingEnd(frames=self._frames, files=files)))
        finally:
            self._journal.close()


def parsed_manifest(folder: Path) -> RecordingManifest:
    """What the manifest of a recording says, up to the first line that is damaged. Raises UserError when there is none that can be read."""
    data = read_file(folder / MANIFEST, MAX_MANIFEST_BYTES)
    return _chained_manifest(data) if data.startswith(MARK) or KEY in data else _plain_manifest(data)


def _plain_manifest(data: bytes) -> RecordingManifest:
    entries: list[ManifestEntry] = []
    for number, line in enumerate(io.BytesIO(data), 1):
        try:
            entries.append(decoded_json(line, ManifestEntry))
        except ValueError as error:
            return RecordingManifest(None, entries, None, number, str(error))
    return RecordingManifest(None, entries, None, None)


def _chained_manifest(data: bytes) -> RecordingManifest:
    start: RecordingStart | None = None
    entries: list[ManifestEntry] = []
    end: RecordingEnd | None = None
    point = JOURNAL_START
    for content, behind in checked_lines(io.BytesIO(data)):
        try:
            if start is None:
                start = decoded_json(content, RecordingStart)
            elif content.startswith(b'{"frames":'):
                end = decoded_json(content, RecordingEnd)
            else:
                entries.append(decoded_json(content, ManifestEntry))
        except ValueError as error:
            return RecordingManifest(start, entries, None, point.lines + 1, str(error))
        point = behind
    damaged = point.lines + 1 if len(data) > point.offset else None
    return RecordingManifest(start, entries, end if damaged is None else None, damaged, "it is not what was written")


def read_manifest(folder: Path) -> list[ManifestEntry]:
    """The entries of the manifest in `folder`, in its order.

    Of a recording that was cut off, a notice says so and a last line that is not whole is left out. Raises UserError for any other line
    that is damaged, and for frames that are missing.
    """
    path, manifest = folder / MANIFEST, parsed_manifest(folder)
    data = read_file(path, MAX_MANIFEST_BYTES) if manifest.damaged_line else b""
    if manifest.damaged_line and (manifest.damaged_line <= data.count(b"\n") or data.endswith(b"\n")):
        raise UserError(f"{path}: line {manifest.damaged_line}: {manifest.reason}; copy the recording again")
    if not manifest.entries:
        raise UserError(f"{path}: lists no frames; record again")
    if manifest.start and not manifest.end:
        notice(f"{folder}: the recording was cut off; its {len(manifest.entries)} frames are played")
    present = {p.name for p in folder.iterdir()}
    for entry in manifest.entries:
        if entry.name not in present:
            raise UserError(f"{folder}: frame {entry.name} is missing and in {MANIFEST}; copy the recording again")
    return manifest.entries


def check_digest(path: Path, sha256: str) -> None:
    """Raises UserError when the file at `path` is not what was recorded."""
    if hashlib.sha256(read_file(path, MAX_IMAGE_BYTES)).hexdigest() != sha256:
        raise UserError(f"{path}: is not what was recorded (sha256 differs from {MANIFEST}); copy it again")
