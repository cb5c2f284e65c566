"""`vemlight stream`: the lights of running services to another program, as OSC over UDP or as lines of JSON over tcp, as they come."""

import socket as network
import time
from collections.abc import Callable
from typing import NamedTuple

import zmq

from vemlight.errors import UserError
from vemlight.exchange.line_sender import LineSender
from vemlight.exchange.newest_lights import NewestLights
from vemlight.exchange.osc import osc_bundles
from vemlight.files import one_line
from vemlight.light.as_directional import as_directional
from vemlight.light.light_set import ErrorOfLights, LightSet, NearLights, lights_json, lights_row
from vemlight.runtime import wire
from vemlight.runtime.log_lines import LogLines
from vemlight.runtime.transport import Transport
from vemlight.settings import Settings

POLL_MS = 100
SILENT_S = 3.0  # without lights: then a line says so


class Destination(NamedTuple):
    """Where lights go."""

    host: str
    port: int


def destination(text: str, option: str) -> Destination:
    """HOST:PORT, of IPv6 [HOST]:PORT. Raises UserError, which begins with `option`, for anything else."""
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]") if host.startswith("[") else host
    if not host or (":" in host and not text.startswith("[")) or not port.isdecimal() or not 0 < int(port[:6]) < 65536:
        raise UserError(f"{option} {text[:60]}: is not HOST:PORT; write it as 127.0.0.1:9000")
    return Destination(host, int(port))


def stream(settings: Settings, osc: Destination | None, jsonl: Destination | None) -> None:
    """Runs until it is interrupted. Raises UserError for a name that has no address, for keys that cannot be used, and in lossless mode."""
    if settings.mode == "lossless":
        raise UserError("stream: in lossless mode frames are sent to who asks for them alone; use live mode")
    senders: list[Callable[[wire.Message, NearLights | None], None]] = []
    if osc:
        senders.append(OscSender(osc).send)
    lines = LineSender(*jsonl) if jsonl else None
    if lines:
        senders.append(lambda message, near: lines.offer(json_line(message, near)))
    transport = Transport(settings.wire)
    try:
        newest = NewestLights(transport, settings, "status")
        _pass_on(newest, senders, lines)
    finally:
        if lines:
            lines.close()
        transport.close()


def _pass_on(newest: NewestLights, senders: list[Callable[[wire.Message, NearLights | None], None]], lines: LineSender | None) -> None:
    heard_s, said = time.monotonic(), LogLines()
    while True:
        poller = zmq.Poller()
        poller.register(newest.socket, zmq.POLLIN)
        if lines and lines.waiting:
            poller.register(lines.waiting, zmq.POLLOUT)
        poller.poll(POLL_MS)
        if lines:
            lines.send()
        if message := newest.take():
            heard_s = time.monotonic()
            for send in senders:
                send(message, newest.near(message))
        elif time.monotonic() - heard_s > SILENT_S:
            said.say("silent", "stream: no lights come; is the sampler running? They are passed on as soon as they do")
            heard_s = time.monotonic()


class OscSender:
    """Sends a frame's bundles."""

    def __init__(self, to: Destination) -> None:
        """Raises UserError for a name that has no address."""
        try:
            family, _, _, _, self._address = network.getaddrinfo(*to, type=network.SOCK_DGRAM)[0]
        except OSError as error:
            raise UserError(f"--osc {to.host}:{to.port}: has no address ({error.strerror or one_line(error)}); check the name") from error
        self._socket = network.socket(family, network.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._lines = LogLines()

    def send(self, message: wire.Message, near: NearLights | None = None) -> None:
        header, arrays = message
        assert isinstance(header, wire.LightsMessage)
        try:
            for bundle in osc_bundles(as_directional(light_set(header, arrays), near), header.stamp.sequence):
                self._socket.sendto(bundle, self._address)
        except OSError as error:
            self._lines.say("osc", f"stream: {self._address[0]}:{self._address[1]}: a frame was not sent ({error.strerror})")


def light_set(header: wire.LightsMessage, arrays: tuple) -> LightSet:
    """The first set of a message's lights, without the gloss set."""
    return LightSet(*arrays[: 4 if header.soft else 3])


def json_line(message: wire.Message, near: NearLights | None = None) -> bytes:
    """The frame as in a file of lights, with the line's end."""
    header, arrays = message
    assert isinstance(header, wire.LightsMessage)
    report = header.report
    error = ErrorOfLights(100 * report.error_ratio, 100 * report.error_limit_ratio) if report.error_limit_ratio else None
    stamp, lights = header.stamp, light_set(header, arrays)
    row = lights_row(lights, stamp.sequence, stamp.time_s, header.coverage, error, header.clipped, near, header.estimated_lux)
    return lights_json(row) + b"\n"
