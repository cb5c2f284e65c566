"""What a stage needs for the same moment besides its own input: the map behind the lights, the picture of a second camera.

live: of each service's last frames the one whose light was seen nearest in time. lossless: the frame of the same number.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

import zmq

from vemlight.runtime import stamps, wire
from vemlight.runtime.demand import Pull
from vemlight.runtime.instances import Input
from vemlight.runtime.peers import receive
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.transport import Transport

MAX_TAKEN = 64  # messages at once: many times what the queues at both ends hold, and a flood keeps nobody from its work
LAST_FRAMES = 16  # 0.6 s at 25 a second: more than lights are behind their map, 4 to 8 frames


class _Subscription(NamedTuple):
    """A service's publisher and its last frames, oldest first."""

    socket: Any
    frames: deque[wire.Message]


class NearestInTime:
    """Live mode."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._subscriptions: dict[Input, _Subscription] = {}

    def frames_at(self, stamp: stamps.Stamp, inputs: Sequence[Input], stats: ServiceStats) -> list[wire.Message]:
        """One frame of each of `inputs` that has sent any since it was first asked for here. Unsubscribes from all others."""
        for wanted, (socket, _) in list(self._subscriptions.items()):
            if wanted not in inputs:
                socket.close()
                del self._subscriptions[wanted]
        for wanted in inputs:
            if wanted not in self._subscriptions:
                socket = self._transport.subscribe(wanted.instance, wanted.kind)
                self._subscriptions[wanted] = _Subscription(socket, deque(maxlen=LAST_FRAMES))
        nearest = []
        for socket, frames in self._subscriptions.values():
            frames.extend(message for message in receive_all(socket, stats) if isinstance(message[0], wire.FrameHeader))
            if frames:
                nearest.append(min(frames, key=lambda message: distance_ns(message[0], stamp)))
        return nearest


def distance_ns(header: wire.Header, stamp: stamps.Stamp) -> int:
    """How far apart in time the light of a frame and that of `stamp` was seen."""
    assert isinstance(header, wire.FrameHeader)
    same_clock = stamp.boot_id and stamp.boot_id == header.stamp.boot_id
    return abs(header.stamp.monotonic_ns - stamp.monotonic_ns if same_clock else header.stamp.captured_ns - stamp.captured_ns)


class Lockstep:
    """Lossless mode: the frames of one number, of a stage's own input and of its side inputs."""

    def __init__(self, transport: Transport, inputs: Sequence[Input], stats: ServiceStats) -> None:
        """`inputs`: first the one whose frames the stage steps on."""
        self._pulls = [Pull(transport.request_from(wanted.instance), wanted.kind, stats) for wanted in inputs]
        self._received: dict[Pull, wire.Message] = {}

    @property
    def end(self) -> int | None:
        """The number of the first frame that will not come, once known."""
        return self._pulls[0].end

    @property
    def earliest_end(self) -> int | None:
        """The same where the end of any input is the end of all."""
        return min((pull.end for pull in self._pulls if pull.end is not None), default=None)

    def awaited(self) -> list[Any]:
        """The sockets that still owe a frame."""
        return [pull.socket for pull in self._pulls if pull not in self._received]

    def frames(self, due: int) -> list[wire.Message] | None:
        """Frame `due` of each input, in their order, once all have come; requests more."""
        for pull in self._pulls:
            if pull not in self._received and (message := pull.frame(due)):
                self._received[pull] = message
        if len(self._received) < len(self._pulls):
            return None
        frames = [self._received[pull] for pull in self._pulls]
        self._received.clear()
        return frames

    def restart(self) -> None:
        """Forgets what was requested and received: the next frame wanted is another one."""
        self._received.clear()
        for pull in self._pulls:
            pull.restart()


def receive_all(socket: Any, stats: ServiceStats, most: int = MAX_TAKEN) -> list[wire.Message]:
    """All messages that wait at a socket, oldest first, up to `most`; what `unpack` refuses is counted."""
    messages = []
    for _ in range(most):
        try:
            parts, sender = receive(socket)
        except zmq.Again:
            break
        try:
            messages.append(wire.unpack(parts))
        except ValueError as error:
            stats.on_refused(error, sender)
    return messages
