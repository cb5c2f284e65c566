"""The folder that a run writes to: which run it belongs to, what of it is whole, and where the same command goes on.

manifest.jsonl (a journal, services/journal.py) begins with the run's settings and inputs, has a line for each picture once its files are on
the disk, and ends with a line that counts them and names the other files. lights.jsonl is a journal, too.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

import msgspec

from vemlight.errors import UserError
from vemlight.files import decoded_json, notice, sha256_of
from vemlight.journal import JOURNAL_START, FileName, Journal, Sha256, claimed
from vemlight.light.light_set import LightsFile
from vemlight.runtime.progress import counted
from vemlight.runtime.run_inputs import input_digests
from vemlight.settings import Settings
from vemlight.source_names import shown_source

MANIFEST, LIGHTS, CONTACT_SHEET, SNAPSHOTS = "manifest.jsonl", "lights.jsonl", "contact.png", "sampler.snapshot"
ELSEWHERE = ("out", "wire", "viewer")  # settings that change no byte of the output
NEWEST = 64  # pictures whose content a restarted service reads again: more than a crash can harm, and no more in a long run
END = b'{"pictures":'  # the beginning of a manifest's last line
MAX_END_BYTES = 4096  # of a manifest's last line, which has 0.3 kB


class RunStart(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The first line of a manifest: what the output follows from. inputs: a digest of the files behind each path in the settings."""

    run: Literal["vemlight.run/1"] = "vemlight.run/1"
    version: str
    settings: dict[str, Any]
    inputs: dict[str, Sha256]


class WrittenPicture(msgspec.Struct, frozen=True, kw_only=True):
    """A line of a manifest: a picture that is whole on the disk. sha256: of the EXR."""

    name: FileName
    sequence: int
    time_s: float
    sha256: Sha256
    png_sha256: Sha256


