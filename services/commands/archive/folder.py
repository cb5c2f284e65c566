"""The folder of an archive: what of it is done, and how a chunk is added so that a killed archive goes on behind the last whole one.

Of chunk N, `maps_NNNNNN` comes first, then `lights_NNNNNN.jsonl`, then `state_NNNNNN`, the state after it, of which the newest two stay. A
chunk counts with the last two. In the end `lights.jsonl` is all of them, `lights.sha256` its digest as `sha256sum -c` reads it.
"""

import fcntl
import hashlib
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import msgspec

from vemlight.commands.archive.map_file import MapReader
from vemlight.commands.archive.plan import PLAN, WAY_OUT, ArchivePlan, keep_plan
from vemlight.commands.lighting import LightingState, first_state
from vemlight.errors import UserError
from vemlight.files import notice, open_regular, read_file, sha256_of, writing_to, written_whole
from vemlight.journal import claimed
from vemlight.sampler.snapshot import decoded, encoded

LIGHTS, DIGEST = "lights.jsonl", "lights.sha256"
OURS = re.compile(r"(maps|state)_\d{6,}|lights_\d{6,}\.jsonl|lights\.jsonl|lights\.sha256")
PARTS = re.compile(r"(maps_\d{6,}\.[\w-]+|state_\d{6,}|plan\.json\.\w+)\.part|lights(_\d{6,})?\.part\.jsonl|lights\.part\.sha256")
STATES = 2  # the newest is enough; the one before is for a disk that lost it
MAX_STATE_BYTES = 2**28  # they have 0.3 MB, and 32 bytes for each chunk before
COPY_BYTES = 2**20


class ArchiveState(msgspec.Struct, frozen=True, array_like=True):
    """After a chunk. lights: digest of the lights of each chunk up to it. files: of the source files of each."""

    plan: str
    lights: tuple[bytes, ...]
    files: tuple[str, ...]
    lighting: LightingState

    @property
    def chunks(self) -> int:
        return len(self.lights)


