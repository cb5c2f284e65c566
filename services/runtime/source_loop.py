"""The loops of the services that frames come from: files played by the clock or on request, and cameras."""

import math
import os
import time
from typing import Any, Protocol

import msgspec
import numpy as np
import zmq

from vemlight.runtime import wire
from vemlight.runtime.channels import SERVICES, Instance, service_of
from vemlight.runtime.demand import Supply
from vemlight.runtime.instances import instance_of
from vemlight.runtime.loop import CACHED_FRAMES, END_PERIOD_S, POLL_MS, StopSignal, publish, publish_status
from vemlight.runtime.playback import Playback
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.sync import receive_all
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Settings

CameraMessage = tuple[wire.MapMessage | wire.PlateMessage, tuple[np.ndarray, ...]]
LISTENERS = "VEMLIGHT_LISTENERS"  # in the environment: the services that a source waits for before it plays, as names with spaces between
LISTENERS_S = 900.0  # then it plays in any case: compiling took 300 s on a machine with ten times its work; 600 to 3,600 s would do


class Source(Protocol):
    """Where frames come from."""

    service: Instance
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

    def on_played(self, playback: Playback) -> None:
        """Live: takes where it stood when a frame was published."""
        ...

    def about(self) -> wire.Message | None:
        """Live: what is said of the source beside each status, if anything."""
        ...


class Camera(Protocol):
    """Where frames come from by themselves."""

    service: Instance
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


def run_source(settings: Settings, source: Source, restarts: int = 0, in_step: bool = False) -> None:
    """Runs a source: by the clock in live mode, on request in lossless mode. Raises UserError for addresses that are taken.

    in_step: one of several on this machine that show the same moments, also when one of them was restarted.
    """
    transport = Transport(settings.wire)
    try:
        stats = ServiceStats(source.service, restarts)
        publisher = transport.bind(source.service, "publish")
        stop = StopSignal()
        if settings.mode == "lossless":
            _run_source_lossless(source, transport, publisher, stats, stop)
        else:
            _await_listeners(transport, publisher, stats, stop)
            _run_source_live(settings, source, transport, publisher, stats, stop, in_step)
    finally:
        transport.close()


class Listeners:
    """The services that LISTENERS names, each until it has published a status: no frame shall be played to nobody."""

    def __init__(self, transport: Transport) -> None:
        named = os.environ.get(LISTENERS, "").split()
        self.sockets = [transport.subscribe(name, "status") for name in named if service_of(name) in SERVICES]
        self._give_up_s = time.monotonic() + LISTENERS_S

    def awaited(self, stats: ServiceStats) -> bool:
        """Whether one of them is not ready yet."""
        self.sockets = [socket for socket in self.sockets if not list(receive_all(socket, stats))]
        return bool(self.sockets) and time.monotonic() < self._give_up_s


def _await_listeners(transport: Transport, publisher: Any, stats: ServiceStats, stop: StopSignal) -> None:
    listeners = Listeners(transport)
    while listeners.awaited(stats) and not stop.received:
        zmq.select([*listeners.sockets, publisher], [], [], POLL_MS / 1e3)
        accept_subscriptions(publisher)
        publish_status(publisher, stats)


def _run_source_live(
    settings: Settings, source: Source, transport: Transport, publisher: Any, stats: ServiceStats, stop: StopSignal, in_step: bool
) -> None:
    """Plays as the controls say (`playback.py`); a frame whose time has passed is dropped and counted. Paused, the frame shown is sent
    again.

    In step, frame 0 was due when the machine's monotonic clock began, the first frame played is the one that is due next, each is stamped
    with the time when it was due, and of the controls only a pause is obeyed.
    """
    controls = transport.subscribe(instance_of(settings, "viewer"), "control")
    poller = zmq.Poller()
    poller.register(controls, zmq.POLLIN)
    poller.register(publisher, zmq.POLLIN)
    started_s, playback, said = time.monotonic(), Playback.start(len(source), source.fps), None
    if in_step:
        playback = Playback.start(len(source), source.fps, math.ceil(started_s * source.fps)).in_step()
        playback, started_s = playback._replace(since=0), 0.0
    first = playback.sequence
    while not stop.received:
        ended = source.limit is not None and playback.sequence - first >= source.limit
        wait_s = END_PERIOD_S if ended else started_s + playback.time_s - time.monotonic()
        poller.poll(max(0, min(POLL_MS, round(wait_s * 1e3))))
        accept_subscriptions(publisher)
        for header, _ in receive_all(controls, stats):
            if isinstance(header, wire.ControlMessage):
                obeyed = wire.ControlMessage(paused=header.paused) if in_step else header
                source.on_control(obeyed)
                playback = playback.obeying(obeyed)
        if ended:
            publish(publisher, (wire.EndMessage(sequence=playback.sequence), ()))
            time.sleep(END_PERIOD_S)
        elif (late_s := time.monotonic() - started_s - playback.time_s) >= 0:
            missed = int(late_s * playback.rate_hz)
            stats.dropped += missed
            playback = playback.after(missed)
            step_began_s = time.monotonic()
            playback = playback.in_step() if in_step else playback
            header, arrays = source.message(playback.sequence, playback.index, playback.time_s)
            if isinstance(header, wire.MapMessage):
                header = msgspec.structs.replace(header, segment=playback.segment)
            message = _seen_when_due((header, arrays), round(playback.time_s * 1e9)) if in_step else (header, arrays)
            publish(publisher, message)
            stats.on_finished(message, time.monotonic() - step_began_s)
            shown, playback = playback, playback.after(1)
            source.on_played(shown)
        status, news = stats.status_if_due(), (playback.segment, playback.paused, playback.at_end)
        if status:
            publish(publisher, (status, ()))
        if (status or news != said) and (about := source.about()):
            publish(publisher, about)
            said = news


