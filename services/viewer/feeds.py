"""Newest-only feeds to any number of readers: a frame is encoded once, when somebody asks, and nobody has a queue."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from vemlight.errors import printable_line

MAX_FAILURE = 200  # letters of why a frame could not be encoded


class Condition:
    """Wakes all who wait, each time it is notified."""

    def __init__(self) -> None:
        self._notified = asyncio.Event()

    def notify(self) -> None:
        self._notified.set()
        self._notified = asyncio.Event()

    def wait(self) -> Coroutine[Any, Any, Any]:
        """Waits for the first notification after this call, also when the result is awaited later."""
        return self._notified.wait()


class Feed:
    """The newest frame of one kind and its bytes. `number` counts the frames put in: a reader remembers the one it has.

    A frame that cannot be encoded is passed over; `failure` says why, until a later one can.
    """

    def __init__(self, encode: Callable[..., bytes], condition: Condition) -> None:
        self.number = 0
        self.failure = ""
        self._encode, self._condition = encode, condition
        self._frame: tuple[Any, ...] = ()
        self._bytes = b""
        self._encoded = self._tried = 0
        self._encoding = asyncio.Lock()

    def put(self, *frame: Any) -> None:
        """Replaces the frame: what `encode` takes."""
        self._frame = frame
        self.number += 1
        self._condition.notify()

    async def newest(self) -> tuple[int, bytes]:
        """Number and bytes of the newest frame that could be encoded; (0, b"") before the first. It is encoded in a thread, while the
        event loop goes on."""
        async with self._encoding:
            if self._tried != self.number:
                number, frame = self.number, self._frame
                try:
                    self._bytes = await asyncio.to_thread(self._encode, *frame)
                except Exception as error:  # whatever it is, the next frame may be another
                    self.failure = printable_line(f"{type(error).__name__}: {error}")[:MAX_FAILURE]
                else:
                    self._encoded, self.failure = number, ""
                self._tried = number
            return self._encoded, self._bytes

    async def after(self, number: int) -> tuple[int, bytes]:
        """As `newest`, but waits for a frame later than `number`."""
        tried = number
        while True:
            while self.number <= tried:
                await self._condition.wait()
            tried = self.number
            found, content = await self.newest()
            if found > number:
                return found, content
