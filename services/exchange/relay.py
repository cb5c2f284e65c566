"""`vemlight relay`: publishes a place's lights to many listeners, on other hosts too, without work for the services that make them.

It subscribes once and publishes for all under the same protocol, so whatever subscribes to the sampler may subscribe to it: a renderer, a
viewer, a client. A frame has at most so many bytes, and a slow link's relay fewer lights: services/exchange/fewer_lights.py.
The work is done by a child process (`python -m vemlight.exchange.relay`), which is started again when it dies.
"""

import os
import subprocess
import sys
import time
from functools import partial
from typing import NamedTuple

import msgspec
import numpy as np
import zmq

from vemlight.errors import UserError
from vemlight.exchange.fewer_lights import error_of, fewer_lights
from vemlight.exchange.newest_lights import NewestLights
from vemlight.exchange.stream import Destination, light_set
from vemlight.light.as_directional import as_directional
from vemlight.light.light_set import LightSet, NearLights
from vemlight.runtime import wire
from vemlight.runtime.channels import SERVICES
from vemlight.runtime.children import die_with
from vemlight.runtime.log_lines import LogLines
from vemlight.runtime.restarts import Restarts
from vemlight.runtime.start import status_of
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Settings, Wire

POLL_MS = 100
PART_BYTES = 48  # what ZeroMQ (9) and the keys (33) add to a part; lights have up to eight
HEAD_BYTES = 850  # 8 x PART_BYTES, and a topic and header with a full report, 460 at most
POINT_BYTES, SOFT_BYTES = 32, 56  # of a light: id, direction, irradiance; with covariance
# What the kernel keeps for a slow listener, whose frames are that old: at 1 Mbit/s 0.26 s with its doubling. 8 to 64 kB would do.
SEND_BUFFER = 16 * 1024


class Feed(NamedTuple):
    """What a relay sends. count: lights of a frame at most. max_bytes: of a frame. rate_hz: frames a second at most; None: all."""

    count: int | None = None
    max_bytes: int = 6000
    rate_hz: float | None = None

    def lights(self, soft: bool) -> int:
        """How many lights a frame may have."""
        fitting = (self.max_bytes - HEAD_BYTES) // (SOFT_BYTES if soft else POINT_BYTES)
        return min(fitting, self.count or fitting)


class Relayed:
    """Makes the frames of a feed from the sampler's."""

    def __init__(self, feed: Feed) -> None:
        self.feed = feed
        self.frames = 0
        self.error = 0.0  # of the newest frame, what its fewer lights cost
        self._kept = np.zeros(0, np.int64)

    def frame(self, message: wire.Message, near: NearLights | None = None) -> list[bytes]:
        """The parts to publish, without the gloss set and with near lights as directional ones; the error in the report includes the
        feed's own.
        """
        header, arrays = message
        assert isinstance(header, wire.LightsMessage)
        lights = as_directional(light_set(header, arrays), near)
        fewer = fewer_lights(lights, self.feed.lights(header.soft), self._kept)
        self._kept = fewer.ids
        self.error = error_of(fewer, lights) if fewer is not lights else 0.0
        self.frames += 1
        report = msgspec.structs.replace(header.report, error_ratio=float(np.hypot(header.report.error_ratio, self.error)))
        made = msgspec.structs.replace(header, count=len(fewer.ids), gloss_count=0, report=report)
        return wire.pack(made, (*_arrays(fewer), np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)))

    def status(self, message: wire.Message) -> list[bytes]:
        """The sampler's status with the relay's own count, by which listeners judge what they lost."""
        header, _ = message
        return wire.pack(msgspec.structs.replace(header, frames=self.frames))


def _arrays(lights: LightSet) -> list[np.ndarray]:
    return [array for array in lights if array is not None]


