"""Reading hostile files in child processes.

A server with all libraries loaded forks the children. A child makes and reads one file after the other, until one ends it or costs it
too much: that file is a fault, and the next child goes on behind it.
"""

import mmap
import os
import resource
import select
import shutil
import signal
import struct
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tests.support.hostile.damage import damaged
from tests.support.hostile.format import Format
from tests.support.hostile.formats import FORMATS

MAX_S = 5.0  # of processor time, which other work on the machine does not stretch
MAX_WAIT_S = 30.0  # without any processor time; on a machine with fifty times the work a child still has some each second
MAX_BYTES = 512 * 2**20  # of a child, all in all: the libraries take 150 to 250 MB of it
POLL_S = 0.2
FORGET = 1000  # files after which a child forgets which notices it has printed


class Fault(NamedTuple):
    """What a file did that it may not: the file is kept at `path`."""

    format: str
    name: str
    reason: str


class Trial(NamedTuple):
    """What is read: file `number` of `count`, named and written when its turn comes, in a folder of its own."""

    format: Format
    folder: Path
    count: int
    write: Callable[[int, Path], object]
    name: Callable[[int], str]


class Examination(NamedTuple):
    """What came of a format."""

    bombs: int
    faults: list[Fault]


def examine(name: str, count: int, seed: int, keep: Path, with_bombs: bool = True) -> Examination:
    """Reads all sound files, `count` damaged ones and, if asked for, the bombs of a format; the faulty ones are kept in `keep`."""
    format = FORMATS[name]
    folder = Path(tempfile.mkdtemp(prefix="vemlight-hostile-"))
    try:
        whole = _sound(format, folder)
        bombs = _stored(format.bombs() if with_bombs else {}, folder)
        sound = Trial(format, folder, len(whole), lambda k, path: path.write_bytes(whole[k]), lambda k: f"sound file {k}")
        faults = _try(name, sound, keep)
        for bomb, stored in bombs.items():  # each in its own child: memory is the child's
            trial = Trial(
                format, folder, 1, lambda _, path, stored=stored: shutil.copyfile(stored, path), lambda _, bomb=bomb: f"bomb {bomb}"
            )
            faults += _try(name, trial, keep)
        return Examination(len(bombs), faults + _try(name, _damaged(name, format, folder, count, seed, whole), keep))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _damaged(name: str, format: Format, folder: Path, count: int, seed: int, whole: list[bytes]) -> Trial:
    def write(number: int, path: Path) -> None:
        content = damaged(whole, f"{name} {seed} {number}")
        path.write_bytes(format.mended(content) if number % 2 else content)

    return Trial(format, folder, count, write, lambda number: f"damaged file {number} of seed {seed}")


def _stored(bombs: dict[str, bytes], folder: Path) -> dict[str, Path]:
    """The bombs on disk: in memory they would count as their readers'."""
    stored = {}
    (folder / "bombs").mkdir()
    for number, name in enumerate(list(bombs)):
        stored[name] = folder / "bombs" / str(number)
        stored[name].write_bytes(bombs.pop(name))
    return stored


def _sound(format: Format, folder: Path) -> list[bytes]:
    """The sound files, read once in this process, so that its children have all that reading takes, without threads that they lack."""
    import cv2
    import OpenEXR

    cv2.setNumThreads(0)
    OpenEXR.set_global_thread_count(0)
    contents = [path.read_bytes() for path in format.whole(folder)]
    for content in contents:
        path = format.path(folder)
        path.write_bytes(content)
        format.read(path)
    return contents


def _try(name: str, trial: Trial, keep: Path) -> list[Fault]:
    """The faults of all files, in as many children as it takes: one that ends or hangs costs its file and nothing else."""
    faults: list[Fault] = []
    first = 0
    while first < trial.count:
        done, reasons = _run_child(trial, first)
        for number, reason in reasons:
            keep.mkdir(parents=True, exist_ok=True)
            path = keep / f"{name}-{len(list(keep.iterdir()))}{trial.format.suffix}"
            trial.write(number, path)
            faults.append(Fault(name, f"{trial.name(number)} ({path})", reason))
        first = done
    return faults