class RunEnd(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The last line of a manifest: how many pictures there are, and the digests of the other files."""

    pictures: int
    files: dict[FileName, Sha256]


Picture = TypeVar("Picture", bound=WrittenPicture)


def run_start(settings: Settings) -> RunStart:
    """The first line of the manifest of a run with these settings."""
    try:
        version = metadata.version("vemlight")
    except metadata.PackageNotFoundError:
        version = ""
    return RunStart(version=version, settings=_relevant(settings), inputs=input_digests(settings))


def _relevant(settings: Settings) -> dict[str, Any]:
    shown = msgspec.structs.replace(settings.capture, source=shown_source(settings.capture.source))  # without the password of a stream
    built = msgspec.to_builtins(msgspec.structs.replace(settings, capture=shown))
    return {key: value for key, value in built.items() if key not in ELSEWHERE}


def difference(found: RunStart, wanted: RunStart) -> str:
    """What another run was made with, in a few words; empty where there is no difference."""
    if found.version != wanted.version:
        return f"vemlight is {wanted.version} and was {found.version}"
    before, now = _by_key(found), _by_key(wanted)
    for key, value in now.items():
        if before[key] != value:
            return f"{key} is {value} and was {before[key]}"
    changed = [key for key in wanted.inputs if found.inputs.get(key) != wanted.inputs[key]]
    return f"the files of {changed[0]} have changed since" if changed else ""


def _by_key(start: RunStart) -> dict[str, Any]:
    """All settings, defaults included, by their keys as a person writes them."""
    settings, found = msgspec.convert(start.settings, Settings), {}
    for name in settings.__struct_fields__:
        value = getattr(settings, name)
        if isinstance(value, msgspec.Struct):
            found |= {f"[{name}] {key}": of_section for key, of_section in msgspec.structs.asdict(value).items()}
        else:
            found[name] = value
    return found


class RunManifest(Generic[Picture]):
    """The manifest of an output folder, open for this process alone. `pictures`: those that are whole; `end`: once the run is complete."""

    def __init__(self, folder: Path, wanted: RunStart, kind: type[Picture], newest: int | None = NEWEST) -> None:
        """Opens it, or begins it with `wanted`, and removes what is not whole.

        newest: of how many pictures, counted from the last, the content is read again; None: of all. Raises UserError for the output of a
        run with other settings or inputs, which stays as it is, and OSError when the folder cannot be written.
        """
        self.folder = folder
        self.pictures: list[Picture] = []
        self.end: RunEnd | None = None
        self._journal = Journal(folder / MANIFEST)
        try:
            self._open(wanted, kind, newest)
        except BaseException:
            self._journal.close()
            raise

    def _open(self, wanted: RunStart, kind: type[Picture], newest: int | None) -> None:
        lines = list(self._journal.lines())
        can_be_made_again = wanted.settings.get("mode") == "lossless"
        if not lines:
            self._journal.keep(JOURNAL_START, can_be_made_again)
            self._journal.append(msgspec.json.encode(wanted))
            return
        self._check_start(lines[0][0], wanted)
        points = [lines[0][1], *(point for _, point in lines[1:])]
        for content, _ in lines[1:]:
            self._take(content, kind)
        whole = self._whole(newest) if can_be_made_again else len(self.pictures)
        if whole < len(self.pictures) or not self._others_whole():
            self.end = None
        point = points[-1] if self.end else points[whole]
        removed = self._journal.keep(point, can_be_made_again)
        if whole < len(self.pictures):
            notice(f"{self.folder / self.pictures[whole].name}: is gone or was changed; going on from picture {whole}")
        elif removed > 1:
            notice(f"{self.folder / MANIFEST}: line {point.lines + 1} is damaged; going on from picture {whole}")
        del self.pictures[whole:]

    def _take(self, content: bytes, kind: type[Picture]) -> None:
        try:
            if content.startswith(END):
                self.end = decoded_json(content, RunEnd)
            else:
                self.pictures.append(decoded_json(content, kind))
        except ValueError as error:
            raise UserError(f"{self.folder / MANIFEST}: is no manifest of a run ({error}); choose another --out") from error

    def _check_start(self, line: bytes, wanted: RunStart) -> None:
        hint = "choose another --out, or --overwrite to replace it"
        try:
            found = decoded_json(line, RunStart)
            msgspec.convert(found.settings, Settings)
        except ValueError as error:
            raise UserError(f"{self.folder / MANIFEST}: is no manifest of a run ({error}); choose another --out") from error
        if differs := difference(found, wanted):
            raise UserError(f"{self.folder}: holds the output of another run: {differs}; {hint}")

    def _whole(self, newest: int | None) -> int:
        """How many pictures, from the first, have their files."""
        present = {entry.name for entry in os.scandir(self.folder)}
        first_read = 0 if newest is None else len(self.pictures) - newest
        shown = self.pictures if newest else counted(self.pictures, "pictures", len(self.pictures))
        for k, picture in enumerate(shown):
            png = Path(picture.name).with_suffix(".png").name
            if not {picture.name, png} <= present:
                return k
            if k >= first_read and (picture.sha256, picture.png_sha256) != self.digests(picture.name):
                return k
        return len(self.pictures)

    def digests(self, name: str) -> tuple[str, str]:
        """Of a picture's EXR and PNG. Raises OSError where they cannot be read."""
        exr = self.folder / name
        return sha256_of(exr), sha256_of(exr.with_suffix(".png"))

    def _others_whole(self) -> bool:
        files = self.end.files if self.end else {}
        return all((self.folder / name).is_file() and sha256_of(self.folder / name) == digest for name, digest in files.items())

    def add(self, picture: Picture) -> None:
        """Adds a picture whose files are on the disk. Raises OSError when the disk refuses."""
        self._journal.append(msgspec.json.encode(picture))
        self.pictures.append(picture)

    def complete(self) -> None:
        """Writes the last line, with what lies beside the pictures, and removes what only an unfinished run needs."""
        if self.end is None:
            files = {name: sha256_of(self.folder / name) for name in (LIGHTS, CONTACT_SHEET) if (self.folder / name).is_file()}
            end = RunEnd(pictures=len(self.pictures), files=files)
            self._journal.append(msgspec.json.encode(end))
            self.end = end
        (self.folder / SNAPSHOTS).unlink(missing_ok=True)
        _remove_parts(self.folder)

    def close(self) -> None:
        self._journal.close()


def is_complete(out: Path) -> bool:
    """Whether the manifest there has its last line. That the files are whole is not looked at."""
    with open(out / MANIFEST, "rb") as file:
        file.seek(max(0, os.fstat(file.fileno()).st_size - MAX_END_BYTES))
        return b"\n" + END in file.read()


@contextmanager
def claimed_output(settings: Settings, overwrite: bool) -> Iterator[bool]:
    """Makes the output folder ready for a run, and keeps other runs out of it meanwhile. Yields whether it is complete already.

    What an unfinished run with the same settings and inputs has left there is checked and kept; a line says so. Raises UserError for a
    folder that cannot be written, is in use, or holds something else, unless `overwrite` allows to remove what runs write.
    """
    out = Path(settings.out)
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = os.open(out, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise UserError(f"{out}: cannot be written to ({error.strerror}); choose another --out") from error
    try:
        if not claimed(lock):
            raise UserError(f"{out}: another run writes there; wait for its end, or choose another --out")
        try:
            if overwrite:
                _clear(out)
            is_complete = _checked(out, settings)
        except OSError as error:
            raise UserError(f"{error.filename or out}: cannot be written to ({error.strerror}); choose another --out") from error
        yield is_complete
    finally:
        os.close(lock)


def _checked(out: Path, settings: Settings) -> bool:
    """Checks and begins or continues the manifest and the lights; whether they are complete."""
    strangers = sorted(path.name for path in _outputs(out)) if not (out / MANIFEST).exists() else []
    if strangers:
        raise UserError(f"{out}: has {strangers[0]} without {MANIFEST}; choose another --out, or --overwrite to replace it")
    manifest = RunManifest(out, run_start(settings), WrittenPicture, newest=None)
    manifest.close()
    lossless, pictures = settings.mode == "lossless", len(manifest.pictures)
    lights = LightsFile(out / LIGHTS, can_be_made_again=lossless)
    lights.close()
    _remove_parts(out)
    if not lossless and (pictures or lights.count):
        raise UserError(f"{out}: holds the output of a live run, which cannot be continued; choose another --out, or --overwrite")
    if manifest.end:
        (out / SNAPSHOTS).unlink(missing_ok=True)
        notice(f"{out}: is complete: {pictures} pictures and their lights; --overwrite makes them again")
    elif pictures or lights.count:
        notice(f"{out}: the same run began here; going on from picture {pictures}")
    return manifest.end is not None


def _remove_parts(out: Path) -> None:
    """Removes half-written files, whose writer was killed (vemlight.files.written_whole)."""
    for pattern in ("frame_[0-9]*.part.exr", "frame_[0-9]*.part.png", "contact.part.png", "sampler.part.snapshot"):
        for path in out.glob(pattern):
            path.unlink()


def _outputs(out: Path) -> list[Path]:
    """What runs of ours write, as far as it is there."""
    named = [out / name for name in (LIGHTS, MANIFEST, CONTACT_SHEET, SNAPSHOTS) if (out / name).is_file()]
    return [*named, *out.glob("frame_[0-9]*.exr"), *out.glob("frame_[0-9]*.png")]


def _clear(out: Path) -> None:
    for path in _outputs(out):
        path.unlink()
