"""Ctrl-C, of which no code between may lose sight: libraries swallow the exception while they are imported or compiled.

Where OpenGL draws it may not be raised at all, because an exception in the middle of a call leaves its threads at work.
"""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED = 128 + signal.SIGINT  # as shells count


class Interruption:
    """Whether Ctrl-C was pressed since `heeded`; pressed twice, it ends the process at once."""

    def __init__(self) -> None:
        self.came = False
        self._deferred = False

    @contextmanager
    def heeded(self) -> Iterator[None]:
        """In its body Ctrl-C raises KeyboardInterrupt and is remembered."""
        self.came = False
        if threading.current_thread() is not threading.main_thread():  # which alone gets signals
            yield
            return
        before = signal.signal(signal.SIGINT, self._note)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.came:
            os._exit(INTERRUPTED)
        self.came = True
        if not self._deferred:
            raise KeyboardInterrupt

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """In its body Ctrl-C raises nothing; `check` does, where it does no harm."""
        self.check()
        self._deferred = True
        try:
            yield
        finally:
            self._deferred = False

    def check(self) -> None:
        """Raises KeyboardInterrupt when Ctrl-C was pressed."""
        if self.came:
            raise KeyboardInterrupt


interruption = Interruption()  # of this process
