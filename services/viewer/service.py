"""The viewer's process: receives what the other services publish, serves the page, and publishes what the person has chosen."""

import asyncio
import contextlib
import logging
import signal
import socket
import time
from typing import Any

import cv2
import zmq
import zmq.asyncio
from aiohttp import web

from vemlight.errors import UserError
from vemlight.runtime import wire
from vemlight.runtime.channels import FRAMES, LAST, QUEUE_FRAMES, REPORT_PERIOD_S, Instance, service_of
from vemlight.runtime.instances import instance_of
from vemlight.runtime.log_lines import LogLines
from vemlight.runtime.sync import receive_all
from vemlight.runtime.token import is_loopback, with_token
from vemlight.runtime.transport import Transport, keep_accepting_subscriptions
from vemlight.settings import Settings, Viewer
from vemlight.viewer.connections import Connections, LineHandler
from vemlight.viewer.viewer_state import ViewerState
from vemlight.viewer.web import Site

SUMMARY_PERIOD_S = 0.25  # how often the page's figures change: faster than this nobody reads them; any value in 0.1..0.5 does
MAX_TAKEN = 4 * QUEUE_FRAMES  # messages at once: more than the queues at both ends hold, and a flood cannot fill memory
RECONNECT_S = 8.0  # pages try to reconnect each second (page/viewer.js), a busy browser or a loaded machine late; 5..10 s would do
BACKLOG = 64  # connections that wait to be accepted, which is how many come at once; 16 to 128 would do
LINGER_S = 2.0  # to take the rest of a request that was refused, so that its sender can read why; 0.5 to 5 s would do
SHUTDOWN_S = 0.1  # aiohttp waits for open streams so long twice, and they would go on for ever; any value below 1 s does


async def view(settings: Settings, restarts: int) -> None:
    """Runs until SIGTERM or SIGINT. Raises UserError for sockets or a port that cannot be had."""
    settings = with_token(settings)
    cv2.setNumThreads(1)  # its threads take more processor time than they save on pictures of this size
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    transport = Transport(settings.wire, zmq.asyncio.Context())
    state = ViewerState(settings, restarts)
    state.uploads.remove_left_over()
    lines = LogLines()
    for name in ("asyncio", "aiohttp"):
        logging.getLogger(name).addHandler(LineHandler(lines))
    runner = web.AppRunner(Site(state).app(), access_log=None, shutdown_timeout=SHUTDOWN_S, lingering_time=LINGER_S)
    tasks: list[asyncio.Task[Any]] = []
    listener: asyncio.Server | None = None
    try:
        publisher = transport.bind(instance_of(settings, "viewer"), "publish")
        listener = await _listen(runner, settings.viewer, lines)
        for service in state.liveness.last_received:
            tasks.append(asyncio.create_task(receive(transport, service, state)))
        if (renderer := instance_of(settings, LAST)) in state.liveness.last_received:
            tasks.append(asyncio.create_task(receive_scene(transport, renderer, state)))
        tasks.append(asyncio.create_task(keep_accepting_subscriptions(publisher)))
        tasks.append(asyncio.create_task(publish(publisher, state)))
        tasks.append(asyncio.create_task(refresh(state, lines)))
        print(f"vemlight: {address(settings.viewer)}", flush=True)
        tasks.append(asyncio.create_task(stop.wait()))
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()  # raises what ended it, if it was not the signal
    finally:
        for task in tasks:
            task.cancel()
        if listener:
            listener.close()
        await runner.cleanup()
        transport.close()


async def _listen(runner: web.AppRunner, settings: Viewer, lines: LogLines) -> asyncio.Server:
    await runner.setup()
    assert runner.server
    try:
        connections = Connections(runner.server, lines)
        return await asyncio.get_running_loop().create_server(connections, settings.host, settings.port, backlog=BACKLOG)
    except OSError as error:
        where = f"{settings.host}:{settings.port}"
        reason = error.strerror or error
        raise UserError(f"{where}: the viewer cannot listen there ({reason}); stop what holds it or change [viewer] host, port") from error


def address(settings: Viewer) -> str:
    """Where the page is, and who can open it."""
    host = _own_address(settings.host) if settings.host in ("0.0.0.0", "::") else settings.host
    url = f"http://{f'[{host}]' if ':' in host else host}:{settings.port}" + (f"/?token={settings.token}" if settings.token else "")
    if is_loopback(settings.host):
        return f"the viewer is at {url} (for this machine only)"
    who = "everyone on the network who has this address" if settings.token else "EVERYONE who reaches this machine over the network"
    return f"the viewer is at {url} (for {who})"


def _own_address(everywhere: str) -> str:
    """This machine's address on the way to the network, for "0.0.0.0" or "::", which others cannot open. Nothing is sent."""
    family, far = (socket.AF_INET6, "2001:db8::1") if ":" in everywhere else (socket.AF_INET, "192.0.2.1")  # RFC 3849, 5737: nobody's
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((far, 9))
            return probe.getsockname()[0]
        except OSError:  # no network
            return "::1" if ":" in everywhere else "127.0.0.1"


def frames_shown(state: ViewerState, service: Instance) -> tuple[str, ...]:
    """The kinds of messages that the page shows of a service beside its status: none of each camera of a rig, whose maps are many."""
    if state.liveness.last_received[service].by_status:
        return ()
    kind = FRAMES[service_of(service)].kind
    beside = {"fuse": ("map",), "capture": ("source",)}
    return (kind, *beside.get(service_of(service), ()))


async def receive(transport: Transport, service: Instance, state: ViewerState) -> None:
    """Takes all that waits from one service, and then again."""
    socket = transport.subscribe(service, *frames_shown(state, service), "status", "end")
    waiting = zmq.Socket.shadow(socket)
    while True:
        await socket.poll()
        state.take(service, receive_all(waiting, state.stats, MAX_TAKEN))


async def receive_scene(transport: Transport, renderer: Instance, state: ViewerState) -> None:
    """Takes the scene, by a socket of its own: the renderer sends it to each who subscribes, once."""
    socket = transport.subscribe(renderer, "scene")
    waiting = zmq.Socket.shadow(socket)
    while True:
        await socket.poll()
        state.take_scene(receive_all(waiting, state.stats, MAX_TAKEN))


async def publish(publisher: Any, state: ViewerState) -> None:
    """Publishes all that was chosen and the viewer's own status, twice a second, and the choices at once when they change.

    A viewer that starts knows of no choices. It says so only when the pages that were open have had the time to repeat theirs, so that
    meanwhile the other services go on as they were.
    """
    silent_until_s = time.monotonic() + RECONNECT_S
    while True:
        if state.control != wire.ControlMessage() or time.monotonic() > silent_until_s:
            await publisher.send_multipart(wire.pack(state.control))
        if status := state.status_if_due():
            await publisher.send_multipart(wire.pack(status))
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(state.control_changed.wait(), REPORT_PERIOD_S)


async def refresh(state: ViewerState, lines: LogLines) -> None:
    """Refreshes the page's figures, and says what could not be sent to it."""
    while True:
        state.refresh()
        for name, reason in state.failures.items():
            lines.say(f"feed {name}", f"viewer: cannot make {name} for pages, and goes on with the next: {reason}")
        await asyncio.sleep(SUMMARY_PERIOD_S)
