"""Many listeners at one service, at a relay and at bare libzmq: frames that arrive, and how late. Run it on an idle machine.

    python -m bench.fan_out [--lights 100 400 1000] [--maps 10 100] [--seconds 10]

A stand-in for the sampler publishes 72 soft lights 30 times a second by the service's own sockets; one for capture maps of 90 x 360.
The listeners without keys speak ZMTP themselves, all in one process, so that the publisher is measured and not they; with keys
they are libzmq's. Ages are from the frame's stamp to the listener's hand.
"""

import argparse
import math
import os
import selectors
import socket as network
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import zmq

from bench.relay import cpu_of, relay
from tests.support.processes import free_port
from vemlight.runtime import stamps, wire
from vemlight.runtime.open_files import raise_file_limit
from vemlight.runtime.transport import Transport, accept_subscriptions, endpoint, make_keys, read_keys
from vemlight.settings import Wire

FPS, LIGHTS, MAP_SHAPE = 30, 72, (90, 360, 3)
GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + b"\0" + bytes(31)  # ZMTP 3.0, RFC 23
READY = b"\x04\x19\x05READY\x0bSocket-Type\x00\x00\x00\x03SUB"
CONNECT_S = 60.0  # for a thousand handshakes on two cores
LONG, MORE = 2, 1  # flags of a frame


