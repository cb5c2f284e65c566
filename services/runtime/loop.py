"""Receive, step, send, stop: what every service does around its own work, in the two modes. Sources: services/runtime/source_loop.py.

live: a service takes the newest frame and passes over those that came while it worked; what was passed over or lost is counted.
lossless: the last service requests each frame by number and every other one makes what is requested (services/runtime/demand.py).
"""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar

import zmq

from vemlight.errors import UserError
from vemlight.files import one_line
from vemlight.runtime import stamps, wire
from vemlight.runtime.announcement import Announcement
from vemlight.runtime.channels import BACKPRESSURE_FROM, LAST, TAKES, Instance, Service
from vemlight.runtime.demand import Supply
from vemlight.runtime.instances import Input, instance_of, producer, upstream
from vemlight.runtime.peers import WORK
from vemlight.runtime.service_stats import LossCounter, ServiceStats
from vemlight.runtime.sync import Lockstep, NearestInTime, receive_all
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Settings

State = TypeVar("State")
POLL_MS = 100  # how late a stop is noticed at most when nothing arrives: any value in 10..500 does
STALE_MS = 60  # live: a frame older than this has waited in a queue while one and a half newer ones came, at 25 a second
END_PERIOD_S = 0.2  # live: the end is published again and again, for who was not listening: any value in 0.05..1 does
CACHED_FRAMES = 64  # lossless: finished frames that a service keeps for one that requests them again; more than any window of requests


class Stage(Protocol[State]):
    """A service's own work.

    `step` and `on_message` depend on their arguments alone, measured times apart, and have no effect but their result; `write` puts results
    into files.
    """

    service: Service

    def side_inputs(self, state: State) -> tuple[str, ...]:
        """The kinds of frames of the same moment that are given to `on_message` before a step; in lossless mode always the same."""
        ...

    def first_missing_frame(self) -> int:
        """The number of the first frame missing from this stage's own output; 0 when it writes none."""
        ...

    def start_at(self, target: int) -> tuple[State, int]:
        """A state, and the first frame to step it on so that every frame from `target` on is the same as in an uninterrupted run.

        That frame is `target` or one shortly before it: what a restart costs does not grow with the number.
        """
        ...

    def step(self, state: State, message: wire.Message) -> tuple[State, wire.Message]:
        """The next state, and the frame that is made of an input frame."""
        ...

    def on_message(self, state: State, message: wire.Message) -> State:
        """Takes a frame of `side_inputs` before a step; in live mode also a wire.ControlMessage, the choices of the person at the
        viewer, and the wire.StatusMessage of the service in channels.BACKPRESSURE_FROM.
        """
        ...

    def write(self, state: State, message: wire.Message) -> None:
        """Writes what `step` has just made, when files are wanted, and prints notices that are in the state.

        Raises OSError when the disk refuses; the files are then as if the frame had not been, and the next call tries anew.
        """
        ...

    def finish(self) -> None:
        """Called after the last frame, in the last stage only. Raises OSError when the disk refuses."""
        ...


class StopSignal:
    """Whether SIGTERM or SIGINT has come."""

    def __init__(self) -> None:
        self.received = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._receive)

    def _receive(self, *_: object) -> None:
        self.received = True


def publish(publisher: Any, message: wire.Message) -> None:
    """Sends to whoever has subscribed; a subscriber whose queue is full misses it."""
    publisher.send_multipart(wire.pack(*message), zmq.NOBLOCK)


def publish_status(publisher: Any, stats: ServiceStats) -> None:
    """Publishes the service's status when it is time to."""
    if status := stats.status_if_due():
        publish(publisher, (status, ()))


def run_stage(settings: Settings, stage: Stage[Any], restarts: int = 0, announcement: Announcement | None = None) -> None:
    """Runs a stage until a signal stops it or, if it is the last, it has done the last frame. announcement: sent beside its frames.

    Raises UserError for addresses that are taken, and whatever the stage raises.
    """
    transport = Transport(settings.wire)
    try:
        name = instance_of(settings, stage.service)
        stats = ServiceStats(name, restarts)
        publisher = transport.bind(name, "publish")
        if settings.mode == "lossless":
            _run_lossless(stage, settings, transport, publisher, stats, StopSignal(), announcement)
        else:
            _run_live(stage, settings, transport, publisher, stats, StopSignal(), announcement)
    finally:
        transport.close()


def backpressure_from(settings: Settings, service: Service) -> tuple[Instance, ...]:
    """Live: the instances whose statuses `service` receives."""
    if service not in BACKPRESSURE_FROM:
        return ()
    return settings.wire.renderers or (instance_of(settings, BACKPRESSURE_FROM[service]),)


def _run_live(
    stage: Stage[State],
    settings: Settings,
    transport: Transport,
    publisher: Any,
    stats: ServiceStats,
    stop: StopSignal,
    announcement: Announcement | None,
) -> None:
    (before,) = upstream(settings, stage.service)
    frames = transport.subscribe(before, TAKES[stage.service], "status", "end")
    controls = transport.subscribe(instance_of(settings, "viewer"), "control")
    statuses = {name: transport.subscribe(name, "status") for name in backpressure_from(settings, stage.service)}
    nearest = NearestInTime(transport)
    poller = zmq.Poller()
    for socket in (frames, controls, *statuses.values(), publisher):
        poller.register(socket, zmq.POLLIN)

    state, _ = stage.start_at(0)
    input_ = LiveInput(frames, stats)
    while not stop.received:
        poller.poll(POLL_MS)
        subscribed = accept_subscriptions(publisher)
        if announcement:
            announcement.send(publisher, subscribed)
        for message in receive_all(controls, stats):
            if isinstance(message[0], wire.ControlMessage):
                state = stage.on_message(state, message)
        for name, socket in statuses.items():
            for message in receive_all(socket, stats):
                if isinstance(message[0], wire.StatusMessage) and message[0].service == name:
                    state = stage.on_message(state, message)

        if newest := input_.newest():
            assert isinstance(newest[0], wire.FrameHeader)
            beside = [producer(settings, kind) for kind in stage.side_inputs(state)]
            side_frames = nearest.frames_at(newest[0].stamp, beside, stats)
            state, _ = _step(stage, state, newest, side_frames, publisher, stats, _write_if_possible)
        if input_.end:
            if stage.service == LAST:
                try:
                    stage.finish()
                except OSError as error:
                    stats.on_written(error)
                return
            publish(publisher, (input_.end, ()))
            time.sleep(END_PERIOD_S)
        publish_status(publisher, stats)


