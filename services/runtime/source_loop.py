"""The loops of the services that frames come from: files played by the clock or on request, and cameras."""

import time
from typing import Any

import zmq

from vemlight.runtime import wire
from vemlight.runtime.channels import Instance
from vemlight.runtime.demand import Supply
from vemlight.runtime.instances import instance_of
from vemlight.runtime.live_sources import Alone, Host, Outlet, play
from vemlight.runtime.loop import CACHED_FRAMES, POLL_MS, StopSignal, publish, publish_status
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.source_protocols import Camera, Listeners, Source
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Settings


def run_source(settings: Settings, source: Source, restarts: int = 0, in_step: bool = False) -> None:
    """Runs a source: by the clock in live mode, on request in lossless mode. Raises UserError for addresses that are taken.

    in_step: one of several on this machine that show the same moments, also when one of them was restarted.
    """
    transport = Transport(settings.wire)
    try:
        if settings.mode == "lossless":
            stats, publisher = ServiceStats(source.service, restarts), transport.bind(source.service, "publish")
            _run_source_lossless(source, transport, publisher, stats, StopSignal())
        else:
            _run_live(settings, transport, Alone(source), source.service, restarts, in_step)
    finally:
        transport.close()


def _await_listeners(transport: Transport, publisher: Any, stats: ServiceStats, stop: StopSignal) -> None:
    listeners = Listeners(transport)
    while listeners.awaited(stats) and not stop.received:
        zmq.select([*listeners.sockets, publisher], [], [], POLL_MS / 1e3)
        accept_subscriptions(publisher)
        publish_status(publisher, stats)


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
    """Runs a camera, in live mode. Raises UserError for addresses that are taken and for a camera that cannot go on."""
    run_host(settings, Alone(camera), camera.service, restarts)


def run_host(settings: Settings, host: Host, service: Instance, restarts: int = 0) -> None:
    """Runs the sources of a host one after the other, in live mode. Raises UserError as `run_camera`."""
    transport = Transport(settings.wire)
    try:
        _run_live(settings, transport, host, service, restarts)
    finally:
        host.close()
        transport.close()


def _run_live(
    settings: Settings, transport: Transport, host: Host, service: Instance, restarts: int, in_step: bool = False
) -> None:
    """Files wait for the listeners before the first frame; a camera goes on, and of so many frames those before are none."""
    stop, stats = StopSignal(), ServiceStats(service, restarts)
    publisher = transport.bind(service, "publish")
    is_camera, listeners = hasattr(host.current, "unwritten"), None
    if not is_camera:
        _await_listeners(transport, publisher, stats, stop)
    elif host.current.limit is not None:
        listeners = Listeners(transport)
    controls = transport.subscribe(instance_of(settings, "viewer"), "control")
    play(Outlet(publisher, controls, stats, stop, in_step), host, listeners)
