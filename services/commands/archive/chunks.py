"""Stage 1 of an archive: the maps of one chunk of frames, by whoever asks, in any order; what a source says meanwhile comes with them."""

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import msgspec

from vemlight.capture.frames import Frame
from vemlight.capture.masking import MaskedSource
from vemlight.capture.source import FilesOfFrames, open_files
from vemlight.commands.archive.map_file import ChunkHeader, write_maps
from vemlight.commands.archive.plan import ArchivePlan, difference, files_digest, new_plan
from vemlight.errors import UserError
from vemlight.files import kept_notices, notice, writing_to

READY = b"ready\n"  # a worker's first line, behind all that is loaded
WAY_OUT_OF_WORKERS = "all workers need the same frames, calibration and version of vemlight as who asks them"


class ChunkDone(msgspec.Struct, frozen=True):
    """What became of a chunk. cost_s: processor time. notices: texts. fault: what the user has to mend, else empty."""

    chunk: int
    cost_s: float = 0.0
    notices: tuple[str, ...] = ()
    fault: str = ""


class ChunkMaker:
    """Makes maps of an archive's chunks from a source of its own."""

    def __init__(self, plan: ArchivePlan) -> None:
        """Opens nothing yet: what is wrong with the source is said of a chunk."""
        self._plan, self._digest = plan, plan.digest()
        self._source: FilesOfFrames | None = None
        self._masked: MaskedSource | None = None

    def to_file(self, chunk: int, path: Path) -> ChunkDone:
        """Writes the maps of a chunk to `path`, which is whole or not there. Raises OSError when the disk refuses."""
        part = path.with_name(f"{path.name}.{os.uname().nodename.replace('.', '-')}-{os.getpid()}.part")
        began_s = time.process_time()  # of all threads, which decode films
        try:
            with writing_to(path), open(part, "wb") as file:
                done = self.to(chunk, file)
            if not done.fault:
                os.replace(part, path)  # not flushed: what a power failure leaves is found by its CRC, and made again
        finally:
            part.unlink(missing_ok=True)
        return msgspec.structs.replace(done, cost_s=time.process_time() - began_s)

    def to(self, chunk: int, file: BinaryIO) -> ChunkDone:
        """Writes the maps of a chunk. Raises OSError when the disk refuses."""
        began_s, fault = time.thread_time(), ""
        with kept_notices() as notices:
            try:
                self._write(chunk, file)
            except UserError as error:
                fault = str(error)
        return ChunkDone(chunk, time.thread_time() - began_s, tuple(dict.fromkeys(notices)), fault)

    def _write(self, chunk: int, file: BinaryIO) -> None:
        if self._source is None:
            source = open_files(self._plan.capture_settings())
            found = new_plan(source, self._plan.capture_settings(), self._plan.sampler_settings(), self._plan.chunk_frames)
            if differs := difference(self._plan, found):
                raise UserError(f"{self._plan.capture['source']}: on {os.uname().nodename} {differs}; {WAY_OUT_OF_WORKERS}")
            if chunk:
                source.frame(0)  # as in a run from the first frame on, it decides of which size the others are
            self._source, self._masked = source, MaskedSource(source, self._plan.capture_settings())
        assert self._masked
        masked, numbers = self._masked, self._plan.frames_of(chunk)
        coverage = self._plan.capture_settings().map_coverage
        header = ChunkHeader(self._digest, chunk, len(numbers), files_digest(self._source, numbers), coverage)

        def frames() -> Iterator[Frame]:
            for k in numbers:
                yield masked.frame(k)

        write_maps(file, header, frames())


def say(done: ChunkDone) -> None:
    """Passes on what was said while a chunk was made."""
    for line in done.notices:
        notice(line)


def main() -> int:
    """A worker's process, started by `LocalWorkers`: chunks' numbers as lines on standard input, a ChunkDone in JSON for each on output."""
    folder = Path(sys.argv[1])
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(2, 1)  # what libraries print is no answer
    maker = ChunkMaker(msgspec.json.decode((folder / "plan.json").read_bytes(), type=ArchivePlan))
    answers.write(READY)
    for line in sys.stdin:
        chunk = int(line)
        try:
            done = maker.to_file(chunk, folder / f"maps_{chunk:06d}")
        except OSError as error:
            done = ChunkDone(chunk, fault=f"{error.filename or folder}: {error.strerror or error}; make room, or write elsewhere")
        answers.write(msgspec.json.encode(done) + b"\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
