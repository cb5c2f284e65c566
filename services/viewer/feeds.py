"""Newest-only feeds to any number of readers: a frame is encoded once, when somebody asks, and nobody has a queue."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any


class Condition:
    """Wakes all who wait, each time it rings."""

    def __init__(self) -> None:
        self._rung = asyncio.Event()

    def ring(self) -> None:
        self._rung.set()
        self._rung = asyncio.Event()

    def wait(self) -> Coroutine[Any, Any, Any]:
        """Waits for the first ring after this call, also when the waiting itself begins later."""
        return self._rung.wait()


class Feed:
    """The newest frame of one kind and its bytes. `number` counts the frames put in: a reader remembers the one it has."""

    def __init__(self, encode: Callable[..., bytes], bell: Condition) -> None:
        self.number = 0
        self._encode, self._bell = encode, bell
        self._frame: tuple[Any, ...] = ()
        self._bytes = b""
        self._encoded = 0
        self._one_at_a_time = asyncio.Lock()

    def put(self, *frame: Any) -> None:
        """Replaces the frame: what `encode` takes."""
        self._frame = frame
        self.number += 1
        self._bell.ring()

    async def newest(self) -> tuple[int, bytes]:
        """Number and bytes of the newest frame; (0, b"") before the first. It is encoded beside the loop, which goes on."""
        async with self._one_at_a_time:
            if self._encoded != self.number:
                number, frame = self.number, self._frame
                self._bytes = await asyncio.to_thread(self._encode, *frame)
                self._encoded = number
            return self._encoded, self._bytes

    async def after(self, number: int) -> tuple[int, bytes]:
        """As `newest`, but waits for a frame later than `number`."""
        while self.number <= number:
            await self._bell.wait()
        return await self.newest()
