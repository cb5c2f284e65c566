"""What the loops of sources know of them, and of who listens."""

import os
import sys
import time
from typing import Any, Protocol

import numpy as np

from vemlight.runtime import wire
from vemlight.runtime.channels import SERVICES, Instance, service_of
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.sync import receive_all
from vemlight.runtime.transport import Transport

CameraMessage = tuple[wire.MapMessage | wire.PlateMessage, tuple[np.ndarray, ...]]
LISTENERS = "VEMLIGHT_LISTENERS"  # in the environment: the services that a source waits for before it plays, as names with spaces between
LISTENERS_S = 900.0  # then it plays in any case: compiling took 300 s on a machine with ten times its work; 600 to 3,600 s would do


class Source(Protocol):
    """Where frames come from."""

    @property
    def service(self) -> Instance:
        """Whose messages they are."""
        ...

    fps: float
    limit: int | None  # frames to be sent in all; None: no end, from the first again after the last

    def __len__(self) -> int:
        """How many frames there are."""
        ...

    def message(self, sequence: int, index: int, time_s: float) -> wire.Message:
        """Frame `index` of the source as number `sequence`, seen at `time_s`."""
        ...

    def on_control(self, control: wire.ControlMessage) -> None:
        """Takes what the person at the viewer has chosen; live mode only."""
        ...


class Camera(Protocol):
    """Where frames come from by themselves."""

    @property
    def service(self) -> Instance:
        """Whose messages they are."""
        ...

    limit: int | None  # frames to be sent in all; None: no end

    @property
    def unwritten(self) -> int:
        """Frames that were to be recorded and are not."""
        ...

    def message(self, wait_s: float) -> tuple[CameraMessage | None, int]:
        """The next frame, if one came within `wait_s`, and how many were lost before it."""
        ...

    def on_control(self, control: wire.ControlMessage) -> None:
        """Takes what the person at the viewer has chosen. Paused, `message` gives the frame shown last again, with each new one's stamp."""
        ...

    def close(self) -> None: ...


class Listeners:
    """The services that LISTENERS names, each until it has published a status: no frame shall be played to nobody."""

    def __init__(self, transport: Transport) -> None:
        named = os.environ.get(LISTENERS, "").split()
        self._awaited = {name: transport.subscribe(name, "status") for name in named if service_of(name) in SERVICES}
        self._give_up_s = time.monotonic() + LISTENERS_S

    @property
    def sockets(self) -> list[Any]:
        """Of those that are not ready yet."""
        return list(self._awaited.values())

    def awaited(self, stats: ServiceStats) -> bool:
        """Whether one of them is not ready yet. After LISTENERS_S a line says which, and none is waited for."""
        ready = [name for name, socket in self._awaited.items() if receive_all(socket, stats)]
        if self._awaited and time.monotonic() > self._give_up_s:
            missing = ", ".join(name for name in self._awaited if name not in ready)
            if missing:
                text = f"plays without {missing}, from which nothing has come for {LISTENERS_S:.0f} s; see its own lines"
                print(f"vemlight: {stats.service}: {text}", file=sys.stderr, flush=True)
            ready = list(self._awaited)
        for name in ready:
            self._awaited.pop(name).close()
        return bool(self._awaited)
