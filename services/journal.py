"""Files of JSON lines that only grow, and that show what a crash, a full disk or a changed byte has done to them.

Each line ends with `chain`, the SHA-256 of the chain of the line before (nothing for the first) and of this line without its own. So a
line that was changed, exchanged or taken out is found, the last one too. Whether lines are missing at the end, only a last line of
another kind can show: that is for the owner of the file.
"""

import contextlib
import fcntl
import hashlib
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, BinaryIO, NamedTuple

from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import fsync_folder

FileName = Annotated[str, Meta(pattern=r"^[^/\\\x00]+$")]  # in the folder of the file that names it
Sha256 = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}$")]
KEY = b',"chain":"'
TAIL_BYTES = len(KEY) + 64 + len(b'"}\n')  # the chain in hexadecimal digits, and what ends a line
DYING_S = 1.0  # what a killed process may take to end on a busy machine: 0.1 s were seen; any value in 0.5 .. 5 does
MAX_LINE_BYTES = 2**26  # a frame of 100,000 lights has 20 MB


class JournalPoint(NamedTuple):
    """A place between two lines: how many lines and bytes are before it, and the chain of the last of them."""

    lines: int
    offset: int
    chain: str


JOURNAL_START = JournalPoint(0, 0, "")


def chained(content: bytes, before: str) -> bytes:
    """The line for a JSON object that is not empty, after a line whose chain is `before`."""
    chain = hashlib.sha256(before.encode() + content).hexdigest()
    return content[:-1] + KEY + chain.encode() + b'"}\n'


def checked_lines(file: BinaryIO, after: JournalPoint = JOURNAL_START) -> Iterator[tuple[bytes, JournalPoint]]:
    """The lines after a point, as objects without their chains, and the point behind each.

    Ends before the first line that is not what was written.
    """
    file.seek(after.offset)
    while line := file.readline(MAX_LINE_BYTES):
        content = line[:-TAIL_BYTES] + b"}"
        if line != chained(content, after.chain):
            return
        after = JournalPoint(after.lines + 1, after.offset + len(line), line[-67:-3].decode())
        yield content, after


def claimed(descriptor: int, how: int = fcntl.LOCK_EX) -> bool:
    """Locks a file or folder for this process until it is closed. False where another one has it, which may be about to end.

    how: LOCK_SH for those who share it and keep out others only.
    """
    until_s = time.monotonic() + DYING_S
    while True:
        try:
            fcntl.flock(descriptor, how | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            if time.monotonic() > until_s:
                return False
        except OSError:  # a file system without locks: whoever writes there from two places must know
            return True
        time.sleep(DYING_S / 20)


class Journal:
    """A file of chained lines, open for this process alone. `end`: the point up to which it is kept."""

    def __init__(self, path: Path) -> None:
        """Opens it, and makes it when there is none. Raises UserError when another process has it open, OSError when it cannot be made."""
        is_new = not path.exists()
        self.path, self.end = path, JOURNAL_START
        self._file = open(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666), "r+b", buffering=0)  # noqa: SIM115, until `close`
        if not claimed(self._file.fileno()):
            self._file.close()
            raise UserError(f"{path}: another run writes there; wait for its end, or choose another --out")
        if is_new:
            fsync_folder(path.parent)

    def holds(self, point: JournalPoint) -> bool:
        """Whether a line with that chain ends there. That lines before it are whole is not looked at."""
        return os.pread(self._file.fileno(), 67, point.offset - 67)[:-3] == point.chain.encode() if point.offset else point == JOURNAL_START

    def lines(self, after: JournalPoint = JOURNAL_START) -> Iterator[tuple[bytes, JournalPoint]]:
        """See `checked_lines`."""
        with open(self.path, "rb") as file:
            yield from checked_lines(file, after)

    def keep(self, end: JournalPoint, can_be_made_again: bool) -> int:
        """Removes what follows a point; how many lines that were.

        A crash leaves one line at most, half or full of NUL. Raises UserError for more where that cannot be made again, and for a file
        that is not a journal at all, which stays as it is.
        """
        with open(self.path, "rb") as file:
            file.seek(end.offset)
            rest = file.read(MAX_LINE_BYTES).lstrip(b"\0")
        lines = rest.count(b"\n") + (rest[-1:] not in (b"", b"\n"))
        if end == JOURNAL_START and b"\n" in rest:
            raise UserError(f"{self.path}: was not written by a run, or its first line is damaged; choose another --out, or --overwrite")
        if lines > 1 and not can_be_made_again:
            raise UserError(f"{self.path}: line {end.lines + 1} is damaged and {lines - 1} follow; choose another --out, or --overwrite")
        self.end = end
        if os.fstat(self._file.fileno()).st_size > end.offset:
            self._file.truncate(end.offset)
            os.fsync(self._file.fileno())
        return lines

    def append(self, content: bytes) -> None:
        """Adds a line, which is on the disk when the call returns. Raises OSError when the disk refuses; the file is then as before."""
        line = chained(content, self.end.chain)
        descriptor = self._file.fileno()
        try:
            if os.fstat(descriptor).st_size != self.end.offset:  # what an error left when it could not be removed
                os.ftruncate(descriptor, self.end.offset)
            written = 0
            while written < len(line):
                written += os.pwrite(descriptor, line[written:], self.end.offset + written)
            os.fsync(descriptor)
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(descriptor, self.end.offset)
            raise
        self.end = JournalPoint(self.end.lines + 1, self.end.offset + len(line), line[-67:-3].decode())

    def close(self) -> None:
        self._file.close()
