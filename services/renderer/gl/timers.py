"""What each pass of a picture costs: GL timer queries on a graphics card, the clock on a software renderer."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import moderngl

SOFTWARE = ("llvmpipe", "softpipe", "SwiftShader")  # GL_RENDERER of those that draw on the processor


class Timers:
    """Costs of the passes since `begin`, by name. While off they ask nothing of the GPU.

    A timer query of llvmpipe counts the last tile that it drew and not all of them (24 draws of 298 ms read 91 ms), so there a pass is
    what the clock says between two moments at which nothing is left to do.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self.on = False
        self._context = context
        self._software = any(name in context.info["GL_RENDERER"] for name in SOFTWARE)
        self._queries: list[moderngl.Query] = []  # moderngl cannot free them: they serve again
        self._asked: list[str] = []
        self._spent_ms: dict[str, float] = {}

    def begin(self) -> None:
        """Forgets what was measured."""
        self._asked.clear()
        self._spent_ms.clear()

    @contextmanager
    def measured(self, name: str) -> Iterator[None]:
        """Adds what the body has the GPU do to the pass `name`. Bodies do not nest."""
        if not self.on:
            yield
        elif self._software:
            self._context.finish()
            began_s = time.perf_counter()
            yield
            self._context.finish()
            self._add(name, (time.perf_counter() - began_s) * 1e3)
        else:
            if len(self._asked) == len(self._queries):
                self._queries.append(self._context.query(time=True))
            with self._queries[len(self._asked)]:
                self._asked.append(name)
                yield

    def read_ms(self) -> dict[str, float]:
        """Milliseconds of each pass, in the order in which they first came; waits until the GPU is done."""
        for name, query in zip(self._asked, self._queries, strict=False):
            self._add(name, query.elapsed / 1e6)
        self._asked.clear()
        return dict(self._spent_ms)

    def _add(self, name: str, spent_ms: float) -> None:
        self._spent_ms[name] = self._spent_ms.get(name, 0.0) + spent_ms
