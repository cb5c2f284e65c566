"""Receive, step, send, stop: what every service does around its own work, in the two modes.

live: a service hears the newest frame and passes over those that came while it worked; what was passed over or lost is counted.
lossless: the last service asks for each frame by number and every other one makes what is asked for (services/runtime/demand.py).
"""

import signal
import time
from typing import Any, Protocol, TypeVar

import msgspec
import numpy as np
import zmq

from vemlight.runtime import wire
from vemlight.runtime.channels import BACKPRESSURE_FROM, FRAMES, LAST, UPSTREAM, Service
from vemlight.runtime.demand import Supply
from vemlight.runtime.service_stats import Losses, ServiceStats
from vemlight.runtime.sync import Lockstep, NearestInTime, received
from vemlight.runtime.transport import Transport, admit
from vemlight.settings import Settings

State = TypeVar("State")
CameraMessage = tuple[wire.MapMessage | wire.PlateMessage, tuple[np.ndarray, ...]]
POLL_MS = 100  # how late a stop is noticed at most when nothing arrives
FRESH_MS = 60  # live: a frame older than this has waited in a queue while one and a half newer ones came, at 25 a second
END_PERIOD_S = 0.2  # live: the end is said again and again, for who was not listening
KEPT_FRAMES = 64  # lossless: how many finished frames a service holds for one that asks again


class Stage(Protocol[State]):
    """A service's own work: `step` makes the next message, `write` puts it into files."""

    service: Service

    def side_inputs(self, state: State) -> tuple[Service, ...]:
        """The services whose frames of the same moment are given to `on_message` before a step; in lossless mode always the same."""
        ...

    def first_missing_frame(self) -> int:
        """The number of the first frame missing from this stage's own output; 0 when it writes none."""
        ...

    def start_at(self, target: int) -> tuple[State, int]:
        """A state, and the first frame to step it on so that every frame from `target` on is the same as in an uninterrupted run."""
        ...

    def step(self, state: State, message: wire.Message) -> tuple[State, wire.Message]: ...

    def on_message(self, state: State, message: wire.Message) -> State:
        """Takes a frame of `side_inputs` before a step; in live mode also a wire.ControlMessage, the choices of the person at the
        viewer, and the wire.StatusMessage of the service in channels.BACKPRESSURE_FROM.
        """
        ...

    def write(self, state: State, message: wire.Message) -> None:
        """Writes what `step` has just made, when files are wanted."""
        ...

    def finish(self) -> None:
        """Called after the last frame, in the last stage only."""
        ...


class Source(Protocol):
    """Where frames come from."""

    service: Service
    fps: float
    limit: int | None  # frames to be sent in all; None: no end, from the first again after the last

    def __len__(self) -> int:
        """How many frames there are."""
        ...

    def message(self, sequence: int, index: int, time_s: float) -> wire.Message:
        """Frame `index` of the source as number `sequence`, seen at `time_s`."""
        ...


class Camera(Protocol):
    """Where frames come from by themselves."""

    service: Service
    limit: int | None  # frames to be sent in all; None: no end

    def message(self, wait_s: float) -> tuple[CameraMessage | None, int]:
        """The next frame, if one came within `wait_s`, and how many were lost before it."""
        ...

    def close(self) -> None: ...


class Stop:
    """Set by SIGTERM or SIGINT."""

    def __init__(self) -> None:
        self.asked = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._ask)

    def _ask(self, *_: object) -> None:
        self.asked = True


def publish(publisher: Any, message: wire.Message) -> None:
    """To whoever listens; a listener whose queue is full misses it."""
    publisher.send_multipart(wire.pack(*message), zmq.NOBLOCK)


def say_status(publisher: Any, stats: ServiceStats) -> None:
    if status := stats.due():
        publish(publisher, (status, ()))


def run_stage(settings: Settings, stage: Stage[Any], restarts: int = 0) -> None:
    """Runs a stage until it is told to stop or, being the last, has done the last frame.

    Raises UserError for sockets that cannot be had, and whatever the stage raises.
    """
    transport = Transport(settings.wire)
    try:
        stats = ServiceStats(stage.service, restarts)
        publisher = transport.bind(stage.service, "publish")
        run = _lossless if settings.mode == "lossless" else _live
        run(stage, transport, publisher, stats, Stop())
    finally:
        transport.close()


