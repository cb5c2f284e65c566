"""Lossless mode: a consumer asks for frames by number, so what a killed process had not finished is asked for again.

A PUB socket loses what sat in socket buffers when a process is killed, whatever its queue's settings; here nothing is sent that was
not asked for, and only the consumer knows what it has. A request that begins where the last one ended extends it; any other
replaces it.
"""

import time
from collections.abc import Callable
from typing import Any

import zmq

from vemlight.runtime import wire
from vemlight.runtime.service_stats import ServiceStats

WINDOW_FRAMES = 4  # asked for ahead: the maker works while the consumer does
MAX_CONSUMERS = 64  # with open wishes at once; one is usual
ASK_AGAIN_S = 1.0  # after so long without the frame that is due, it is asked for again


class Pull:
    """The consumer's end, on a DEALER socket."""

    def __init__(self, socket: Any, stats: ServiceStats) -> None:
        self.socket = socket
        self._stats = stats
        self.end: int | None = None  # the first frame that will not come, once known
        self._asked_until = 0
        self._waits_since_s = float("-inf")

    def restart(self) -> None:
        """Forgets what was asked for: the next frame wanted is another one."""
        self._waits_since_s = float("-inf")

    def frame(self, due: int) -> wire.Message | None:
        """Frame `due` if it has come, each once; asks for more. What else comes is what was asked for twice, and is left."""
        while True:
            try:
                parts = self.socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                self._ask(due)
                return None
            try:
                header, arrays = wire.unpack(parts)
            except ValueError:
                self._stats.refused += 1
                continue
            if isinstance(header, wire.EndMessage):
                self.end = header.sequence
            elif isinstance(header, wire.FRAME) and header.stamp.sequence == due:
                self._waits_since_s = time.monotonic()
                self._ask(due + 1)
                return header, arrays

    def _ask(self, due: int) -> None:
        """Tops the window up; begins again at the frame that is due when it has not come for too long."""
        now = time.monotonic()
        if self.end is not None and due >= self.end:
            return
        if now - self._waits_since_s > ASK_AGAIN_S:
            start = due
        elif self._asked_until - due > WINDOW_FRAMES // 2:
            return
        else:
            start = max(self._asked_until, due)
        count = due + WINDOW_FRAMES - start
        try:
            self.socket.send_multipart(wire.pack(wire.RequestMessage(first=start, count=count)), zmq.NOBLOCK)
            self._asked_until, self._waits_since_s = start + count, now
        except zmq.Again:  # nobody there yet: ask again later
            pass


class Supply:
    """The maker's end, on a ROUTER socket."""

    def __init__(self, socket: Any, stats: ServiceStats) -> None:
        self.socket = socket
        self._stats = stats
        self._wishes: dict[bytes, tuple[int, int]] = {}  # consumer -> the next frame it wants and the first it did not ask for

    def wanted(self) -> int | None:
        """Takes the requests that wait; the earliest frame that somebody wants."""
        while True:
            try:
                consumer, *parts = self.socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                break
            try:
                request, _ = wire.unpack(parts)
            except ValueError:
                self._stats.refused += 1
                continue
            if not isinstance(request, wire.RequestMessage) or (len(self._wishes) >= MAX_CONSUMERS and consumer not in self._wishes):
                self._stats.refused += 1
                continue
            next_frame, until = self._wishes.get(consumer, (0, -1))
            extends = request.first == until and next_frame < until
            self._wishes[consumer] = (next_frame if extends else request.first, request.first + request.count)
        return min((following for following, _ in self._wishes.values()), default=None)

    def send(self, frame: Callable[[int], wire.Message | None], end: int | None) -> None:
        """Sends every wanted frame that `frame` can give, and the end to who has asked for it."""
        for consumer, (following, until) in list(self._wishes.items()):
            try:
                while following < until:
                    if end is not None and following >= end:
                        self.socket.send_multipart([consumer, *wire.pack(wire.EndMessage(sequence=end))], zmq.NOBLOCK)
                        following = until
                    elif (message := frame(following)) is not None:
                        self.socket.send_multipart([consumer, *wire.pack(*message)], zmq.NOBLOCK)
                        following += 1
                    else:
                        break
            except zmq.Again:  # its queue is full: later
                pass
            except zmq.ZMQError:  # the consumer is gone, and asks again if it comes back
                following = until
            if following < until:
                self._wishes[consumer] = (following, until)
            else:
                del self._wishes[consumer]
