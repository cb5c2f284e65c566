"""What libraries written in C print of a damaged file, kept from the terminal."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_terminal = threading.RLock()  # reentrant: what reads in silence may open an image in silence


class _OtherThreads:
    """A text stream that drops what the thread that made it writes, and passes on what other threads write."""

    def __init__(self, stream: Any) -> None:
        self._stream, self._thread, self._lock = stream, threading.get_ident(), threading.Lock()

    def write(self, text: str) -> int:
        if threading.get_ident() == self._thread:
            return len(text)
        with self._lock:
            return self._stream.write(text)

    def pass_to(self, stream: Any) -> None:
        with self._lock:
            self._stream.flush()
            self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def silent() -> Iterator[None]:
    """Suppresses what OpenEXR and OpenCV print about a damaged file, so that our own line is the only one.

    What other threads print meanwhile through sys.stdout and sys.stderr is shown.
    """
    with _terminal, open(os.devnull, "w") as null, os.fdopen(os.dup(2), "w", buffering=1) as terminal:
        stdout, stderr = sys.stdout, sys.stderr
        out, err = _OtherThreads(stdout), _OtherThreads(terminal if _descriptor(stderr) == 2 else stderr)
        sys.stdout, sys.stderr = out, err
        os.dup2(null.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(terminal.fileno(), 2)
            # What another thread has put there meanwhile stays.
            sys.stdout = stdout if sys.stdout is out else sys.stdout
            sys.stderr = stderr if sys.stderr is err else sys.stderr
            err.pass_to(stderr)  # a thread that took it as sys.stderr may write later


def _descriptor(stream: Any) -> int:
    try:
        return stream.fileno()
    except (AttributeError, OSError, ValueError):  # a stream in memory, or none
        return -1
