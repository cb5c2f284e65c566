"""Damaged files and bombs of every format that is read, each read in a child process with limits.

`python -m tests.support.hostile [--count N] [--seed S] [FORMAT ...]`. A file is right or refused with a UserError of one line. A fault,
whose file is kept, is a signal, another exception, a library's word on the terminal, more than MAX_S of processor time or MAX_BYTES.
"""

import argparse
import os
import random
import resource
import select
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import NamedTuple

from tests.support.hostile import images, meshes, tables
from tests.support.hostile.format import Format

MAX_S = 5.0
MAX_BYTES = 512 * 2**20  # of a child, all in all: the libraries take 150 to 250 MB of it
BATCH = 200  # mutants a child
WORDS = (
    b"0",
    b"-1",
    b"1e308",
    b"nan",
    b"inf",
    b"99999999999999999999",
    b"2147483647",
    b"",
    b"\0",
    b"\xff\xfe",
    b"[" * 3000,
    b"{" * 3000,
    b'"' * 99,
)
FORMATS: dict[str, Format] = {**images.FORMATS, **meshes.FORMATS, **tables.FORMATS}


def mutant(content: bytes, other: bytes, chance: random.Random) -> bytes:
    """Bytes changed, cut, doubled, spliced with another file's, or numbers replaced by others that a reader may trip over."""
    data = bytearray(content)
    match chance.randrange(6):
        case 0 | 1:
            for _ in range(chance.randint(1, 8)):
                data[chance.randrange(len(data))] = chance.randrange(256)
        case 2:
            del data[chance.randrange(len(data)) :]
        case 3:
            at, length = chance.randrange(len(data)), chance.randint(1, 200)
            data[at:at] = data[at : at + length] * chance.choice((1, 2, 50))
        case 4:
            data[chance.randrange(len(data)) :] = other[chance.randrange(len(other)) :]
        case _:
            at = chance.randrange(len(data))
            data[at : at + chance.randint(0, 12)] = (
                chance.choice(WORDS) if chance.random() < 0.7 else struct.pack("<I", chance.choice((0, 1, 2**31, 2**32 - 1)))
            )
    return bytes(data)


class Fault(NamedTuple):
    """What a file did that it may not: the file is kept at `path`."""

    format: str
    name: str
    reason: str


def _child(format: Format, folder: Path, contents: list[tuple[str, bytes]], report: int) -> None:
    """Reads the files one after the other and says of each, on `report`, what came of it."""
    words = os.open(folder / "words", os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    os.dup2(words, 1)
    os.dup2(words, 2)
    from vemlight.errors import UserError

    for number, (_, content) in enumerate(contents):
        path = folder / ("manifest.jsonl" if format.suffix == ".jsonl" else f"file{format.suffix}")
        path.write_bytes(content)
        before, fault = os.fstat(words).st_size, ""
        try:
            format.read(path)
        except UserError as error:
            fault = "" if "\n" not in str(error) and str(error) else f"its line is {str(error)!r}"
        except BaseException as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            fault = f"{type(error).__name__}: {' '.join(str(error).split())[:200]} at {Path(where.filename).name}:{where.lineno}"
        os.lseek(words, before, os.SEEK_SET)
        said = [line for line in os.read(words, 4096).splitlines() if not line.startswith(b"vemlight: ")]
        fault = fault or (f"a library said {said[0][:200]!r}" if said else "")
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        os.write(report, f"{number}\t{peak}\t{fault}\n".encode())


def _processor_s(child: int) -> float:
    """Processor time that a child has had, which other work on the machine does not stretch."""
    fields = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _batch(name: str, format: Format, folder: Path, contents: list[tuple[str, bytes]], keep: Path) -> list[Fault]:
    """Reads all contents, in as many children as it takes: one that ends or hangs costs its file and nothing else."""
    faults: list[Fault] = []
    at = 0

    def fault(number: int, reason: str) -> None:
        keep.mkdir(parents=True, exist_ok=True)
        path = keep / f"{name}-{len(list(keep.iterdir()))}{format.suffix}"
        path.write_bytes(contents[number][1])
        faults.append(Fault(name, f"{contents[number][0]} ({path})", reason))

    while at < len(contents):
        reader, report = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reader)
            try:
                _child(format, folder, contents[at:], report)
            finally:
                os._exit(0)
        os.close(report)
        done, buffered, peak, hung = at, b"", 0, False
        since_s = 0.0  # processor time of the child when it last spoke
        while True:
            ready, _, _ = select.select([reader], [], [], 0.5)
            if not ready and _processor_s(child) - since_s < MAX_S:
                continue
            data = os.read(reader, 65536) if ready else b""
            since_s = _processor_s(child)
            if not ready:
                hung = True
                os.kill(child, signal.SIGKILL)
            buffered += data
            *lines, buffered = buffered.split(b"\n")
            for line in lines:
                number, before_bytes, reason = line.decode(errors="replace").split("\t", 2)
                grew = int(before_bytes) > MAX_BYTES >= peak
                peak = max(peak, int(before_bytes))
                done = at + int(number) + 1
                if reason or grew:
                    fault(done - 1, reason or f"{peak / 2**20:.0f} MB")
            if not data:
                break
        os.close(reader)
        _, status = os.waitpid(child, 0)
        if hung or os.WIFSIGNALED(status):
            fault(done, f"more than {MAX_S:g} s" if hung else f"killed by {signal.Signals(os.WTERMSIG(status)).name}")
            done += 1
        elif done < len(contents):
            fault(done, "the child ended")
            done += 1
        at = done
    return faults


def examine(name: str, count: int, seed: int, keep: Path) -> list[Fault]:
    """`count` mutants and all bombs of a format; the faulty ones are kept in `keep`."""
    format, chance = FORMATS[name], random.Random(f"{name} {seed}")
    folder = Path(tempfile.mkdtemp(prefix="vemlight-hostile-"))
    try:
        whole = [path.read_bytes() for path in format.whole(folder)]
        faults = _batch(name, format, folder, [(f"sound file {k}", content) for k, content in enumerate(whole)], keep)
        for bomb, content in format.bombs().items():  # each in its own child: memory is the child's
            faults += _batch(name, format, folder, [(f"bomb {bomb}", content)], keep)
        for start in range(0, count, BATCH):
            contents = [
                (f"mutant {start + k}", mutant(chance.choice(whole), chance.choice(whole), chance))
                for k in range(min(BATCH, count - start))
            ]
            faults += _batch(name, format, folder, contents, keep)
        return faults
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=f"of {', '.join(FORMATS)}; left out: all")
    parser.add_argument("--count", type=lambda text: int(float(text)), default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "vemlight-hostile", help="folder for the faulty files")
    options = parser.parse_args()
    found = 0
    for name in options.formats or FORMATS:
        began_s = time.monotonic()
        faults = examine(name, options.count, options.seed, options.keep)
        found += len(faults)
        print(f"{name}: {options.count} mutants, {len(faults)} faults, {time.monotonic() - began_s:.0f} s", flush=True)
        for kind in dict.fromkeys(fault.reason for fault in faults):
            some = [fault for fault in faults if fault.reason == kind]
            print(f"  {len(some)} x {kind}: {some[0].name}", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
