"""The fuse service: the maps of all cameras of a rig in, one map and the near lights out, on one stamp.

live: frames are paired as they come (moments.py); a camera that is silent is left out and taken in again, and nothing is restarted.
lossless: frame k of all cameras together.
"""

import math
import time
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import zmq

from vemlight.errors import UserError, of_setting
from vemlight.files import notice
from vemlight.fuse.check import warm
from vemlight.fuse.fusing import FuseReport, FuseState, fuse_step
from vemlight.fuse.moments import Moments, seen_at_ns
from vemlight.fuse.rest import Layout
from vemlight.fuse.rig_file import read_camera_rig
from vemlight.light.bright_cells import BrightCells
from vemlight.light.environment_map import EnvironmentMap
from vemlight.runtime import stamps, wire
from vemlight.runtime.demand import Supply
from vemlight.runtime.instances import Input, captures, instance_of
from vemlight.runtime.loop import CACHED_FRAMES, END_PERIOD_S, POLL_MS, StopSignal, publish, publish_status
from vemlight.runtime.peers import WORK
from vemlight.runtime.reports import MapReport, PointsReport
from vemlight.runtime.service_stats import LossCounter, ServiceStats
from vemlight.runtime.sync import Lockstep, receive_all
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Settings


class Fused(NamedTuple):
    """What is published of a moment: near lights first, so that who has the map can have both."""

    points: wire.Message
    map: wire.Message


def main(settings: Settings, restarts: int = 0) -> None:
    """Runs until a signal stops it. Raises UserError for a rig that cannot be used, and for addresses that are taken."""
    if not settings.rig.file:
        raise UserError("[rig] file names nothing; name a rig of cameras, or leave out fuse: one camera needs none")
    with of_setting("[rig] file"):
        rig = read_camera_rig(Path(settings.rig.file))
    warm(rig, layout_of_settings(settings))
    state = FuseState.start(rig)
    transport, stop = Transport(settings.wire), StopSignal()
    try:
        name = instance_of(settings, "fuse")
        stats, publisher = ServiceStats(name, restarts), transport.bind(name, "publish")
        if settings.mode == "lossless":
            _run_lossless(state, settings, transport, publisher, stats, stop)
        else:
            _run_live(state, settings, transport, publisher, stats, stop)
    finally:
        transport.close()


def layout_of_settings(settings: Settings) -> Layout:
    """Of the maps that the cameras are to send."""
    return Layout(settings.capture.rows, settings.capture.cols, settings.capture.map_coverage)


def fused_messages(
    state: FuseState, frames: tuple[wire.Message | None, ...], stamp: stamps.Stamp, spread_ms: float
) -> tuple[FuseState, Fused]:
    """The step from messages to messages. frames: `map` of each camera in the rig's order; None where it is silent."""
    maps: list[EnvironmentMap | None] = [None] * len(frames)
    headers: dict[int, wire.MapMessage] = {}
    for k, frame in enumerate(frames):
        if frame:
            header, (radiance, *bright) = frame
            assert isinstance(header, wire.MapMessage)
            maps[k], headers[k] = EnvironmentMap(radiance, header.coverage, BrightCells(*bright)), header
    saturated = [k in headers and headers[k].report.saturated_pixels > 0 for k in range(len(frames))]
    state, made, near, report = fuse_step(state, maps, saturated)
    for limit in report.limits:
        notice(f"fuse: {limit}")
    rows, cols, _ = made.radiance.shape
    map_header = wire.MapMessage(
        stamp=stamp,
        rows=rows,
        cols=cols,
        coverage=made.coverage,
        bright_samples=len(made.bright_cells.cells),
        luminance_scale=_common_scale(report.gains, headers),
        clipped=any(header.clipped for header in headers.values()),
        report=MapReport(
            invalid_cells=sum(header.report.invalid_cells for header in headers.values()),
            black_pixels=sum(header.report.black_pixels for header in headers.values()),
            saturated_pixels=sum(header.report.saturated_pixels for header in headers.values()),
            estimated_lux=max((header.report.estimated_lux for header in headers.values()), default=0.0),
        ),
    )
    x, y, z = map(float, state.rig.centre)
    points_report = _points_report(report, len(headers), spread_ms)
    points_header = wire.PointsMessage(stamp=stamp, count=len(near.ids), at=(x, y, z), report=points_report)
    return state, Fused((points_header, near.arrays()), (map_header, (made.radiance, *made.bright_cells)))


def _common_scale(gains: np.ndarray, headers: dict[int, wire.MapMessage]) -> float | None:
    """cd/m2 per unit of the fused map: that of the cameras whose unit no gain changes, where it is one; else it is not known."""
    scales = {header.luminance_scale for k, header in headers.items() if (gains[k] == 1).all()}
    return scales.pop() if len(scales) == 1 else None


