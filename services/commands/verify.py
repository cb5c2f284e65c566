"""`vemlight verify`: whether a recording or a run's output is what was written, file by file and line by line."""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from vemlight.capture.manifest import parsed_manifest
from vemlight.errors import UserError, printable_line
from vemlight.files import decoded_json, sha256_of
from vemlight.journal import checked_lines
from vemlight.runtime.output_folder import END, LIGHTS, MANIFEST, RunEnd, RunStart, WrittenPicture
from vemlight.runtime.progress import counted

RUN = b'{"run":'  # the beginning of the manifest of a run's output; all others are of recordings


class Verified(NamedTuple):
    """findings: a line for each thing that is not as it was written. summary: what was looked at."""

    findings: list[str]
    summary: str


def verify(folder: Path) -> Verified:
    """Compares every file that the manifest in `folder` names, and the manifest with itself. Raises UserError where there is none."""
    path = folder / MANIFEST
    try:
        with open(path, "rb") as file:
            is_run = file.read(len(RUN)) == RUN
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); name the folder of a recording or of a run's output") from error
    return _verified_run(folder) if is_run else _verified_recording(folder)


def _verified_recording(folder: Path) -> Verified:
    manifest = parsed_manifest(folder)
    calibration = manifest.start.files if manifest.start else {}
    beside = {**calibration, **(manifest.end.files if manifest.end else {})}
    frames = {entry.name: entry.sha256 for entry in manifest.entries}
    findings = list(_changed(folder, {**frames, **beside}))
    count = len(manifest.entries)
    if manifest.damaged_line:
        findings.append(f"{folder / MANIFEST}: line {manifest.damaged_line} is damaged ({manifest.reason}); {count} frames are before it")
    elif manifest.start and not manifest.end:
        findings.append(f"{folder}: is incomplete: the recording was cut off after {count} frames, or still goes on")
    elif manifest.end and manifest.end.frames != count:
        findings.append(f"{folder / MANIFEST}: lists {count} frames and counts {manifest.end.frames}")
    if not manifest.entries:
        findings.append(f"{folder / MANIFEST}: lists no frames")
    summary = f"{count} frames{''.join(f', {name}' for name in beside)}"
    if not manifest.start:
        summary += "; their manifest has no chain, and lines that were changed or removed do not show"
    return Verified(findings, summary)


def _verified_run(folder: Path) -> Verified:
    path = folder / MANIFEST
    pictures: list[WrittenPicture] = []
    end: RunEnd | None = None
    offset = lines = 0
    with open(path, "rb") as file:
        for content, point in checked_lines(file):
            try:
                if lines == 0:
                    decoded_json(content, RunStart)
                elif content.startswith(END):
                    end = decoded_json(content, RunEnd)
                else:
                    pictures.append(decoded_json(content, WrittenPicture))
            except ValueError:
                break
            offset, lines = point.offset, point.lines
    digests = {picture.name: picture.sha256 for picture in pictures}
    digests |= {Path(picture.name).with_suffix(".png").name: picture.png_sha256 for picture in pictures}
    findings = list(_changed(folder, digests | (end.files if end else {})))
    if path.stat().st_size > offset:
        findings.append(f"{path}: line {lines + 1} is damaged; {len(pictures)} pictures are before it")
    elif not end:
        findings.append(f"{folder}: is incomplete: {len(pictures)} pictures; the command that wrote it goes on from there")
    if end and end.pictures != len(pictures):
        findings.append(f"{path}: lists {len(pictures)} pictures and counts {end.pictures}")
    findings += _changed_lights(folder / LIGHTS)
    return Verified(findings, f"{len(pictures)} pictures, their lights and what belongs to them")


def _changed_lights(path: Path) -> Iterator[str]:
    """The lights have a chain of their own, which is there before the run is complete."""
    if path.is_file():
        with open(path, "rb") as file:
            point = deque((point for _, point in checked_lines(file)), maxlen=1)
        lines, offset = point[0][:2] if point else (0, 0)
        if path.stat().st_size > offset:
            yield f"{path}: line {lines + 1} is damaged"


def _changed(folder: Path, digests: Mapping[str, str]) -> Iterable[str]:
    for name, sha256 in counted(list(digests.items()), "files", len(digests)):
        try:
            if sha256_of(folder / name) != sha256:
                yield printable_line(f"{folder / name}: is not what was written (its SHA-256 differs)")
        except OSError as error:
            yield printable_line(f"{folder / name}: cannot be read ({error.strerror})")