class ArchiveFolder:
    """An archive that this process writes, from chunk `state.chunks` on."""

    def __init__(self, folder: Path, plan: ArchivePlan) -> None:
        self.path, self._plan, self.plan_digest = folder, plan, plan.digest()
        self.state = ArchiveState(self.plan_digest, (), (), first_state())

    def maps(self, chunk: int) -> Path:
        return self.path / f"maps_{chunk:06d}"

    def lights(self, chunk: int) -> Path:
        return self.path / f"lights_{chunk:06d}.jsonl"

    def _state(self, chunk: int) -> Path:
        return self.path / f"state_{chunk:06d}"

    def is_complete(self) -> bool:
        """Whether all lights are there. Raises UserError for a file that was changed since."""
        try:
            written = (self.path / DIGEST).read_text()
        except (OSError, ValueError):
            return False
        if not (self.path / LIGHTS).is_file() or written != f"{sha256_of(self.path / LIGHTS)}  {LIGHTS}\n":
            raise UserError(f"{self.path / LIGHTS}: is gone or was changed since it was complete; {WAY_OUT}")
        return True

    def resume(self, files: Callable[[int], str]) -> None:
        """Goes on behind the last chunk that is whole. files: gives the digest of a chunk's source files.

        Raises UserError where files have changed of which lights were made.
        """
        chunks = sorted((int(path.name[6:]) for path in self.path.glob("state_[0-9]*") if path.name[6:].isdecimal()), reverse=True)
        for chunk in chunks:
            state = self._read_state(chunk)
            if state is None:
                continue
            changed = next((k for k, digest in enumerate(state.files) if files(k) != digest), None)
            if changed is not None:
                frames = self._plan.frames_of(changed)
                raise UserError(f"{self.path}: frames {frames[0]} to {frames[-1]} were changed since their lights were made; {WAY_OUT}")
            lost = next((k for k, digest in enumerate(state.lights) if not self._holds(k, digest)), None)
            if lost is None:
                self.state = state
                break
            notice(f"{self.lights(lost)}: is gone or was changed; going on from the first frame")
            break
        for path in self._later():
            path.unlink()
        if self.state.chunks:
            notice(f"{self.path}: going on from chunk {self.state.chunks} of {self._plan.chunks}")

    def _read_state(self, chunk: int) -> ArchiveState | None:
        """The state after a chunk, None where it is damaged or of another plan."""
        path = self._state(chunk)
        try:
            state = decoded(read_file(path, MAX_STATE_BYTES), ArchiveState)
        except ValueError:
            return None
        is_its = state.plan == self.plan_digest and state.chunks == len(state.files) == chunk + 1 <= self._plan.chunks
        return state if is_its else None

    def _holds(self, chunk: int, digest: bytes) -> bool:
        try:
            with open_regular(self.lights(chunk)) as file:
                return hashlib.file_digest(file, "sha256").digest() == digest
        except OSError:
            return False

    def _later(self) -> list[Path]:
        """Files of ours that count no more: behind the last whole chunk, maps and states of those that are done, and half files."""
        done, found = self.state.chunks, []
        for path in self.path.iterdir():
            kind, _, rest = path.stem.partition("_")
            if PARTS.fullmatch(path.name):
                found.append(path)
            elif OURS.fullmatch(path.name) and rest:
                is_done = int(rest) < done
                if is_done == (kind == "maps") or (kind == "state" and int(rest) < done - STATES):
                    found.append(path)
        return found

    @contextmanager
    def adding(self, lighting: Callable[[], LightingState], files: str) -> Iterator[BinaryIO]:
        """The next chunk: yields the file for its rows, then keeps it with the state that `lighting` gives. Raises OSError."""
        chunk, path = self.state.chunks, self.lights(self.state.chunks)
        with written_whole(path) as part, writing_to(path):
            with open(part, "wb") as file:
                yield file
            with open(part, "rb") as file:
                digest = hashlib.file_digest(file, "sha256").digest()
        state = ArchiveState(self.plan_digest, (*self.state.lights, digest), (*self.state.files, files), lighting())
        with written_whole(self._state(chunk)) as part, writing_to(self._state(chunk)):
            part.write_bytes(encoded(state))
        self.state = state
        self._state(chunk - STATES).unlink(missing_ok=True)
        self.maps(chunk).unlink(missing_ok=True)

    def complete(self) -> None:
        """Joins the lights of all chunks and removes what only an unfinished archive needs. Raises OSError when the disk refuses."""
        digest, path = hashlib.sha256(), self.path / LIGHTS
        with written_whole(path) as part, writing_to(path), open(part, "wb") as file:
            for chunk in range(self._plan.chunks):
                with open_regular(self.lights(chunk)) as lights:
                    while data := lights.read(COPY_BYTES):
                        digest.update(data)
                        file.write(data)
        with written_whole(self.path / DIGEST) as part:
            part.write_text(f"{digest.hexdigest()}  {LIGHTS}\n")
        self.tidy()

    def tidy(self) -> None:
        """Removes what only an unfinished archive needs."""
        for path in self.path.iterdir():
            if PARTS.fullmatch(path.name) or (OURS.fullmatch(path.name) and path.name not in (LIGHTS, DIGEST)):
                path.unlink()


def has_maps(path: Path, plan_digest: str, chunk: int, files: str) -> bool:
    """Whether the maps of a chunk are there and of these files. That they are whole is seen when they are read."""
    try:
        with open_regular(path) as file:
            header = MapReader(file).header
    except (OSError, ValueError):
        return False
    return (header.plan, header.chunk, header.files) == (plan_digest, chunk, files)


@contextmanager
def claimed_archive(folder: Path, plan: ArchivePlan, shared: bool) -> Iterator[None]:
    """Makes the folder and its plan, and keeps other archives out of it meanwhile. shared: several processes make maps side by side.

    Raises UserError for a folder in use, one of another archive, or with files of ours without a plan, OSError where it cannot be made.
    """
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        if not claimed(lock, fcntl.LOCK_SH if shared else fcntl.LOCK_EX):
            raise UserError(f"{folder}: another archive writes there; wait for its end, or choose another --out")
        strangers = sorted(path.name for path in folder.iterdir() if OURS.fullmatch(path.name))
        if strangers and not (folder / PLAN).exists():
            raise UserError(f"{folder}: has {strangers[0]} without {PLAN}; choose another --out")
        keep_plan(folder, plan)
        yield
    except BaseException:
        if made and not any(folder.iterdir()):
            folder.rmdir()
        raise
    finally:
        os.close(lock)