def _points_report(report: FuseReport, cameras: int, spread_ms: float) -> PointsReport:
    return PointsReport(
        cameras=cameras,
        silent_cameras=len(report.silent),
        sources=report.sources,
        near_lights=report.located,
        hidden_lights=report.hidden,
        unexplained_sources=report.unexplained,
        uncovered_ratio=float(np.clip(report.uncovered, 0, 1)),
        spread_ms=spread_ms,
    )


class LiveCameras:
    """The captures' sockets: their frames go to the moments, what they lost is counted, and who has ended is known."""

    def __init__(self, transport: Transport, settings: Settings, stats: ServiceStats) -> None:
        names = captures(settings)
        self.sockets = [transport.subscribe(name, "map", "status", "end") for name in names]
        self.moments = Moments(len(names), settings.capture.fps)
        self._losses = [LossCounter() for _ in names]
        self._ended = [False for _ in names]
        self._stats = stats

    def receive(self) -> None:
        """Takes what waits."""
        for k, socket in enumerate(self.sockets):
            for message in receive_all(socket, self._stats):
                header = message[0]
                if isinstance(header, wire.MapMessage):
                    now_ns = time.monotonic_ns()
                    self.moments.take(k, message, seen_at_ns(header.stamp, stamps.boot_id(), now_ns, time.time_ns()), now_ns)
                    self._losses[k].on_frame()
                    self._ended[k] = False
                elif isinstance(header, wire.StatusMessage):
                    self._losses[k].on_status(header.frames)
                elif isinstance(header, wire.EndMessage):
                    self._ended[k] = True
        self._stats.dropped = sum(losses.dropped for losses in self._losses)
        self._stats.skipped = self.moments.skipped

    def ended(self) -> bool:
        """Whether no camera sends any more, and one has said that it is done."""
        silent = self.moments.silent(time.monotonic_ns())
        return any(self._ended) and all(ended or left_out for ended, left_out in zip(self._ended, silent, strict=True))


def _run_live(
    state: FuseState, settings: Settings, transport: Transport, publisher: Any, stats: ServiceStats, stop: StopSignal
) -> None:
    cameras = LiveCameras(transport, settings, stats)
    poller = zmq.Poller()
    for socket in (*cameras.sockets, publisher):
        poller.register(socket, zmq.POLLIN)
    sequence, began_ns = 0, None
    while not stop.received:
        poller.poll(math.ceil(min(POLL_MS, cameras.moments.wait_ns(time.monotonic_ns()) / 1e6)))
        accept_subscriptions(publisher)
        cameras.receive()
        is_done = 0 < settings.capture.frames <= sequence  # the cameras, which begin one after the other, may have more
        if not is_done and (moment := cameras.moments.next(time.monotonic_ns())):
            began_ns = moment.at_ns if began_ns is None else began_ns
            stamp = msgspec.structs.replace(moment.stamp, sequence=sequence, time_s=(moment.at_ns - began_ns) / 1e9)
            started_s = time.monotonic()
            with WORK:
                state, fused = fused_messages(state, moment.frames, stamp, moment.spread_ns / 1e6)
            _publish(fused, publisher, stats, started_s)
            sequence += 1
        elif is_done or cameras.ended():
            publish(publisher, (wire.EndMessage(sequence=sequence), ()))
            time.sleep(END_PERIOD_S)
        publish_status(publisher, stats)


def _publish(fused: Fused, publisher: Any, stats: ServiceStats, started_s: float) -> None:
    for message in fused:
        publish(publisher, message)
    stats.on_finished(fused.points, time.monotonic() - started_s)


def _run_lossless(
    first: FuseState, settings: Settings, transport: Transport, publisher: Any, stats: ServiceStats, stop: StopSignal
) -> None:
    """Makes what is requested; a request for a frame that is no longer here starts again at the first, for the lights are tracked."""
    supply = Supply(transport.bind(instance_of(settings, "fuse"), "serve"), stats)
    inputs = Lockstep(transport, [Input(name, "map") for name in captures(settings)], stats)
    state, due = first, 0
    made: dict[int, Fused] = {}
    while not stop.received:
        zmq.select([*inputs.awaited(), supply.socket, publisher], [], [], POLL_MS / 1e3)
        accept_subscriptions(publisher)
        requested = supply.earliest_requested()
        if requested is not None and requested < due and requested not in made:
            state, due = first, 0
            made.clear()
            inputs.restart()
        if requested is not None and requested >= due and (frames := inputs.frames(due)):
            started_s = time.monotonic()
            header = frames[0][0]
            assert isinstance(header, wire.FrameHeader)
            with WORK:
                state, made[due] = fused_messages(state, tuple(frames), header.stamp, 0.0)
            _publish(made[due], publisher, stats, started_s)
            due += 1
            made.pop(due - CACHED_FRAMES, None)
        supply.send(
            lambda k: made[k].map if k in made else None, end=inputs.earliest_end, beside=lambda k: made[k].points
        )
        publish_status(publisher, stats)