def _live(stage: Stage[State], transport: Transport, publisher: Any, stats: ServiceStats, stop: Stop) -> None:
    upstream = UPSTREAM[stage.service]
    assert upstream
    frames = transport.subscribe(upstream, FRAMES[upstream], "status", "end")
    told = [transport.subscribe("viewer", "control")]
    if stage.service in BACKPRESSURE_FROM:
        told.append(transport.subscribe(BACKPRESSURE_FROM[stage.service], "status"))
    nearest = NearestInTime(transport)
    poller = zmq.Poller()
    for socket in (frames, *told, publisher):
        poller.register(socket, zmq.POLLIN)

    state, _ = stage.start_at(0)
    losses = Losses()
    ended: wire.EndMessage | None = None
    while not stop.asked:
        poller.poll(POLL_MS)
        admit(publisher)
        for said in (message for socket in told for message in received(socket, stats)):
            if isinstance(said[0], wire.ControlMessage | wire.StatusMessage):
                state = stage.on_message(state, said)

        newest, ended = _newest(frames, stats, losses, ended)
        if newest:
            assert isinstance(newest[0], wire.FRAME)
            beside = nearest.to(newest[0].stamp, stage.side_inputs(state), stats)
            state = _advance(stage, state, newest, beside, publisher, stats)[0]
        if ended:
            if stage.service == LAST:
                stage.finish()
                return
            publish(publisher, (ended, ()))
            time.sleep(END_PERIOD_S)
        say_status(publisher, stats)


def _newest(
    frames: Any, stats: ServiceStats, losses: Losses, ended: wire.EndMessage | None
) -> tuple[wire.Message | None, wire.EndMessage | None]:
    """The newest frame that an upstream service has published, if there is one, and the stream's end, once it was said.

    While this service worked, the queue between the two kept the oldest frames and refused the newer ones. So when what waits is old,
    what comes next is waited for, FRESH_MS at most, and the picture is up to date instead of a queue behind.
    """
    newest: wire.Message | None = None
    give_up_s = time.monotonic() + FRESH_MS / 1e3
    while True:
        for header, arrays in received(frames, stats):
            if isinstance(header, wire.FRAME):
                losses.frame()
                stats.skipped += newest is not None
                newest, ended = (header, arrays), None
            elif isinstance(header, wire.StatusMessage):
                losses.status(header.frames)
                stats.dropped = losses.dropped
            elif isinstance(header, wire.EndMessage):
                ended = header
        stale = newest is not None and isinstance(newest[0], wire.FRAME) and wire.age_ms(newest[0].stamp) > FRESH_MS
        left_ms = round((give_up_s - time.monotonic()) * 1e3)
        if ended or not stale or left_ms <= 0 or not frames.poll(left_ms):
            return newest, ended


def _advance(
    stage: Stage[State],
    state: State,
    message: wire.Message,
    beside: list[wire.Message],
    publisher: Any,
    stats: ServiceStats,
    keep_from: int = 0,
) -> tuple[State, wire.Message]:
    began_s = time.monotonic()
    for said in beside:
        state = stage.on_message(state, said)
    state, made = stage.step(state, message)
    if isinstance(made[0], wire.FRAME) and made[0].stamp.sequence >= keep_from:
        stage.write(state, made)
    stats.finished(made, time.monotonic() - began_s)
    publish(publisher, made)
    return state, made


def _lossless(stage: Stage[State], transport: Transport, publisher: Any, stats: ServiceStats, stop: Stop) -> None:
    upstream = UPSTREAM[stage.service]
    assert upstream
    supply = Supply(transport.bind(stage.service, "serve"), stats)
    kept = stage.first_missing_frame()
    is_last = stage.service == LAST
    state, at = stage.start_at(kept if is_last else 0)
    inputs = Lockstep(transport, (upstream, *stage.side_inputs(state)), stats)
    made: dict[int, wire.Message] = {}
    while not stop.asked:
        zmq.select([*inputs.awaited(), supply.socket, publisher], [], [], POLL_MS / 1e3)
        admit(publisher)
        wanted = supply.wanted()
        if wanted is not None and wanted < at and wanted not in made:
            state, at = stage.start_at(wanted)
            made.clear()
            inputs.restart()
        if (is_last or (wanted is not None and wanted >= at)) and (frames := inputs.frames(at)):
            message, *beside = frames
            state, made[at] = _advance(stage, state, message, beside, publisher, stats, keep_from=kept)
            kept, at = max(kept, at + 1), at + 1
            made.pop(at - KEPT_FRAMES, None)
        supply.send(made.get, end=inputs.end)
        if is_last and inputs.end is not None and at >= inputs.end:
            stage.finish()
            return
        say_status(publisher, stats)


