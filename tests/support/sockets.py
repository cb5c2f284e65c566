"""Sockets of tests, without a network."""

from collections import deque

import zmq


class FakeSocket:
    """Receives the messages (lists of parts) put into `inbox` and records those sent in `sent`."""

    def __init__(self) -> None:
        self.inbox: deque[list[bytes]] = deque()
        self.sent: list[list[bytes]] = []

    def recv_multipart(self, _flags: int = 0) -> list[bytes]:
        if not self.inbox:
            raise zmq.Again
        return self.inbox.popleft()

    def send_multipart(self, parts: list[bytes], _flags: int = 0) -> None:
        self.sent.append(list(parts))

    def close(self) -> None:
        """Does nothing."""
