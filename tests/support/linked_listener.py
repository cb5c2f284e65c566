"""A subscriber on the other side of a link: when frames came and when they were made."""

import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from tests.support.packet_link import PacketLink
from tests.support.processes import LOADED_S
from vemlight.runtime import wire
from vemlight.runtime.transport import Transport
from vemlight.settings import Wire

FIRST_FRAMES = 20  # that show that all is at work


class Seen(NamedTuple):
    """A frame: when it came and when it was made, s on the machine's monotonic clock, which both sides have."""

    came_s: float
    made_s: float


class LinkedListener:
    """A publisher on the one side of a link, a subscriber by the services' own socket on the other, and what that has seen."""

    def __init__(self, link: PacketLink, publisher: Sequence[str], settings: Wire, service: str, kind: str) -> None:
        """publisher: module and arguments of the process that publishes as `service`."""
        self.seen: list[Seen] = []
        self._link = link
        python = (sys.executable, "-m")
        listener = ("tests.support.linked_listener", msgspec.json.encode(settings).decode(), service, kind)
        self._processes = [subprocess.Popen((*link.prefix(0), *python, *publisher))]
        self._processes.append(subprocess.Popen((*link.prefix(1), *python, *listener), stdout=subprocess.PIPE))
        threading.Thread(target=self._read, daemon=True).start()
        if not self._wait(lambda: len(self.seen) > FIRST_FRAMES):
            self.__exit__()
            raise AssertionError(f"no frames over the link within {LOADED_S:.0f} s")

    def _read(self) -> None:
        output = self._processes[1].stdout
        assert output
        for line in output:
            came, made = line.split()
            self.seen.append(Seen(float(came), float(made)))

    def _wait(self, true: Callable[[], bool]) -> bool:
        until_s = time.monotonic() + LOADED_S
        while not true() and time.monotonic() < until_s:
            time.sleep(0.002)
        return true()

    def healed_s(self, cut_s: float) -> float:
        """From the end of a cut until a frame that was made since is there."""
        self._link.cut = True
        time.sleep(cut_s)
        self._link.cut = False
        end_s = time.monotonic()
        self._wait(lambda: self.seen[-1].made_s > end_s)
        return next((seen.came_s for seen in self.seen if seen.made_s > end_s), np.inf) - end_s

    def ages_ms(self, seconds: float) -> list[float]:
        """Of the frames of some seconds from now on."""
        start = len(self.seen)
        time.sleep(seconds)
        return [1e3 * (frame.came_s - frame.made_s) for frame in self.seen[start:]]

    def __enter__(self) -> "LinkedListener":
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            process.kill()
            process.wait()


def listen(settings: Wire, service: str, kind: str) -> None:
    """Prints when each frame came and was made, until it is killed."""
    socket = Transport(settings).subscribe(service, kind)
    while socket.poll():
        header, _ = wire.unpack(socket.recv_multipart())
        if isinstance(header, wire.FrameHeader):
            print(time.monotonic(), header.stamp.monotonic_ns / 1e9, flush=True)


if __name__ == "__main__":
    listen(msgspec.json.decode(sys.argv[1], type=Wire), *sys.argv[2:])