def message(kind: str, sequence: int) -> list[bytes]:
    stamp = stamps.stamp(sequence, sequence / FPS)
    random = np.random.default_rng(0)
    if kind == "map":
        radiance = np.ones(MAP_SHAPE, np.float32)
        none = (np.zeros(0, np.int64), np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
        header = wire.MapMessage(stamp=stamp, rows=MAP_SHAPE[0], cols=MAP_SHAPE[1], coverage="hemisphere")
        return wire.pack(header, (radiance, *none))
    directions = random.normal(size=(LIGHTS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    arrays = (np.arange(LIGHTS), directions, np.ones((LIGHTS, 3)), np.tile([1e-3, 0, 0, 1e-3, 0, 0], (LIGHTS, 1)))
    header = wire.LightsMessage(stamp=stamp, count=LIGHTS, coverage="sphere", soft=True)
    return wire.pack(header, (*arrays, np.zeros((0, 3)), np.zeros((0, 3))))


def publish(settings: Wire, kind: str, bare: bool) -> None:
    """Until it is killed. bare: libzmq's own PUB socket at the same address instead of the service's."""
    raise_file_limit()
    service = "capture" if kind == "map" else "sampler"
    if bare:
        context: Any = zmq.Context()
        publisher = context.socket(zmq.PUB)
        publisher.sndhwm, publisher.backlog = 4, 1024
        publisher.bind(endpoint(settings, service, "publish"))
    else:
        publisher = Transport(settings).bind(service, "publish")
    start_s, sequence = time.monotonic(), 0
    while True:
        time.sleep(max(0, start_s + sequence / FPS - time.monotonic()))
        if not bare:
            accept_subscriptions(publisher)
        publisher.send_multipart(message(kind, sequence))
        sequence += 1


class Listener:
    """One subscriber without libzmq, and the ages of the frames that it was sent, ms."""

    def __init__(self, address: str, kind: str) -> None:
        way, place = address.split("://")
        self.socket = network.socket(network.AF_UNIX if way == "ipc" else network.AF_INET)
        host, _, port = place.rpartition(":")
        self._connect(place if way == "ipc" else (host, int(port)))
        self._kind = kind.encode()
        self.socket.sendall(GREETING)
        self.socket.recv(len(GREETING), network.MSG_WAITALL)
        self.socket.sendall(READY)
        self.socket.recv(self.socket.recv(2, network.MSG_WAITALL)[1], network.MSG_WAITALL)  # the publisher's READY
        self.socket.sendall(b"\x00" + bytes([1 + len(kind)]) + b"\x01" + self._kind)
        self.socket.setblocking(False)
        self._skipped = 0  # bytes of a part that need not be looked at
        self._head, self._is_header = b"", False
        self.ages_ms: list[float] = []

    def _connect(self, place: Any) -> None:
        until = time.monotonic() + 20
        while True:
            try:
                return self.socket.connect(place)
            except OSError:  # a full backlog, as libzmq's own sockets meet
                if time.monotonic() > until:
                    raise
                time.sleep(0.01)

    def take(self) -> None:
        """Reads what has come."""
        data = self.socket.recv(1 << 18)
        now_ns = time.monotonic_ns()
        if not data:
            raise ConnectionError("closed by the publisher")
        if self._skipped >= len(data):
            self._skipped -= len(data)
            return
        data, self._skipped = self._head + data[self._skipped :], 0
        at = 0
        while at + 9 <= len(data):
            flags = data[at]
            size, begin = (int.from_bytes(data[at + 1 : at + 9], "big"), at + 9) if flags & LONG else (data[at + 1], at + 2)
            if self._is_header and len(data) < begin + size:
                break
            part = data[begin : begin + size]
            if self._is_header:
                self.ages_ms.append((now_ns - msgspec.msgpack.decode(part)["stamp"]["monotonic_ns"]) / 1e6)
            self._is_header = flags == MORE and part == self._kind
            at = begin + size
        if at > len(data):
            self._skipped, self._head = at - len(data), b""
        else:
            self._head = data[at:]


def without_keys(count: int, address: str, kind: str, seconds: float) -> list[float]:
    """Ages of all frames of so many listeners, ms."""
    selector = selectors.EpollSelector()
    listeners = [Listener(address, kind) for _ in range(count)]
    for listener in listeners:
        selector.register(listener.socket, selectors.EVENT_READ, listener)
    begin_s = time.monotonic() + 3
    started = False
    while time.monotonic() < begin_s + seconds:
        if not started and time.monotonic() > begin_s:
            started = True
            for listener in listeners:
                listener.ages_ms.clear()
        for key, _ in selector.select(0.1):
            try:
                key.data.take()
            except ConnectionError:  # its missing frames count
                selector.unregister(key.fileobj)
    ages = [age for listener in listeners for age in listener.ages_ms]
    for listener in listeners:
        listener.socket.close()
    return ages


def with_keys(count: int, address: str, keys: Path, seconds: float) -> tuple[list[float], float]:
    """Ages of all frames of so many listeners, ms, once each has had one, or after CONNECT_S; and after how many s that was."""
    context: Any = zmq.Context()
    context.set(zmq.MAX_SOCKETS, 4096)
    poller, pair, waiting = zmq.Poller(), read_keys(keys), set()
    start_s = time.monotonic()
    for _ in range(count):
        socket = context.socket(zmq.SUB)
        socket.linger, socket.curve_serverkey = 0, pair.public
        socket.curve_publickey, socket.curve_secretkey = pair
        socket.subscribe(b"lights")
        socket.connect(address)
        poller.register(socket, zmq.POLLIN)
        waiting.add(socket)
    ages, begin_s = [], math.inf
    while time.monotonic() < begin_s + seconds:
        for socket, _ in poller.poll(100):
            parts = socket.recv_multipart(copy=False)
            waiting.discard(socket)
            if begin_s < time.monotonic():
                stamp = msgspec.msgpack.decode(parts[1].bytes)["stamp"]
                ages.append((time.monotonic_ns() - stamp["monotonic_ns"]) / 1e6)
        if begin_s == math.inf and (not waiting or time.monotonic() > start_s + CONNECT_S):
            begin_s = time.monotonic()
    context.destroy(linger=0)
    return ages, begin_s - start_s


@contextmanager
def publisher(settings: Wire, kind: str, bare: bool) -> Iterator[int]:
    command = [sys.executable, "-m", "bench.fan_out", "--publish", kind, msgspec.json.encode(settings).decode(), str(int(bare))]
    process = subprocess.Popen(command)
    try:
        yield process.pid
    finally:
        process.kill()
        process.wait()


def line(what: str, ages_ms: list[float], count: int, seconds: float, core: float) -> str:
    share = len(ages_ms) / (count * FPS * seconds)
    p50, p99 = np.percentile(ages_ms, [50, 99]) if ages_ms else (np.nan, np.nan)
    return f"{what}: {100 * share:.1f} % of frames, age p50 {p50:.1f} ms, p99 {p99:.1f} ms, publisher {100 * core:.0f} % of a core"


def measure(settings: Wire, kind: str, count: int, seconds: float) -> None:
    service = "capture" if kind == "map" else "sampler"
    for bare in (False, True):
        with publisher(settings, kind, bare) as pid:
            time.sleep(1.5)
            before_s = cpu_of(pid)
            ages = without_keys(count, endpoint(settings, service, "publish"), kind, seconds)
            core = (cpu_of(pid) - before_s) / (seconds + 3)
        name = f"{count} listeners of {kind}, {settings.transport}, {'bare libzmq' if bare else 'the service'}"
        print(line(name, ages, count, seconds, core), flush=True)


def keyed(folder: Path, count: int, seconds: float) -> None:
    """At a relay with keys, whose listeners are libzmq's, in two processes' worth of work."""
    folder = folder / f"keyed_{count}"
    folder.mkdir(0o700)
    make_keys(folder / "keys")
    (folder / "place.toml").write_text(f'[wire]\nfolder = "{folder}"\nkeys = "{folder}/keys"\n')
    with publisher(Wire(folder=str(folder)), "lights", bare=False), relay(folder) as (port, pid):
        before_s = cpu_of(pid)
        ages, connected_s = with_keys(count, f"tcp://127.0.0.1:{port}", folder / "keys", seconds)
        core = (cpu_of(pid) - before_s) / (seconds + connected_s)
    name = f"{count} listeners of lights with keys at a relay, all there after {connected_s:.1f} s"
    print(line(name, ages, count, seconds, core), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lights", type=int, nargs="*", default=[100, 400, 1000])
    parser.add_argument("--maps", type=int, nargs="*", default=[10, 100])
    parser.add_argument("--keyed", type=int, nargs="*", default=[200])
    parser.add_argument("--seconds", type=float, default=10)
    parser.add_argument("--publish", nargs=3, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.publish:
        kind, settings, bare = asked.publish
        publish(msgspec.json.decode(settings, type=Wire), kind, bare == "1")
    raise_file_limit()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as name:
        tcp = Wire(transport="tcp", port=free_port(), insecure=True)
        for settings in (Wire(folder=name), tcp):
            for kind, counts in (("lights", asked.lights), ("map", asked.maps)):
                for count in counts:
                    measure(settings, kind, count, asked.seconds)
        for count in asked.keyed:
            keyed(Path(name), count, asked.seconds)


if __name__ == "__main__":
    main()
