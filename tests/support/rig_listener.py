"""What the processes of a rig of cameras that runs publish, as tests and the bench hear it."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import zmq

from tests.support.processes import LOADED_S, children
from vemlight.runtime import wire
from vemlight.runtime.service_stats import LossCounter
from vemlight.runtime.transport import Transport
from vemlight.settings import Settings


class RigListener:
    """What each capture publishes, and fuse: how many frames were lost on the way, and the newest statuses and reports."""

    def __init__(self, settings: Settings, names: Sequence[str]) -> None:
        self._transport = Transport(settings.wire)
        self._sockets = {name: self._transport.subscribe(f"capture.{name}", "map", "status") for name in names}
        self._sockets["fuse"] = self._transport.subscribe("fuse", "points")
        self._names = {socket: name for name, socket in self._sockets.items()}
        self._losses = {name: LossCounter() for name in names}
        self.numbers: dict[str, list[int]] = {name: [] for name in self._sockets}
        self.restarts = dict.fromkeys(names, -1)
        self.cameras: list[int] = []

    def until(self, true: Callable[[], object], what: str) -> None:
        """Takes what comes until `true` holds; seven processes start and compile meanwhile."""
        until_s = time.monotonic() + 3 * LOADED_S
        while not true():
            assert time.monotonic() < until_s, what
            for socket in zmq.select(list(self._names), [], [], 0.1)[0]:
                self._take(self._names[socket], wire.unpack(socket.recv_multipart())[0])

    def _take(self, name: str, header: object) -> None:
        if isinstance(header, wire.StatusMessage):
            self.restarts[name] = header.restarts
            self._losses[name].on_status(header.frames)
            return
        assert isinstance(header, wire.FrameHeader)
        self.numbers[name].append(header.stamp.sequence)
        if isinstance(header, wire.PointsMessage):
            self.cameras.append(header.report.cameras)
        else:
            self._losses[name].on_frame()

    def lost(self, name: str) -> int:
        return self._losses[name].dropped

    def more(self, name: str, count: int) -> None:
        wanted = len(self.numbers[name]) + count
        self.until(lambda: len(self.numbers[name]) >= wanted, f"frames of {name}")

    def close(self) -> None:
        self._transport.close()


class LoadedSpare:
    """Whether a run has a spare that waits for its standard input: it has used no processor time for half a second."""

    def __init__(self, run: int) -> None:
        self._run, self._used, self._since_s = run, [""], time.monotonic()

    def __call__(self) -> bool:
        spare = children(self._run).get("runtime.spare")
        used = Path(f"/proc/{spare}/stat").read_text().rpartition(")")[2].split()[11:13] if spare else [""]
        if used != self._used:
            self._used, self._since_s = used, time.monotonic()
        return used != [""] and time.monotonic() > self._since_s + 0.5
