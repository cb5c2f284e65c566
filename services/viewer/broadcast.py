"""The feeds on their way to all pages: of each frame one websocket frame is made, which every page that waits for it gets as it is.

Of each feed one message at most is on its way to a page: what the page has not named as shown is not followed by another. So what waits
for a page that stalls is at most one message of each feed, whatever it does.
"""

import asyncio
import struct
import time
from collections.abc import Callable, Iterable, Mapping

from vemlight.viewer.feeds import Condition, Feed

STALL_S = 10.0  # a page that takes nothing of what is written to it for so long is disconnected; any value in 5..60 does
LOOK_S = 1.0  # how often that is looked at
TEXT, BINARY = 1, 2  # opcodes of RFC 6455


class Reader:
    """A page's end. `transport`: of its connection. `waiting`: feeds whose newest message it has not and may get."""

    def __init__(self, transport: asyncio.WriteTransport, feeds: Iterable[str], stalled: Callable[[], None]) -> None:
        self.waiting = set(feeds)
        self.stalled = stalled
        self._transport = transport
        self._sent: dict[str, int] = {}
        self._took_all_s = time.monotonic()

    def has(self, name: str) -> int:
        """The number of the frame that it was sent last; 0: none."""
        return self._sent.get(name, 0)

    def send(self, name: str, number: int, message: bytes) -> None:
        """Sends the frame `number` of a feed; it then has to ask for the next."""
        self.waiting.discard(name)
        self._sent[name] = number
        if not self._transport.is_closing():
            self._transport.write(message)

    def is_stalled(self, now_s: float) -> bool:
        """Whether something has waited to be taken for STALL_S."""
        if not self._transport.get_write_buffer_size():
            self._took_all_s = now_s
        return now_s - self._took_all_s > STALL_S


class Broadcast:
    """All readers of a site's feeds. `first`: the byte that goes before the messages of some; `binary`: whose messages are not text."""

    def __init__(self, feeds: Mapping[str, Feed], first: Mapping[str, int], binary: set[str], changed: Condition) -> None:
        self._feeds, self._first, self._binary, self._changed = feeds, first, binary, changed
        self._newest: dict[str, tuple[int, bytes]] = dict.fromkeys(feeds, (0, b""))
        self._readers: set[Reader] = set()
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Begins to send, in tasks of the running loop."""
        self._tasks = [asyncio.create_task(self._serve(name)) for name in self._feeds] + [asyncio.create_task(self._end_stalled())]

    def stop(self) -> None:
        """Ends the tasks."""
        for task in self._tasks:
            task.cancel()

    def add(self, reader: Reader) -> None:
        """From now on it gets what it waits for."""
        self._readers.add(reader)
        for name in tuple(reader.waiting):
            self.ask(reader, name)

    def remove(self, reader: Reader) -> None:
        self._readers.discard(reader)

    def ask(self, reader: Reader, name: str) -> None:
        """The reader has shown what it had of a feed: it gets the newest as soon as there is a newer one."""
        number, message = self._newest[name]
        reader.waiting.add(name)
        if number == self._feeds[name].number > reader.has(name):
            reader.send(name, number, message)
        elif self._feeds[name].number > number:
            self._changed.notify()  # there is a newer one, for which nobody has asked yet

    async def _serve(self, name: str) -> None:
        feed, tried = self._feeds[name], 0
        while True:
            if feed.number == tried or not any(name in reader.waiting for reader in self._readers):
                await self._changed.wait()
                continue
            tried = feed.number
            number, content = await feed.newest()
            if number == self._newest[name][0]:  # this one cannot be encoded, as the page is told
                continue
            self._newest[name] = number, self._message(name, content)
            for reader in self._readers:
                if name in reader.waiting:
                    reader.send(name, *self._newest[name])

    def _message(self, name: str, content: bytes) -> bytes:
        first = bytes([self._first[name]]) if name in self._first else b""
        return websocket_frame(BINARY if name in self._binary else TEXT, first, content)

    async def _end_stalled(self) -> None:
        while True:
            await asyncio.sleep(LOOK_S)
            now_s = time.monotonic()
            for reader in [each for each in self._readers if each.is_stalled(now_s)]:
                self.remove(reader)
                reader.stalled()


def websocket_frame(opcode: int, *content: bytes) -> bytes:
    """One whole message from a server, not masked (RFC 6455, 5.2)."""
    length = sum(map(len, content))
    if length < 126:
        head = struct.pack(">BB", 0x80 | opcode, length)
    elif length < 2**16:
        head = struct.pack(">BBH", 0x80 | opcode, 126, length)
    else:
        head = struct.pack(">BBQ", 0x80 | opcode, 127, length)
    return b"".join([head, *content])