def run_source(settings: Settings, source: Source, restarts: int = 0) -> None:
    """Runs a source: by the clock in live mode, on request in lossless mode. Raises UserError for sockets that cannot be had."""
    transport = Transport(settings.wire)
    try:
        stats = ServiceStats(source.service, restarts)
        publisher = transport.bind(source.service, "publish")
        run = _source_lossless if settings.mode == "lossless" else _source_live
        run(source, transport, publisher, stats, Stop())
    finally:
        transport.close()


def _source_live(source: Source, transport: Transport, publisher: Any, stats: ServiceStats, stop: Stop) -> None:
    """Frame n is due at n / fps; a frame whose time has passed is dropped and counted. Paused, the held frame is sent again."""
    wishes = transport.subscribe("viewer", "control")
    poller = zmq.Poller()
    poller.register(wishes, zmq.POLLIN)
    poller.register(publisher, zmq.POLLIN)
    began_s, sequence, index, paused = time.monotonic(), 0, 0, False
    while not stop.asked:
        over = source.limit is not None and sequence >= source.limit
        wait_s = END_PERIOD_S if over else began_s + sequence / source.fps - time.monotonic()
        poller.poll(max(0, min(POLL_MS, round(wait_s * 1e3))))
        admit(publisher)
        for wish, _ in received(wishes, stats):
            paused = wish.paused if isinstance(wish, wire.ControlMessage) else paused
        if over:
            publish(publisher, (wire.EndMessage(sequence=sequence), ()))
            time.sleep(END_PERIOD_S)
        elif (late_s := time.monotonic() - began_s - sequence / source.fps) >= 0:
            missed = int(late_s * source.fps)
            stats.dropped += missed
            sequence, index = sequence + missed, index + (0 if paused else missed)
            made_s = time.monotonic()
            message = source.message(sequence, index % len(source), sequence / source.fps)
            publish(publisher, message)
            stats.finished(message, time.monotonic() - made_s)
            sequence, index = sequence + 1, index + (0 if paused else 1)
        say_status(publisher, stats)


def _source_lossless(source: Source, transport: Transport, publisher: Any, stats: ServiceStats, stop: Stop) -> None:
    supply = Supply(transport.bind(source.service, "serve"), stats)
    poller = zmq.Poller()
    poller.register(supply.socket, zmq.POLLIN)
    poller.register(publisher, zmq.POLLIN)
    made: dict[int, wire.Message] = {}

    def frame(k: int) -> wire.Message:
        if k not in made:
            began_s = time.monotonic()
            made[k] = source.message(k, k % len(source), k / source.fps)
            publish(publisher, made[k])
            stats.finished(made[k], time.monotonic() - began_s)
            if len(made) > KEPT_FRAMES:
                del made[next(iter(made))]
        return made[k]

    while not stop.asked:
        poller.poll(POLL_MS)
        admit(publisher)
        supply.wanted()
        supply.send(frame, end=source.limit)
        say_status(publisher, stats)


def run_camera(settings: Settings, camera: Camera, restarts: int = 0) -> None:
    """Runs a camera, in live mode. Paused, the held light is sent again with each new frame's number and stamp.

    Raises UserError for sockets that cannot be had and for a camera that cannot go on.
    """
    transport = Transport(settings.wire)
    stop = Stop()
    try:
        stats = ServiceStats(camera.service, restarts)
        publisher, wishes = transport.bind(camera.service, "publish"), transport.subscribe("viewer", "control")
        paused = False
        held: CameraMessage | None = None
        while not stop.asked:
            admit(publisher)
            for wish, _ in received(wishes, stats):
                paused = wish.paused if isinstance(wish, wire.ControlMessage) else paused
            if camera.limit is not None and stats.frames >= camera.limit:
                publish(publisher, (wire.EndMessage(sequence=2**53 - 1), ()))
                time.sleep(END_PERIOD_S)
            else:
                began_s = time.monotonic()
                message, lost = camera.message(POLL_MS / 1e3)
                stats.dropped += lost
                if message and held and paused:
                    message = msgspec.structs.replace(held[0], stamp=message[0].stamp), held[1]
                if message:
                    held = message
                    publish(publisher, message)
                    stats.finished(message, time.monotonic() - began_s)
            say_status(publisher, stats)
    finally:
        camera.close()
        transport.close()
