"""Lossless mode: a consumer requests frames by number, so what a killed process had not finished is requested again.

A PUB socket loses what sat in socket buffers when a process is killed, whatever its queue's settings; here nothing is sent unrequested,
and only the consumer knows what it has. A request that begins where the last one ended extends it; any other replaces it.
"""

import math
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import zmq

from vemlight.runtime import wire
from vemlight.runtime.peers import Peer, receive
from vemlight.runtime.service_stats import ServiceStats

WINDOW_FRAMES = 4  # requested ahead: the producer works while the consumer does. Any value in 2..QUEUE_FRAMES does
MAX_CONSUMERS = 64  # with open requests at once; one is usual
MAX_REQUESTS = 256  # taken at once, so that a flood of them does not keep a producer from its work; 64 to 1024 would do
# A consumer whose queue is full for so long has stopped, and is disconnected; one that goes on connects and requests again. A consumer at
# work has room in its queue for all that it requested. 1 to 5 s would do
STALLED_S = 2.0
RETRY_S = 1.0  # after so long without the frame that is due, it is requested again. 0.2 to 5 s would do


class Pull:
    """The consumer's end, on a DEALER socket."""

    def __init__(self, socket: Any, kind: str, stats: ServiceStats) -> None:
        """`kind`: of the frames that are wanted; a producer may send others beside them."""
        self.socket = socket
        self._kind, self._stats = kind, stats
        self.end: int | None = None  # the number of the first frame that will not come, once known
        self._requested_until = 0
        self._waiting_since_s = float("-inf")

    def restart(self) -> None:
        """Forgets what was requested: the next frame wanted is another one."""
        self._waiting_since_s = float("-inf")

    def frame(self, due: int) -> wire.Message | None:
        """Frame `due` if it has come, each once; requests more. Any other frame was requested twice, and is ignored."""
        while True:
            try:
                parts, sender = receive(self.socket)
            except zmq.Again:
                self._request(due)
                return None
            try:
                header, arrays = wire.unpack(parts)
            except ValueError as error:
                self._stats.on_refused(error, sender)
                continue
            if isinstance(header, wire.EndMessage):
                self.end = header.sequence
            elif isinstance(header, wire.FrameHeader) and header.stamp.sequence == due and header.kind == self._kind:
                self._waiting_since_s = time.monotonic()
                self._request(due + 1)
                return header, arrays

    def _request(self, due: int) -> None:
        """Extends the request when half of it has come; starts again at the frame that is due when it has not come for RETRY_S."""
        now_s = time.monotonic()
        if self.end is not None and due >= self.end:
            return
        if now_s - self._waiting_since_s > RETRY_S:
            first = due
        elif self._requested_until - due > WINDOW_FRAMES // 2:
            return
        else:
            first = max(self._requested_until, due)
        count = due + WINDOW_FRAMES - first
        try:
            self.socket.send_multipart(wire.pack(wire.RequestMessage(first=first, count=count)), zmq.NOBLOCK)
            self._requested_until, self._waiting_since_s = first + count, now_s
        except zmq.Again:  # the producer is not there yet: later
            pass


class _Request(NamedTuple):
    """The frames that a consumer still waits for, since when its queue is full, and its connection when that is known."""

    first: int
    until: int
    full_since_s: float
    sender: Peer | None


class Supply:
    """The producer's end, on a ROUTER socket."""

    def __init__(self, socket: Any, stats: ServiceStats) -> None:
        self.socket = socket
        self._stats = stats
        self._requests: dict[bytes, _Request] = {}  # by consumer
        self._packed: OrderedDict[tuple[int, str], tuple[wire.Message, list[zmq.Frame]]] = OrderedDict()  # the last sent, by number, kind

    def earliest_requested(self) -> int | None:
        """Takes the requests that wait; the number of the earliest frame that somebody wants."""
        for _ in range(MAX_REQUESTS):
            try:
                (consumer, *parts), sender = receive(self.socket)
            except zmq.Again:
                break
            try:
                header, _ = wire.unpack(parts)
                if not isinstance(header, wire.RequestMessage):
                    raise ValueError(f"a {header.kind} where requests are taken")
                self._make_room_for(consumer)
            except ValueError as error:
                self._stats.on_refused(error, sender)
                continue
            open_request = self._requests.get(consumer)
            extends = open_request is not None and header.first == open_request.until
            first = open_request.first if open_request and extends else header.first
            full_since_s = open_request.full_since_s if open_request else math.inf
            self._requests[consumer] = _Request(first, header.first + header.count, full_since_s, sender)
        return min((request.first for request in self._requests.values()), default=None)

    def _make_room_for(self, consumer: bytes) -> None:
        """Forgets the consumer whose queue has been full for longest when there are MAX_CONSUMERS others.

        Raises ValueError when all of them take their frames.
        """
        if len(self._requests) < MAX_CONSUMERS or consumer in self._requests:
            return
        longest = min(self._requests, key=lambda other: self._requests[other].full_since_s)
        if self._requests[longest].full_since_s == math.inf:
            raise ValueError(f"a request of one more than {MAX_CONSUMERS} consumers")
        del self._requests[longest]

    def send(
        self, frame: Callable[[int], wire.Message | None], end: int | None, beside: Callable[[int], wire.Message] | None = None
    ) -> None:
        """Sends every requested frame that `frame` can give, and the end to whoever requests a frame after it. `beside`: what goes
        before a frame that can be given, of another kind.
        """
        now_s = time.monotonic()
        for consumer, (first, until, full_since_s, sender) in list(self._requests.items()):
            try:
                while first < until:
                    if end is not None and first >= end:
                        self._send(consumer, wire.pack(wire.EndMessage(sequence=end)))
                        first = until
                    elif message := frame(first):
                        for each in (*((beside(first),) if beside else ()), message):
                            self._send(consumer, self._parts(first, each))
                        first, full_since_s = first + 1, math.inf
                    else:
                        break
            except zmq.Again:  # the consumer's queue is full: later
                full_since_s = min(full_since_s, now_s)
                if now_s - full_since_s > STALLED_S:
                    first = until
                    if sender:
                        sender.offence = f"took none of the frames that it requested for {STALLED_S:g} s"
            except zmq.ZMQError:  # the consumer is gone, and requests again if it comes back
                first = until
            if first < until:
                self._requests[consumer] = _Request(first, until, full_since_s, sender)
            else:
                del self._requests[consumer]

    def _send(self, consumer: bytes, parts: Sequence[bytes | zmq.Frame]) -> None:
        self.socket.send_multipart([consumer, *parts], zmq.NOBLOCK, copy=False)

    def _parts(self, sequence: int, message: wire.Message) -> list[zmq.Frame]:
        """The message's parts in memory that all consumers share, also in their queues."""
        known, parts = self._packed.get((sequence, message[0].kind), (None, []))
        if known is not message:
            parts = [zmq.Frame(part) for part in wire.pack(*message)]
            self._packed[sequence, message[0].kind] = message, parts
            if len(self._packed) > 2 * WINDOW_FRAMES:  # of two kinds at most
                self._packed.popitem(last=False)
        return parts
