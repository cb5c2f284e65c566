"""What an archive follows from, `plan.json`: the frames' names, all options, the version. The same plan means the same bytes of lights."""

import hashlib
import os
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from vemlight.capture.source import FilesOfFrames
from vemlight.errors import UserError
from vemlight.files import checked_utf8, decoded_json, fsync_folder, read_file, sha256_of
from vemlight.journal import Sha256
from vemlight.settings import Capture, Sampler

PLAN = "plan.json"
MAX_PLAN_BYTES = 2**20  # they have 3 kB
CHUNK_BYTES = 32_000_000  # of maps: 82 of 90 x 360, so that 17 chunks in flight are half a gigabyte of disk
WAY_OUT = "choose another --out, or remove that folder"


class ArchivePlan(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """names: digest of the names of the frames' files, in order. calibration: of the content of each lens and response file."""

    archive: Literal["vemlight.archive/1"] = "vemlight.archive/1"
    version: str
    frames: Annotated[int, Meta(ge=1)]
    chunk_frames: Annotated[int, Meta(ge=1)]
    capture: dict[str, Any]
    sampler: dict[str, Any]
    names: Sha256
    calibration: dict[str, Sha256]

    @property
    def chunks(self) -> int:
        return -(-self.frames // self.chunk_frames)

    def frames_of(self, chunk: int) -> range:
        """The numbers of a chunk's frames."""
        return range(chunk * self.chunk_frames, min((chunk + 1) * self.chunk_frames, self.frames))

    def digest(self) -> str:
        return hashlib.sha256(plan_json(self)).hexdigest()

    def capture_settings(self) -> Capture:
        return msgspec.convert(self.capture, Capture)

    def sampler_settings(self) -> Sampler:
        return msgspec.convert(self.sampler, Sampler)


def plan_json(plan: ArchivePlan) -> bytes:
    """The bytes of the file, the same for the same plan."""
    return msgspec.json.format(msgspec.json.encode(plan, order="deterministic")) + b"\n"


def new_plan(source: FilesOfFrames, capture: Capture, sampling: Sampler, chunk_frames: int) -> ArchivePlan:
    """The plan of an archive of all frames of a source.

    Raises OSError for a calibration that cannot be read, UserError for a name of the source or of a calibration that is not UTF-8.
    """
    names = hashlib.sha256()
    for k in range(len(source)):
        names.update("\0".join(path.name for path in source.paths(k)).encode(errors="surrogateescape") + b"\n")
    try:
        version = metadata.version("vemlight")
    except metadata.PackageNotFoundError:
        version = ""
    return ArchivePlan(
        version=version, frames=len(source), chunk_frames=chunk_frames, capture=_in_json(capture), sampler=_in_json(sampling),
        names=names.hexdigest(),
        calibration={str(path): sha256_of(path) for path in source.calibration},
    )  # fmt: skip


def _in_json(section: msgspec.Struct) -> dict[str, Any]:
    """All its values, defaults too, as they come back from a file: lists for tuples. Raises UserError for a name that JSON cannot hold."""
    return msgspec.json.decode(checked_utf8(msgspec.structs.asdict(section), PLAN))


def files_digest(source: FilesOfFrames, frames: range) -> str:
    """Of the names, sizes and times of the files of some frames; their content would take too long. Raises OSError for one that is gone."""
    digest = hashlib.sha256()
    for path in dict.fromkeys(path for k in frames for path in source.paths(k)):
        status = path.stat()
        digest.update(f"{path.name}\0{status.st_size}\0{status.st_mtime_ns}\n".encode(errors="surrogateescape"))
    return digest.hexdigest()


def difference(found: ArchivePlan, wanted: ArchivePlan) -> str:
    """What another archive was made with, in a few words; empty where there is no difference."""
    for name, of in (("vemlight", "version"), ("the number of frames", "frames"), ("--chunk", "chunk_frames")):
        if getattr(found, of) != getattr(wanted, of):
            return f"{name} is {getattr(wanted, of)} and was {getattr(found, of)}"
    for section in ("capture", "sampler"):
        before, now = getattr(found, section), getattr(wanted, section)
        for key in dict.fromkeys((*now, *before)):
            if before.get(key) != now.get(key):
                return f"[{section}] {key} is {now.get(key)} and was {before.get(key)}"
    if found.names != wanted.names:
        return "the names of its frames have changed since"
    changed = [path for path in {**wanted.calibration, **found.calibration} if found.calibration.get(path) != wanted.calibration.get(path)]
    return f"{changed[0]} has changed since" if changed else ""


def found_plan(folder: Path) -> ArchivePlan | None:
    """The plan in a folder, None where there is none. Raises UserError for a file that is no plan."""
    path = folder / PLAN
    if not os.path.lexists(path):
        return None
    try:
        plan = decoded_json(read_file(path, MAX_PLAN_BYTES), ArchivePlan)
        for section in (plan.capture_settings, plan.sampler_settings):
            section()
        return plan
    except UserError:
        raise
    except ValueError as error:
        raise UserError(f"{path}: is no plan of an archive; {WAY_OUT}") from error


def keep_plan(folder: Path, wanted: ArchivePlan) -> None:
    """Writes the plan where there is none, whoever else does the same at the same time. Raises UserError where there is another one."""
    if found_plan(folder) is None:
        handle, name = tempfile.mkstemp(prefix=f"{PLAN}.", suffix=".part", dir=folder)
        try:
            with open(handle, "wb") as file:
                file.write(plan_json(wanted))
                file.flush()
                os.fchmod(handle, 0o644)
                os.fsync(handle)
            _link(name, folder / PLAN)
        finally:
            Path(name).unlink(missing_ok=True)
        fsync_folder(folder)
    found = found_plan(folder)
    if found is None:
        raise UserError(f"{folder / PLAN}: was removed meanwhile; {WAY_OUT}")
    if differs := difference(found, wanted):
        raise UserError(f"{folder}: holds another archive: {differs}; {WAY_OUT}")


def _link(name: str, path: Path) -> None:
    """Gives a whole file its name unless another one has it."""
    try:
        os.link(name, path)
    except FileExistsError:
        pass
    except OSError:  # a file system without links: the last of several who come at once wins, and the others see it behind this
        os.replace(name, path)
