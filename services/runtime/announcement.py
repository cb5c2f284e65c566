"""A message that does not change while a service runs, such as its scene: made once, in a thread, sent to who subscribes to its kind."""

import threading
import time
from collections.abc import Callable
from typing import Any

import zmq

from vemlight.runtime import wire

PERIOD_S = 1.0  # between two sendings, whoever subscribes how often: 48 MB a second at most. 0.5 to 5 s would do


class Announcement:
    """`make` is called in a thread of its own at once; what it raises ends up as no message."""

    def __init__(self, kind: str, make: Callable[[], wire.Message]) -> None:
        self._kind, self._make = kind, make
        self._parts: list[bytes] = []
        self._wanted, self._next_s = False, 0.0
        threading.Thread(target=self._prepare, name=kind, daemon=True).start()

    def _prepare(self) -> None:
        self._parts = wire.pack(*self._make())

    def send(self, publisher: Any, subscribed: set[str]) -> None:
        """Sends it when somebody has subscribed since it was sent last, it is made, and it is time."""
        self._wanted |= self._kind in subscribed
        if self._wanted and self._parts and time.monotonic() >= self._next_s:
            publisher.send_multipart(self._parts, zmq.NOBLOCK)
            self._wanted, self._next_s = False, time.monotonic() + PERIOD_S
