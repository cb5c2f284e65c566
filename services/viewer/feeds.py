"""Newest-only feeds to any number of readers: a frame is encoded once, when somebody asks, and nobody has a queue."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any


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
    """The newest frame of one kind and its bytes. `number` counts the frames put in: a reader remembers the one it has."""

    def __init__(self, encode: Callable[..., bytes], condition: Condition) -> None:
        self.number = 0
        self._encode, self._condition = encode, condition
        self._frame: tuple[Any, ...] = ()
        self._bytes = b""
        self._encoded = 0
        self._encoding = asyncio.Lock()

    def put(self, *frame: Any) -> None:
        """Replaces the frame: what `encode` takes."""
        self._frame = frame
        self.number += 1
        self._condition.notify()

    async def newest(self) -> tuple[int, bytes]:
        """Number and bytes of the newest frame; (0, b"") before the first. It is encoded in a thread, while the event loop goes on."""
        async with self._encoding:
            if self._encoded != self.number:
                number, frame = self.number, self._frame
                self._bytes = await asyncio.to_thread(self._encode, *frame)
                self._encoded = number
            return self._encoded, self._bytes

    async def after(self, number: int) -> tuple[int, bytes]:
        """As `newest`, but waits for a frame later than `number`."""
        while self.number <= number:
            await self._condition.wait()
        return await self.newest()