def _run_child(trial: Trial, first: int) -> tuple[int, list[tuple[int, str]]]:
    """Reads files from `first` on in a child; the number of the first that it has not read, and the faults."""
    progress, (reader, report) = mmap.mmap(-1, 8), os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reader)
            _read_all(trial, first, progress, report)
        finally:
            os._exit(0)
    os.close(report)
    text, hung, watch = b"", "", _Watch()
    while True:
        ready, _, _ = select.select([reader], [], [], POLL_S)
        if ready:
            data = os.read(reader, 65536)
            text += data
            if not data:
                break
            continue
        hung = hung or watch.fault(struct.unpack("<q", progress[:])[0], _processor_s(child))
        if hung:
            os.kill(child, signal.SIGKILL)
    os.close(reader)
    _, status = os.waitpid(child, 0)
    reasons = [(int(number), reason) for number, _, reason in (line.partition("\t") for line in text.decode(errors="replace").splitlines())]
    done = struct.unpack("<q", progress[:])[0]
    if hung or os.WIFSIGNALED(status):
        reasons.append((done, hung or f"killed by {signal.Signals(os.WTERMSIG(status)).name}"))
        done += 1
    elif done < trial.count and not reasons:
        reasons.append((done, "the child ended"))
        done += 1
    return done, reasons


class _Watch:
    """Whether a child computes for too long over one file, or waits."""

    def __init__(self) -> None:
        self._number, self._began_s = -1, 0.0
        self._used_s, self._moved_s = 0.0, time.monotonic()

    def fault(self, number: int, used_s: float) -> str:
        """number: of the file that it is at. used_s: processor time that it has had."""
        if number != self._number:
            self._number, self._began_s = number, used_s
        if used_s != self._used_s:
            self._used_s, self._moved_s = used_s, time.monotonic()
        if used_s - self._began_s > MAX_S:
            return f"more than {MAX_S:g} s"
        return f"waits for more than {MAX_WAIT_S:g} s" if time.monotonic() - self._moved_s > MAX_WAIT_S else ""


def _processor_s(child: int) -> float:
    fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _read_all(trial: Trial, first: int, progress: mmap.mmap, report: int) -> None:
    """In the child: reads the files from `first` on, says which it is at, and reports the faults; ends when it has grown too large."""
    words = os.open(trial.folder / "words", os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    os.dup2(words, 1)
    os.dup2(words, 2)
    from vemlight import files

    path = trial.format.path(trial.folder)
    for number in range(first, trial.count):
        progress[:] = struct.pack("<q", number)
        trial.write(number, path)
        fault = _fault(trial.format, path, words)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        fault = fault or (f"{peak / 2**20:.0f} MB" if peak > MAX_BYTES else "")
        progress[:] = struct.pack("<q", number + 1)
        if fault:
            os.write(report, f"{number}\t{fault}\n".encode(errors="replace"))
        if peak > MAX_BYTES:
            return
        if number % FORGET == 0:
            files._noticed.clear()


def _fault(format: Format, path: Path, words: int) -> str:
    """Reads a file; what it did that it may not, or nothing."""
    from vemlight.errors import UserError

    fault = ""
    before = os.fstat(words).st_size
    try:
        format.read(path)
    except UserError as error:
        fault = "" if "\n" not in str(error) and str(error) else f"its line is {str(error)!r}"
    except BaseException as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        fault = f"{type(error).__name__}: {' '.join(str(error).split())[:200]} at {Path(where.filename).name}:{where.lineno}"
    if not fault and os.fstat(words).st_size != before:
        os.lseek(words, before, os.SEEK_SET)
        said = [line for line in os.read(words, 4096).splitlines() if not line.startswith(b"vemlight: ")]
        fault = f"a library said {said[0][:200]!r}" if said else ""
    return fault
