"""Sockets of tests, without a network."""

from collections import deque
from collections.abc import Sequence

import zmq


class FakeFrame:
    """The first part of a message of nobody in particular."""

    def __init__(self, data: bytes, more: bool) -> None:
        self.bytes, self.more = data, more

    def get(self, _option: int) -> int:
        return -1


class FakeSocket:
    """Receives the messages (lists of parts) put into `inbox` and records those sent in `sent`; takes none while `is_full`."""

    def __init__(self) -> None:
        self.inbox: deque[list[bytes]] = deque()
        self.sent: list[list[bytes]] = []
        self.is_full = False
        self._rest: deque[bytes] = deque()

    def recv(self, _flags: int = 0, copy: bool = True) -> bytes | FakeFrame:
        if not self._rest:
            if not self.inbox:
                raise zmq.Again
            self._rest.extend(self.inbox.popleft())
        part = self._rest.popleft()
        return part if copy else FakeFrame(part, bool(self._rest))

    def getsockopt(self, option: int) -> bool:
        assert option == zmq.RCVMORE
        return bool(self._rest)

    def send_multipart(self, parts: Sequence[bytes | zmq.Frame], _flags: int = 0, copy: bool = True) -> None:
        if self.is_full:
            raise zmq.Again
        self.sent.append([part if isinstance(part, bytes) else part.bytes for part in parts])

    def close(self) -> None:
        """Does nothing."""