def _seen_when_due(message: wire.Message, due_ns: int) -> wire.Message:
    """The frame with `due_ns` of the monotonic clock as the time when its light was seen."""
    header, arrays = message
    assert isinstance(header, wire.FrameHeader)
    stamp = header.stamp
    captured_ns = stamp.captured_ns - (stamp.monotonic_ns - due_ns)
    return msgspec.structs.replace(header, stamp=msgspec.structs.replace(stamp, monotonic_ns=due_ns, captured_ns=captured_ns)), arrays


def _is_paused(source: Source | Camera, controls: Any, stats: ServiceStats, before: bool) -> bool:
    """Whether the newest control that waits says so, or else as before. The source gets it, too."""
    for header, _ in receive_all(controls, stats):
        if isinstance(header, wire.ControlMessage):
            source.on_control(header)
            before = header.paused
    return before


def _run_source_lossless(source: Source, transport: Transport, publisher: Any, stats: ServiceStats, stop: StopSignal) -> None:
    supply = Supply(transport.bind(source.service, "serve"), stats)
    poller = zmq.Poller()
    poller.register(supply.socket, zmq.POLLIN)
    poller.register(publisher, zmq.POLLIN)
    made: dict[int, wire.Message] = {}

    def frame(sequence: int) -> wire.Message:
        if sequence not in made:
            started_s = time.monotonic()
            made[sequence] = source.message(sequence, sequence % len(source), sequence / source.fps)
            publish(publisher, made[sequence])
            stats.on_finished(made[sequence], time.monotonic() - started_s)
            if len(made) > CACHED_FRAMES:
                del made[next(iter(made))]
        return made[sequence]

    while not stop.received:
        poller.poll(POLL_MS)
        accept_subscriptions(publisher)
        supply.earliest_requested()
        supply.send(frame, end=source.limit)
        publish_status(publisher, stats)


def run_camera(settings: Settings, camera: Camera, restarts: int = 0) -> None:
    """Runs a camera, in live mode.

    Where so many frames are wanted and no more, what comes before the listeners are ready is not one of them and is not sent.
    Raises UserError for addresses that are taken and for a camera that cannot go on.
    """
    transport = Transport(settings.wire)
    stop = StopSignal()
    try:
        stats = ServiceStats(camera.service, restarts)
        publisher, controls = transport.bind(camera.service, "publish"), transport.subscribe(instance_of(settings, "viewer"), "control")
        listeners = None if camera.limit is None else Listeners(transport)
        while not stop.received:
            accept_subscriptions(publisher)
            _is_paused(camera, controls, stats, False)
            if camera.limit is not None and stats.frames >= camera.limit:
                publish(publisher, (wire.EndMessage(sequence=wire.MAX_SEQUENCE), ()))
                time.sleep(END_PERIOD_S)
            else:
                started_s = time.monotonic()
                message, lost = camera.message(POLL_MS / 1e3)
                stats.unwritten = camera.unwritten
                if listeners and listeners.awaited(stats):
                    message, lost = None, 0
                stats.dropped += lost
                if message:
                    publish(publisher, message)
                    stats.on_finished(message, time.monotonic() - started_s)
            publish_status(publisher, stats)
    finally:
        camera.close()
        transport.close()
