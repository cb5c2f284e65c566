"""The newest lights that a service has published, and the near lights beside them."""

from collections.abc import Iterator
from typing import Any

import zmq

from vemlight.light.light_set import NearLights
from vemlight.runtime import wire
from vemlight.runtime.instances import instance_of, producer
from vemlight.runtime.log_lines import LogLines
from vemlight.runtime.near_frames import NearFrames
from vemlight.runtime.peers import receive
from vemlight.runtime.transport import Transport
from vemlight.settings import Settings


class NewestLights:
    """Takes what waits at the sampler's subscription, and of a rig of cameras at that for near lights.

    `others`: the newest message of each other kind.
    """

    def __init__(self, transport: Transport, settings: Settings, *kinds: str) -> None:
        """`kinds`: of the sampler's messages besides lights."""
        self.socket = transport.subscribe(instance_of(settings, "sampler"), "lights", *kinds)
        self._points = transport.subscribe(*producer(settings, "points")) if settings.rig.file else None
        self._near = NearFrames()
        self.others: dict[str, wire.Message] = {}
        self.passed_over = 0
        self._lines = LogLines()

    def near(self, message: wire.Message) -> NearLights | None:
        """The near lights of a frame that was taken; None where there is one camera."""
        header, _ = message
        assert isinstance(header, wire.LightsMessage)
        return self._near.of(header.stamp)

    def take(self, most: int = 64) -> wire.Message | None:
        """The last of up to `most` messages that are lights; None when there is none."""
        for header, arrays in self._messages(self._points, most) if self._points else ():
            if isinstance(header, wire.PointsMessage):
                self._near.take(header, arrays)
        newest = None
        for message in self._messages(self.socket, most):
            if isinstance(message[0], wire.LightsMessage):
                self.passed_over += newest is not None
                newest = message
            else:
                self.others[message[0].kind] = message
        return newest

    def _messages(self, socket: Any, most: int) -> Iterator[wire.Message]:
        for _ in range(most):
            try:
                parts, sender = receive(socket)
            except zmq.Again:
                break
            try:
                yield wire.unpack(parts)
            except ValueError as error:
                self._lines.say("refused", f"a message was refused: {error}")
                if sender:
                    sender.on_refused()