def downstream(settings: Wire, listen: Destination) -> Wire:
    """The sockets of the relay's own: over tcp, with the same keys. Raises UserError without keys."""
    if not settings.keys and not settings.insecure:
        raise UserError("relay: [wire] has no keys; set keys = FOLDER (made by `vemlight keys`) or insecure = true")
    first = listen.port - 2 * SERVICES.index("sampler")
    if first < 1:
        raise UserError(f"--listen {listen.host}:{listen.port}: is too low a port; choose one from 1024 on")
    return msgspec.structs.replace(settings, transport="tcp", port=first, hosts={"sampler": listen.host}, ports={})


class Work(msgspec.Struct, frozen=True):
    """What the child process is told, as JSON on its standard input: others may read a command line, and settings hold a token."""

    settings: Settings
    listen: Destination
    feed: Feed


def relay(settings: Settings, listen: Destination, feed: Feed) -> int:
    """Runs until it is interrupted, or the child cannot go on: its status.

    Raises UserError for a feed without room for a light and for keys.
    """
    if settings.mode == "lossless":
        raise UserError("relay: in lossless mode frames are sent to who asks for them alone; use live mode")
    if feed.lights(soft=True) < 1:
        raise UserError(f"--bytes {feed.max_bytes}: has no room for a light; give {HEAD_BYTES + SOFT_BYTES} or more")
    downstream(settings.wire, listen)
    work = msgspec.json.encode(Work(settings, listen, feed))
    deaths = Restarts("relay")
    while True:
        deaths.on_start()
        # Its own process group: Ctrl-C reaches this process alone, with which the child ends
        command, with_us = [sys.executable, "-m", "vemlight.exchange.relay"], partial(die_with, os.getpid())
        child = subprocess.Popen(command, stdin=subprocess.PIPE, process_group=0, preexec_fn=with_us)
        try:
            child.communicate(work)
        finally:
            child.kill()
            status = child.wait()
        if status == 2:  # its own line says what the user must correct
            return status
        deaths.plan(status, may_fail=True)
        time.sleep(deaths.left_s())


def main() -> None:
    """The child's work. Raises UserError for keys, and for an address that is taken."""
    settings, listen, feed = msgspec.structs.astuple(msgspec.json.decode(sys.stdin.buffer.read(), type=Work))
    inner, outer = Transport(settings.wire), Transport(downstream(settings.wire, listen))
    try:
        publisher = outer.bind("sampler", "publish", send_buffer=SEND_BUFFER)
        newest = NewestLights(inner, settings, "status", "end")
        print(f"vemlight: lights at tcp://{listen.host}:{listen.port}: {_described(feed)}", flush=True)
        _pass_on(newest, publisher, Relayed(feed))
    finally:
        outer.close()
        inner.close()


def _described(feed: Feed) -> str:
    lights = f"up to {feed.lights(soft=True)} soft lights or {feed.lights(soft=False)} points in {feed.max_bytes} bytes"
    return lights + (f", {feed.rate_hz:g} frames a second" if feed.rate_hz else "")


def _pass_on(newest: NewestLights, publisher: zmq.Socket, relayed: Relayed) -> None:
    said = LogLines()
    period_s = 1 / relayed.feed.rate_hz if relayed.feed.rate_hz else 0.0
    due_s, waiting, near = 0.0, None, None
    poller = zmq.Poller()
    poller.register(newest.socket, zmq.POLLIN)
    poller.register(publisher, zmq.POLLIN)
    while True:
        left_ms = max(0, round((due_s - time.monotonic()) * 1e3)) if waiting else POLL_MS
        poller.poll(min(POLL_MS, left_ms))
        accept_subscriptions(publisher)
        if message := newest.take():
            waiting, near = message, newest.near(message)
        now_s = time.monotonic()
        if waiting and now_s >= due_s:
            due_s = (due_s if now_s - due_s < period_s else now_s) + period_s
            publisher.send_multipart(relayed.frame(waiting, near))
            waiting = None
            if relayed.error:
                said.say("fewer", f"relay: {relayed.feed.lights(True)} lights at most, {100 * relayed.error:.2g} % of error by that")
        for kind in ("status", "end"):
            if message := newest.others.pop(kind, None):
                publisher.send_multipart(relayed.status(message) if kind == "status" else wire.pack(*message))


if __name__ == "__main__":
    sys.exit(status_of(main))
