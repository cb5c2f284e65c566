"""Sources that play live: files by the clock and as the controls say, cameras as their frames come, one after the other of a host's."""

import math
import time
from typing import Any, NamedTuple, Protocol

import msgspec
import zmq

from vemlight.errors import UserError
from vemlight.runtime import wire
from vemlight.runtime.loop import END_PERIOD_S, POLL_MS, StopSignal, publish
from vemlight.runtime.playback import Playback
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.source_protocols import Camera, Listeners, Source
from vemlight.runtime.sync import receive_all
from vemlight.runtime.transport import accept_subscriptions
from vemlight.runtime.wire_fields import MAX_SEQUENCE


class Host(Protocol):
    """Has the source that plays, and perhaps another that is to play next."""

    current: Any  # a Source or a Camera

    def on_control(self, control: wire.ControlMessage) -> None:
        """Takes what the person at the viewer has chosen, for itself and for the source."""
        ...

    def on_played(self, playback: Playback) -> None:
        """Takes where a source of files stood when a frame was published."""
        ...

    def about(self) -> wire.Message | None:
        """What is said beside each status, if anything."""
        ...

    def changed(self) -> bool:
        """Whether another source is to play now."""
        ...

    def advance(self) -> None:
        """Makes it the current one."""
        ...

    def fall_back(self, error: UserError) -> None:
        """Makes another the current one, because this one cannot play on. Raises the error where there is none."""
        ...

    def close(self) -> None: ...


class Alone:
    """A host of one source for ever."""

    def __init__(self, source: Source | Camera) -> None:
        self.current = source

    def on_control(self, control: wire.ControlMessage) -> None:
        self.current.on_control(control)

    def on_played(self, playback: Playback) -> None:
        pass

    def about(self) -> None:
        return None

    def changed(self) -> bool:
        return False

    def advance(self) -> None:
        pass

    def fall_back(self, error: UserError) -> None:
        raise error

    def close(self) -> None:
        if close := getattr(self.current, "close", None):
            close()


class Outlet(NamedTuple):
    """The sockets and counters of a service that frames come from. in_step: one of several that show the same moments, which of the
    controls obey a pause alone.
    """

    publisher: Any
    controls: Any
    stats: ServiceStats
    stop: StopSignal
    in_step: bool = False

    def publish(self, message: wire.Message, step_s: float) -> None:
        """Publishes a frame that was made in `step_s`."""
        publish(self.publisher, message)
        self.stats.on_finished(message, step_s)

    def hear(self, host: Host) -> list[wire.ControlMessage]:
        """The control messages that wait, which the host has heard, too."""
        accept_subscriptions(self.publisher)
        heard = [header for header, _ in receive_all(self.controls, self.stats) if isinstance(header, wire.ControlMessage)]
        if self.in_step:
            heard = [wire.ControlMessage(paused=control.paused) for control in heard]
        for control in heard:
            host.on_control(control)
        return heard

    def report(self, host: Host, news: bool = False) -> None:
        """Publishes the status when it is due, and then, or when there is news, what the host says."""
        status = self.stats.status_if_due()
        if status:
            publish(self.publisher, (status, ()))
        if (status or news) and (about := host.about()):
            publish(self.publisher, about)


class Place(NamedTuple):
    """Where the frames of one source end and those of the next go on: number, time and segment of the first of them."""

    sequence: int = 0
    time_s: float = 0.0
    segment: int = 0


def play(outlet: Outlet, host: Host, listeners: Listeners | None) -> None:
    """Plays the host's sources until a signal comes. `listeners`: of a camera of which so many frames are wanted.

    Raises UserError for a source that cannot play on where there is none to fall back to.
    """
    place, control = Place(), None
    while not outlet.stop.received:
        played = host.current
        play_one = _play_camera if hasattr(played, "unwritten") else _play_files
        place, control = play_one(outlet, host, place, control, listeners)
        if host.current is played and not outlet.stop.received:
            host.advance()


