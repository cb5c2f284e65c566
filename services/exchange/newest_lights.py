"""The newest lights that a service has published."""

from typing import Any

import zmq

from vemlight.runtime import wire
from vemlight.runtime.log_lines import LogLines
from vemlight.runtime.peers import receive


class NewestLights:
    """Takes what waits at a subscription. `others`: the newest message of each other kind."""

    def __init__(self, socket: Any) -> None:
        self.socket = socket
        self.others: dict[str, wire.Message] = {}
        self.passed_over = 0
        self._lines = LogLines()

    def take(self, most: int = 64) -> wire.Message | None:
        """The last of up to `most` messages that are lights; None when there is none."""
        newest = None
        for _ in range(most):
            try:
                parts, sender = receive(self.socket)
            except zmq.Again:
                break
            try:
                message = wire.unpack(parts)
            except ValueError as error:
                self._lines.say("refused", f"a message was refused: {error}")
                if sender:
                    sender.on_refused()
                continue
            if isinstance(message[0], wire.LightsMessage):
                self.passed_over += newest is not None
                newest = message
            else:
                self.others[message[0].kind] = message
        return newest
