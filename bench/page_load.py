"""The viewer with many pages: python -m bench.page_load [--pages 50] [--seconds 20]

Services that only publish, 30 frames a second: maps of 90 x 360, 72 soft lights, pictures of 640 x 480. Readers that behave as the page
does: they name what they have shown at the next of 60 frames a second. Printed: the viewer's processor time as a share of a core, bytes a
second of a page, and ages from the stamp of a picture, which carries its number in blocks, to the reader's hand. Then tabs that stall:
how much memory the viewer has more, and when it has ended their connections.
"""

import argparse
import asyncio
import os
import re
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, cast
from urllib.request import urlopen

import cv2
import numpy as np

from tests.support.processes import free_port
from vemlight.capture.source import open_source
from vemlight.capture.stage import map_message
from vemlight.runtime import stamps, wire
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.supervise import QUIET_BLAS
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Capture, Wire
from vemlight.viewer.web import BINARY_FEEDS

FPS, LIGHTS, WIDTH, HEIGHT = 30, 72, 640, 480
BLOCK, BITS = 16, 20  # pixels of a block's side; blocks in the first row, the lowest bit first: a frame's number
FRAME_S = 1 / 60  # of a browser
READ_OF = 10  # of so many pages one decodes its pictures
STALLED, STALL_S = 10, 30.0  # tabs that read nothing, and how long they are watched
PAGE = "summary,placed-lights.bin,levels,disc,picture"  # the feeds that viewer.js asks for
KEY = "dmVtbGlnaHQgcGFnZSAxNg=="  # of the opening handshake: any sixteen bytes
HANDSHAKE = (
    f"GET /ws?feeds={PAGE} HTTP/1.1\r\nHost: 127.0.0.1:{{}}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    f"Sec-WebSocket-Key: {KEY}\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


def publish(folder: Path) -> None:
    """Capture, sampler and renderer that only publish, until they are killed."""
    transport = Transport(Wire(folder=str(folder)))
    makers = ("capture", "sampler", "renderer")
    publishers = {service: transport.bind(service, "publish") for service in makers}
    stats = {service: ServiceStats(service, 0) for service in makers}
    made: dict[str, Any]
    source, random = open_source(Capture()), np.random.default_rng(0)
    frames = [source.frame(k) for k in range(8)]
    directions = random.normal(size=(LIGHTS, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    light = np.tile(np.array([1e-3, 0, 0, 1e-3, 0, 0], np.float32), (LIGHTS, 1))
    lights = (np.arange(LIGHTS), directions, random.random((LIGHTS, 3), np.float32), light, directions[:0], directions[:0])
    photograph = cv2.imread(str(Path(__file__).parents[1] / "docs" / "pictures" / "bundled.jpg"))
    assert photograph is not None
    picture = np.dstack([cv2.resize(photograph, (WIDTH, HEIGHT)), np.full((HEIGHT, WIDTH), 255, np.uint8)])
    start_s, sequence = time.monotonic(), 0
    while True:
        time.sleep(max(0, start_s + sequence / FPS - time.monotonic()))
        for bit in range(BITS):
            picture[:BLOCK, bit * BLOCK : (bit + 1) * BLOCK, :3] = 255 * (sequence >> bit & 1)
        stamp = stamps.stamp(sequence, sequence / FPS)
        print(sequence, time.monotonic(), flush=True)
        made = {
            "capture": map_message(frames[sequence % len(frames)], stamp),
            "sampler": (wire.LightsMessage(stamp=stamp, count=LIGHTS, coverage="hemisphere", soft=True), lights),
            "renderer": (wire.ImageMessage(stamp=stamp, width=WIDTH, height=HEIGHT), (picture,)),
        }
        for service in makers:
            accept_subscriptions(publishers[service])
            publishers[service].send_multipart(wire.pack(*made[service]))
            stats[service].on_finished(made[service], 0.004)
            if status := stats[service].status_if_due():
                publishers[service].send_multipart(wire.pack(status))
        sequence += 1


class Page(asyncio.Protocol):
    """A reader: counts bytes and messages, and keeps when which picture came."""

    def __init__(self, port: int, decodes: bool, stalls: bool = False) -> None:
        self.bytes, self.messages, self.pictures, self.ended = 0, 0, [], False
        self._port, self._decodes, self._stalls = port, decodes, stalls
        self._data, self._open, self._names = bytearray(), False, []

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._transport.write(HANDSHAKE.format(self._port).encode())

    def connection_lost(self, exc: Exception | None) -> None:
        self.ended = True

    def data_received(self, data: bytes) -> None:
        self.bytes += len(data)
        self._data += data
        if not self._open and (end := self._data.find(b"\r\n\r\n")) >= 0:
            del self._data[: end + 4]
            self._open = True
            if self._stalls:
                self._transport.pause_reading()
        while self._open and self._take_frame():
            pass

    def _take_frame(self) -> bool:
        if len(self._data) < 2:
            return False
        length, start = self._data[1] & 127, 2
        if length >= 126:
            size, form = (2, ">H") if length == 126 else (8, ">Q")
            if len(self._data) < 2 + size:
                return False
            (length,), start = struct.unpack_from(form, self._data, 2), 2 + size
        if len(self._data) < start + length:
            return False
        payload = bytes(self._data[start : start + length])
        opcode = self._data[0] & 15
        del self._data[: start + length]
        if opcode == 9:
            self._send(10, payload)
        elif opcode in (1, 2):
            self.messages += 1
            self._take(opcode, payload)
        return True

    def _take(self, opcode: int, payload: bytes) -> None:
        name = next(name for name, first in BINARY_FEEDS.items() if first == payload[0]) if opcode == 2 else "summary"
        if name == "picture" and self._decodes:
            self.pictures.append((time.monotonic(), payload[1:]))
        if not self._names:
            asyncio.get_running_loop().call_later(FRAME_S, self._acknowledge)
        self._names.append(name)

    def _acknowledge(self) -> None:
        if not self._transport.is_closing():
            self._send(1, ",".join(self._names).encode())
        self._names.clear()

    def _send(self, opcode: int, payload: bytes) -> None:
        self._transport.write(bytes([128 | opcode, 128 | len(payload), 0, 0, 0, 0]) + payload)  # masked by zeros


def number_of(jpeg: bytes) -> int:
    """The frame's number that its picture carries."""
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    row = picture[BLOCK // 2, BLOCK // 2 : BITS * BLOCK : BLOCK]
    return int(((row > 127) << np.arange(BITS)).sum())


def processor_s(pid: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def totals(viewer: int, pages: list[Page]) -> tuple[float, int, int, float]:
    """Processor time, bytes and messages so far, and when that is."""
    return processor_s(viewer), sum(page.bytes for page in pages), sum(page.messages for page in pages), time.monotonic()


async def open_pages(port: int, count: int, stalls: bool = False) -> list[Page]:
    pages = [Page(port, k % READ_OF == 0, stalls) for k in range(count)]
    for page in pages:
        await asyncio.get_running_loop().create_connection(lambda page=page: page, "127.0.0.1", port)
    return pages


async def load(port: int, viewer: int, count: int, seconds: float, published: Path) -> None:
    """Prints what `count` pages cost the viewer."""
    pages = await open_pages(port, count)
    await asyncio.sleep(3)
    for page in pages:
        page.pictures.clear()
    before = totals(viewer, pages)
    await asyncio.sleep(seconds)
    share_s, sent, messages, took_s = (now - then for now, then in zip(totals(viewer, pages), before, strict=True))
    made_s = {int(line.split()[0]): float(line.split()[1]) for line in published.read_text().splitlines()}
    ages_ms = [1e3 * (at_s - made_s[number_of(jpeg)]) for page in pages for at_s, jpeg in page.pictures]
    p50, p99 = np.percentile(ages_ms, [50, 99])
    rate = len(ages_ms) / len([page for page in pages if page.pictures]) / took_s
    each_us, each_hz = 1e6 * share_s / max(messages, 1), messages / took_s / count
    print(f"{count} pages: {share_s / took_s:.1%} of a core, {each_us:.0f} us a message of {each_hz:.0f} a second for each;")
    print(f"  {sent / took_s / count / 1e3:.0f} kB/s and {rate:.1f} pictures a second for each, age p50 {p50:.1f} ms, p99 {p99:.1f} ms")


async def stall(port: int, viewer: int) -> None:
    """Prints what tabs that read nothing cost."""
    before_mb, highest_mb = resident_mb(viewer), 0.0
    await open_pages(port, STALLED, stalls=True)
    start_s, pages = time.monotonic(), STALLED
    while pages and time.monotonic() - start_s < STALL_S:
        await asyncio.sleep(0.5)
        highest_mb = max(highest_mb, resident_mb(viewer) - before_mb)
        with urlopen(f"http://127.0.0.1:{port}/metrics") as answer:
            pages = round(float(re.findall(rb"^vemlight_pages (.*)$", answer.read(), re.M)[0]))
    took_s = time.monotonic() - start_s
    print(f"{STALLED} stalled tabs: {highest_mb / STALLED:.1f} MB more for each; {pages} still open after {took_s:.0f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pages", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=20)
    asked, port = parser.parse_args(), free_port()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        settings, published = folder / "vemlight.toml", folder / "published"
        settings.write_text(f'[wire]\nfolder = "{folder}/sockets"\n[viewer]\nport = {port}\n')
        source = f"from pathlib import Path; from bench.page_load import publish; publish(Path('{folder}/sockets'))"
        with open(published, "w") as file:
            made = subprocess.Popen([sys.executable, "-c", source], stdout=file)
        command = [sys.executable, "-m", "vemlight.viewer", str(settings)]
        viewer = subprocess.Popen(command, stdout=subprocess.PIPE, env=os.environ | QUIET_BLAS)
        try:
            assert viewer.stdout
            viewer.stdout.readline()
            while published.stat().st_size < 500:  # some seconds of frames: the first takes compiled code
                time.sleep(0.5)
            for count in (1, asked.pages):
                asyncio.run(load(port, viewer.pid, count, asked.seconds, published))
            asyncio.run(stall(port, viewer.pid))
        finally:
            for process in (viewer, made):
                process.kill()
                process.wait()


if __name__ == "__main__":
    main()