def _play_files(
    outlet: Outlet, host: Host, place: Place, control: wire.ControlMessage | None, _: Listeners | None
) -> tuple[Place, wire.ControlMessage | None]:
    """Plays files as the controls say (`playback.py`); a frame whose time has passed is dropped and counted. Paused, the frame shown is
    sent again. Returns where it ended, and the last control.

    In step, frame 0 was due when the machine's monotonic clock began, the first frame played is the one that is due next, and each is
    stamped with the time when it was due.
    """
    source: Source = host.current
    poller = zmq.Poller()
    poller.register(outlet.controls, zmq.POLLIN)
    poller.register(outlet.publisher, zmq.POLLIN)
    playback, said = Playback.start(len(source), source.fps, *place), None
    if control:  # what was chosen for another source, but for the place that was sought there
        playback = playback._replace(seek_number=control.seek_number).obeying(control)
    started_s = time.monotonic() - playback.time_s
    if outlet.in_step:
        playback = Playback.start(len(source), source.fps, math.ceil(time.monotonic() * source.fps)).in_step()
        playback, started_s = playback._replace(since=0), 0.0
    first = playback.sequence if outlet.in_step else 0
    while not outlet.stop.received and not host.changed() and host.current is source:
        ended = source.limit is not None and playback.sequence - first >= source.limit
        wait_s = END_PERIOD_S if ended else started_s + playback.time_s - time.monotonic()
        poller.poll(max(0, min(POLL_MS, round(wait_s * 1e3))))
        for control in outlet.hear(host):
            playback = playback.obeying(control)
        if ended:
            publish(outlet.publisher, (wire.EndMessage(sequence=playback.sequence), ()))
            time.sleep(END_PERIOD_S)
        elif (late_s := time.monotonic() - started_s - playback.time_s) >= 0:
            missed = int(late_s * playback.rate_hz)
            outlet.stats.dropped += missed
            playback = playback.after(missed)
            playback = playback.in_step() if outlet.in_step else playback
            step_began_s = time.monotonic()
            try:
                header, arrays = source.message(playback.sequence, playback.index, playback.time_s)
            except UserError as error:
                host.fall_back(error)
                break
            if isinstance(header, wire.MapMessage):
                header = msgspec.structs.replace(header, segment=playback.segment)
            message = _seen_when_due((header, arrays), round(playback.time_s * 1e9)) if outlet.in_step else (header, arrays)
            outlet.publish(message, time.monotonic() - step_began_s)
            shown, playback = playback, playback.after(1)
            host.on_played(shown)
        news = playback.segment, playback.paused, playback.at_end
        outlet.report(host, news != said)
        said = news
    return Place(playback.sequence, playback.time_s, playback.segment + 1), control


def _seen_when_due(message: wire.Message, due_ns: int) -> wire.Message:
    """The frame with `due_ns` of the monotonic clock as the time when its light was seen."""
    header, arrays = message
    assert isinstance(header, wire.FrameHeader)
    stamp = header.stamp
    captured_ns = stamp.captured_ns - (stamp.monotonic_ns - due_ns)
    return msgspec.structs.replace(header, stamp=msgspec.structs.replace(stamp, monotonic_ns=due_ns, captured_ns=captured_ns)), arrays


def _play_camera(
    outlet: Outlet, host: Host, place: Place, control: wire.ControlMessage | None, listeners: Listeners | None
) -> tuple[Place, wire.ControlMessage | None]:
    """Sends a camera's frames as they come; returns as `_play_files`.

    Where so many frames are wanted and no more, what comes before the listeners are ready is not one of them and is not sent.
    """
    camera: Camera = host.current
    end = place
    while not outlet.stop.received and not host.changed() and host.current is camera:
        for heard in outlet.hear(host):
            control = heard
        if camera.limit is not None and outlet.stats.frames >= camera.limit:
            publish(outlet.publisher, (wire.EndMessage(sequence=MAX_SEQUENCE), ()))
            time.sleep(END_PERIOD_S)
        else:
            started_s = time.monotonic()
            try:
                message, lost = camera.message(POLL_MS / 1e3)
            except UserError as error:
                host.fall_back(error)
                break
            outlet.stats.unwritten = camera.unwritten
            if listeners and listeners.awaited(outlet.stats):
                message, lost = None, 0
            outlet.stats.dropped += lost
            if message:
                header, arrays = message
                stamp = header.stamp
                stamp = msgspec.structs.replace(stamp, sequence=stamp.sequence + place.sequence, time_s=stamp.time_s + place.time_s)
                header = msgspec.structs.replace(header, stamp=stamp)
                if isinstance(header, wire.MapMessage):
                    header = msgspec.structs.replace(header, segment=place.segment)
                outlet.publish((header, arrays), time.monotonic() - started_s)
                end = Place(stamp.sequence + 1, stamp.time_s + 1.0, place.segment + 1)
        outlet.report(host)
    return end, control
