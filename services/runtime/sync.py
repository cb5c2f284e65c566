"""What a stage needs beside its own input, for the same moment: the map behind the lights, the picture of a second camera.

live: of each service's last frames the one whose light was seen nearest in time. lossless: the frame of the same number.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any

import zmq

from vemlight.runtime import wire
from vemlight.runtime.channels import FRAMES, Service
from vemlight.runtime.demand import Pull
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.transport import Transport

LAST_FRAMES = 16  # 0.6 s at 25 a second: more than lights are behind their map


class NearestInTime:
    """Live mode."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._heard: dict[Service, tuple[Any, deque[wire.Message]]] = {}  # socket and last frames

    def to(self, stamp: wire.Stamp, services: Sequence[Service], stats: ServiceStats) -> list[wire.Message]:
        """One frame of each of `services` that has sent any since it was first asked for. Others are no longer listened to."""
        for service, (socket, _) in list(self._heard.items()):
            if service not in services:
                socket.close()
                del self._heard[service]
        for service in services:
            if service not in self._heard:
                self._heard[service] = self._transport.subscribe(service, FRAMES[service]), deque(maxlen=LAST_FRAMES)
        for socket, last in self._heard.values():
            last.extend(message for message in received(socket, stats) if isinstance(message[0], wire.FRAME))
        return [min(last, key=lambda message: _apart_ns(message[0], stamp)) for _, last in self._heard.values() if last]


def _apart_ns(header: wire.Header, stamp: wire.Stamp) -> int:
    assert isinstance(header, wire.FRAME)
    same_clock = stamp.boot_id and stamp.boot_id == header.stamp.boot_id
    return abs(header.stamp.monotonic_ns - stamp.monotonic_ns if same_clock else header.stamp.captured_ns - stamp.captured_ns)


class Lockstep:
    """Lossless mode: the frames of one number from the service before this one and from those beside it."""

    def __init__(self, transport: Transport, services: Sequence[Service], stats: ServiceStats) -> None:
        """`services`: the one whose frames this stage takes comes first."""
        self._pulls = [Pull(transport.ask(service), stats) for service in services]
        self._came: dict[Pull, wire.Message] = {}

    @property
    def end(self) -> int | None:
        """The first frame that will not come, once known."""
        return self._pulls[0].end

    def awaited(self) -> list[Any]:
        """The sockets that something is due from."""
        return [pull.socket for pull in self._pulls if pull not in self._came]

    def frames(self, due: int) -> list[wire.Message] | None:
        """Frame `due` of each service in order, once all have come; asks for more."""
        for pull in self._pulls:
            if pull not in self._came and (message := pull.frame(due)):
                self._came[pull] = message
        if len(self._came) < len(self._pulls):
            return None
        frames = [self._came[pull] for pull in self._pulls]
        self._came.clear()
        return frames

    def restart(self) -> None:
        """Forgets what was asked for and what has come: the next frame wanted is another one."""
        self._came.clear()
        for pull in self._pulls:
            pull.restart()


def received(socket: Any, stats: ServiceStats) -> list[wire.Message]:
    """All messages that wait at a socket, oldest first; what `unpack` refuses is counted."""
    messages = []
    while True:
        try:
            parts = socket.recv_multipart(zmq.NOBLOCK)
        except zmq.Again:
            return messages
        try:
            messages.append(wire.unpack(parts))
        except ValueError:
            stats.refused += 1
