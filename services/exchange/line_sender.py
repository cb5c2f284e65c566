"""Lines to one reader over tcp, the newest only: a reader that is slower than they come misses some, and never gets a part of one."""

import contextlib
import socket as network
import time
from typing import Any

from vemlight.files import one_line
from vemlight.runtime.log_lines import LogLines

RETRY_S = 1.0  # between two attempts to connect; 0.2 to 5 s would do
CONNECT_S = 1.0  # for one
# What the kernel keeps for a slow reader, which is how old its lines are: a few frames of 18 kB. 32 to 256 kB would do.
SEND_BUFFER = 64 * 1024


class LineSender:
    """Connects to a reader that listens, again whenever it went."""

    def __init__(self, host: str, port: int) -> None:
        self.passed_over = 0  # lines that a newer one replaced
        self._host, self._port = host, port
        self._lines = LogLines()
        self._socket: network.socket | None = None
        self._rest = memoryview(b"")  # of the line on its way
        self._next = b""
        self._due_s = 0.0

    @property
    def waiting(self) -> Any:
        """The socket, while something waits to be sent through it; else None."""
        return self._socket if self._rest or self._next else None

    def offer(self, line: bytes) -> None:
        """Takes a line, with its end, in place of one that waits; sends what goes at once."""
        self.passed_over += bool(self._next)
        self._next = line
        self.send()

    def send(self) -> None:
        """Sends as much as goes without waiting."""
        if self._socket is None and not self._connect():
            return
        try:
            while self._socket and (self._rest or self._next):
                if not self._rest:
                    self._rest, self._next = memoryview(self._next), b""
                self._rest = self._rest[self._socket.send(self._rest) :]
        except BlockingIOError:
            return
        except OSError as error:
            self._say("lost", f"the reader is gone ({error.strerror}); trying again")
            self.close()

    def _connect(self) -> bool:
        if time.monotonic() < self._due_s:
            return False
        self._due_s = time.monotonic() + RETRY_S
        try:
            self._socket = network.create_connection((self._host, self._port), CONNECT_S)
            self._socket.setblocking(False)
            self._socket.setsockopt(network.SOL_SOCKET, network.SO_SNDBUF, SEND_BUFFER)
        except OSError as error:
            self._say("refused", f"nobody takes the lines ({error.strerror or one_line(error)}); trying again each second")
            return False
        self._say("connected", "connected")
        return True

    def _say(self, kind: str, text: str) -> None:
        self._lines.say(kind, f"stream: {self._host}:{self._port}: {text}")

    def close(self) -> None:
        """Drops the rest of a line with the connection."""
        if self._socket:
            with contextlib.suppress(OSError):
                self._socket.close()
        self._socket, self._rest = None, memoryview(b"")
