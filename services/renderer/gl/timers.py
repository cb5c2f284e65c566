"""The cost of each pass of a frame: GL timer queries on a graphics card, the clock on a software renderer."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import moderngl

from vemlight.renderer.gl.programs import draws_on_processor


class Timers:
    """Costs of passes since `begin`, by timer. While off, the GPU is not queried.

    A timer query of llvmpipe counts the last tile that it drew and not all of them (24 draws of 298 ms read 91 ms), so there a pass is
    timed by the clock, between two moments at which all commands are finished.
    """

    def __init__(self, context: moderngl.Context, on: bool) -> None:
        self._context, self._on = context, on
        self._software = draws_on_processor(context)
        self._queries: list[moderngl.Query] = []  # moderngl cannot free them: they are used again
        self._queried: list[str] = []  # the timer of each query of this frame
        self._spent_ms: dict[str, float] = {}

    def begin(self) -> None:
        """Forgets what was measured."""
        self._queried.clear()
        self._spent_ms.clear()

    @contextmanager
    def measured(self, timer: str) -> Iterator[None]:
        """Adds what the body has the GPU do to a timer. Bodies do not nest."""
        if not self._on:
            yield
        elif self._software:
            self._context.finish()
            began_s = time.perf_counter()
            yield
            self._context.finish()
            self._add(timer, (time.perf_counter() - began_s) * 1e3)
        else:
            if len(self._queried) == len(self._queries):
                self._queries.append(self._context.query(time=True))
            with self._queries[len(self._queried)]:
                self._queried.append(timer)
                yield

    def read_ms(self) -> dict[str, float]:
        """Milliseconds of each timer, in the order in which they first ran; waits until the GPU is done."""
        for timer, query in zip(self._queried, self._queries, strict=False):
            self._add(timer, query.elapsed / 1e6)
        self._queried.clear()
        return dict(self._spent_ms)

    def _add(self, timer: str, spent_ms: float) -> None:
        self._spent_ms[timer] = self._spent_ms.get(timer, 0.0) + spent_ms
