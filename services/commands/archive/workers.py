"""Processes of this machine that make maps of chunks, and their files in the order of the chunks."""

import contextlib
import os
import selectors
import signal
import subprocess
import sys
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import IO

import msgspec

from vemlight.commands.archive.chunks import READY, ChunkDone
from vemlight.errors import FatalError
from vemlight.journal import DYING_S
from vemlight.runtime.children import die_with
from vemlight.runtime.interrupt import interruption

AHEAD = 2  # chunks that a worker holds, the one in the making and the next, so that it need not wait while lights are made
MAX_DEATHS = 3  # of workers over one chunk: one may be an accident
POLL_S = 0.5  # in which Ctrl-C that a library has swallowed is seen


class _Worker:
    """A process, and the chunks that it was given and has not answered."""

    def __init__(self, folder: Path) -> None:
        self.given: deque[int] = deque()
        self.is_ready = False
        # A session of its own: Ctrl-C at the terminal is for this process, which then ends the workers.
        self.process = subprocess.Popen(
            [sys.executable, "-m", "vemlight.commands.archive.chunks", str(folder)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True, preexec_fn=partial(die_with, os.getpid()),
        )  # fmt: skip

    @property
    def answers(self) -> IO[bytes]:
        assert self.process.stdout is not None
        return self.process.stdout

    def give(self, chunk: int) -> None:
        """Has it make a chunk after those that it was given; one that has ended is found when its answers end."""
        assert self.process.stdin is not None
        self.given.append(chunk)
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.write(b"%d\n" % chunk)

    def end(self) -> None:
        """Ends it at once."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe:
                pipe.close()

    @property
    def was_killed(self) -> bool:
        """Whether a signal ended it, which may be an accident: the kernel's when memory is short, or a person's."""
        return (self.process.poll() or 0) < 0

    def ending(self) -> str:
        """How it ended, in words, once its answers have."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(DYING_S)
        status = self.process.poll()
        return f"was killed by {signal.Signals(-status).name}" if status and status < 0 else f"ended with status {status}"


class LocalWorkers:
    """Makes maps of the chunks with `count` processes, at most 2 count + 1 chunks ahead of whoever takes them."""

    def __init__(self, folder: Path, count: int) -> None:
        self._folder, self._count = folder, count
        self._workers: list[_Worker] = []

    def done(self, chunks: Sequence[int]) -> Iterator[ChunkDone]:
        """What became of each chunk, in order; its maps are then in the folder. Raises FatalError when workers keep dying."""
        waiting, made, deaths = deque(chunks), dict[int, ChunkDone](), Counter[int]()
        try:
            for taken, wanted in enumerate(chunks):
                latest = chunks[min(taken + AHEAD * self._count, len(chunks) - 1)]
                self._hand_out(waiting, latest)
                while wanted not in made:
                    self._collect(made, waiting, deaths)
                    self._hand_out(waiting, latest)
                yield made.pop(wanted)
        finally:
            for worker in self._workers:
                worker.end()
            self._workers.clear()

    def _hand_out(self, waiting: deque[int], latest: int) -> None:
        """Gives chunks up to `latest` to workers that have fewest, and starts workers that are missing."""
        while waiting and waiting[0] <= latest:
            busy = min(self._workers, key=lambda worker: len(worker.given), default=None)
            if len(self._workers) < self._count and (busy is None or busy.given):
                self._workers.append(busy := _Worker(self._folder))
            if busy is None or len(busy.given) >= AHEAD:
                return
            busy.give(waiting.popleft())

    def _collect(self, made: dict[int, ChunkDone], waiting: deque[int], deaths: Counter[int]) -> None:
        """Waits for answers and takes them; chunks of a worker that has died wait again."""
        interruption.check()
        with selectors.DefaultSelector() as selector:
            for worker in self._workers:
                selector.register(worker.answers, selectors.EVENT_READ, worker)
            ready = [key.data for key, _ in selector.select(POLL_S)]
        for worker in ready:
            line = worker.answers.readline()
            if line == READY:
                worker.is_ready = True
            elif line.endswith(b"\n"):
                done = msgspec.json.decode(line, type=ChunkDone)
                worker.given.remove(done.chunk)
                made[done.chunk] = done
            else:
                self._workers.remove(worker)
                how = worker.ending()
                worker.end()
                if not (worker.is_ready or worker.was_killed):  # by its installation, which starts no other one either
                    raise FatalError(f"a worker {how} before its first chunk; its own lines above say why")
                self._died(worker, how, waiting, deaths)

    def _died(self, worker: _Worker, how: str, waiting: deque[int], deaths: Counter[int]) -> None:
        if not worker.given:
            return
        deaths[worker.given[0]] += 1
        if deaths[worker.given[0]] == MAX_DEATHS:
            why = "more memory, or fewer --workers, may help" if "SIGKILL" in how else "its own lines above say why"
            raise FatalError(
                f"{self._folder}: {MAX_DEATHS} workers ended over chunk {worker.given[0]}, the last one {how}; {why}; "
                "the same command goes on there"
            )
        waiting.extendleft(reversed(worker.given))