class LiveInput:
    """The frames that an upstream service publishes, of which the newest is wanted."""

    def __init__(self, socket: Any, stats: ServiceStats) -> None:
        """`socket`: subscribed to the service's frames, statuses and end. `stats`: what counts frames passed over and dropped."""
        self.end: wire.EndMessage | None = None  # once the stream has ended
        self._socket, self._stats = socket, stats
        self._losses = LossCounter()

    def newest(self) -> wire.Message | None:
        """The newest frame, if one has come since the last call.

        While this service worked, the queue between the two kept the oldest frames and dropped the newer ones. So when a stale frame is
        all that waits, the next one is waited for, STALE_MS at most, and the picture is up to date instead of a queue behind.
        """
        newest: wire.Message | None = None
        give_up_s = time.monotonic() + STALE_MS / 1e3
        while True:
            for header, arrays in receive_all(self._socket, self._stats):
                if isinstance(header, wire.FrameHeader):
                    self._losses.on_frame()
                    self._stats.skipped += newest is not None
                    newest, self.end = (header, arrays), None
                elif isinstance(header, wire.StatusMessage):
                    self._losses.on_status(header.frames)
                    self._stats.dropped = self._losses.dropped
                elif isinstance(header, wire.EndMessage):
                    self.end = header
            stale = newest is not None and isinstance(newest[0], wire.FrameHeader) and stamps.age_ms(newest[0].stamp) > STALE_MS
            left_ms = round((give_up_s - time.monotonic()) * 1e3)
            if self.end or not stale or left_ms <= 0 or not self._socket.poll(left_ms):
                return newest


def _step(
    stage: Stage[State],
    state: State,
    message: wire.Message,
    side_frames: list[wire.Message],
    publisher: Any,
    stats: ServiceStats,
    write: Callable[[Stage[State], State, wire.Message, ServiceStats], None],
) -> tuple[State, wire.Message]:
    """Steps the stage on a frame; writes, counts and publishes what it made."""
    started_s = time.monotonic()
    for side_frame in side_frames:
        state = stage.on_message(state, side_frame)
    with WORK:
        state, made = stage.step(state, message)
    write(stage, state, made, stats)
    stats.on_finished(made, time.monotonic() - started_s)
    publish(publisher, made)
    return state, made


def _write_if_possible(stage: Stage[State], state: State, made: wire.Message, stats: ServiceStats) -> None:
    """live: what the disk refuses is counted and said, and the pictures go on."""
    try:
        stage.write(state, made)
    except OSError as error:
        stats.on_written(error)
    else:
        stats.on_written(None)


@contextmanager
def _disk_needed(out: str, what: str) -> Iterator[None]:
    """lossless: what the disk refuses to write to the folder `out` ends the run, which loses nothing by it. Raises UserError."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or one_line(error)
        hint = "make room and run the same command again, which goes on from there"
        raise UserError(f"{out}: {what} cannot be written ({reason}); {hint}") from error


def _run_lossless(
    stage: Stage[State],
    settings: Settings,
    transport: Transport,
    publisher: Any,
    stats: ServiceStats,
    stop: StopSignal,
    announcement: Announcement | None,
) -> None:
    out = settings.out
    (before,) = upstream(settings, stage.service)
    supply = Supply(transport.bind(instance_of(settings, stage.service), "serve"), stats)
    first_missing = stage.first_missing_frame()
    is_last = stage.service == LAST
    state, due = stage.start_at(first_missing)
    beside = [producer(settings, kind) for kind in stage.side_inputs(state)]
    inputs = Lockstep(transport, (Input(before, TAKES[stage.service]), *beside), stats)
    made: dict[int, wire.Message] = {}

    def write(stage: Stage[State], state: State, frame: wire.Message, stats: ServiceStats) -> None:
        if due >= first_missing:
            with _disk_needed(out, f"frame {due}"):
                stage.write(state, frame)

    while not stop.received:
        zmq.select([*inputs.awaited(), supply.socket, publisher], [], [], POLL_MS / 1e3)
        subscribed = accept_subscriptions(publisher)
        if announcement:
            announcement.send(publisher, subscribed)
        # A consumer that was restarted may want a frame that is no longer here: the stage starts again before it.
        requested = supply.earliest_requested()
        if requested is not None and requested < due and requested not in made:
            state, due = stage.start_at(requested)
            made.clear()
            inputs.restart()
        if (is_last or (requested is not None and requested >= due)) and (frames := inputs.frames(due)):
            message, *side_frames = frames
            state, made[due] = _step(stage, state, message, side_frames, publisher, stats, write)
            first_missing, due = max(first_missing, due + 1), due + 1
            made.pop(due - CACHED_FRAMES, None)
        supply.send(made.get, end=inputs.end)
        if is_last and inputs.end is not None and due >= inputs.end:
            with _disk_needed(out, "what belongs to the whole run"):
                stage.finish()
            return
        publish_status(publisher, stats)
