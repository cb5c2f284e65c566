"""The viewer as a process, and a thread that stands in for capture, sampler and renderer."""

import json
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import zmq

from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.runtime import stamps, wire
from vemlight.runtime.channels import Service
from vemlight.runtime.poses import Pose
from vemlight.runtime.reports import ImageReport, LightsReport, MapReport
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Wire

MAKERS: tuple[Service, ...] = ("capture", "sampler", "renderer")
FPS = 25.0
OBJECTS = (
    Pose(name="box", position=(1.0, 0.0, 0.5)),
    Pose(name="lamp", position=(0.0, 0.0, 2.0), rotation=(1.0, 0.0, 0.0, 0.0), power=1.0),
)
PATIENCE_S = 20.0  # for what a loaded machine does late; a test that passes waits for none of it


def eventually(found, what: str, patience_s: float = PATIENCE_S):
    """The first true value of `found`."""
    give_up_s = time.monotonic() + patience_s
    while not (value := found()):
        assert time.monotonic() < give_up_s, f"{what}: not within {patience_s} s"
        time.sleep(0.05)
    return value


def frames_of(sequence: int, count: int = 72) -> dict[Service, wire.Message]:
    """One frame of each service: a bright spot that goes round, as many lights as wanted, a picture with a bar that moves."""
    stamp = stamps.stamp(sequence, sequence / FPS)
    radiance = np.full((18, 72, 3), (0.3, 0.5, 0.9), np.float32)
    radiance[6, sequence % 72] = 500.0
    phi = 2 * np.pi * (np.arange(count) / count + sequence / 720)
    theta = np.linspace(0.1, 1.4, count)
    directions = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1).astype(np.float32)
    irradiance = np.outer(1 + np.arange(count) % 3, (1.0, 0.9, 0.7)).astype(np.float32)
    pixels = np.full((48, 64, 4), 255, np.uint8)
    pixels[:, sequence % 64] = (255, 0, 0, 255)
    return {
        "capture": (
            wire.MapMessage(stamp=stamp, rows=18, cols=72, coverage="hemisphere", report=MapReport(saturated_pixels=3)),
            (radiance, *NO_BRIGHT_CELLS),
        ),
        "sampler": (
            wire.LightsMessage(stamp=stamp, count=count, coverage="hemisphere", report=LightsReport(delay_ms=160.0)),
            (np.arange(count), directions, irradiance, directions[:0], irradiance[:0]),
        ),
        "renderer": (
            wire.ImageMessage(
                stamp=stamp, width=64, height=48, objects=OBJECTS, report=ImageReport(drawn_lights=count, render_ms=5.0)
            ),
            (pixels,),
        ),
    }


class SimulatedServices(threading.Thread):
    """Capture, sampler and renderer in one thread: each publishes frames and statuses while in `publishing`. Receives the controls."""

    def __init__(self, settings: Wire, frames=frames_of, makers: tuple[Service, ...] = MAKERS) -> None:
        super().__init__(daemon=True)
        self._makers = makers
        self.publishing: set[Service] = set(makers)
        self.controls: list[wire.ControlMessage] = []
        self.viewers: list[wire.StatusMessage] = []
        self.scene: wire.Message | None = None  # sent to each who subscribes to it
        self.noise: list[list[bytes]] = []  # published once by the renderer
        self._settings, self._frames, self._stop_asked = settings, frames, threading.Event()

    def run(self) -> None:
        transport = Transport(self._settings)
        publishers = {service: transport.bind(service, "publish") for service in self._makers}
        stats = {service: ServiceStats(service, 0) for service in self._makers}
        viewer = transport.subscribe("viewer", "control", "status")
        sequence = 0
        while not self._stop_asked.wait(1 / FPS):
            count = next((control.count for control in reversed(self.controls) if control.count), 72)
            made = self._frames(sequence, count)
            sequence += 1
            for service in self._makers:
                if "scene" in accept_subscriptions(publishers[service]) and self.scene:
                    publishers[service].send_multipart(wire.pack(*self.scene))
                if service in self.publishing:
                    stats[service].on_finished(made[service], 0.004)
                    publishers[service].send_multipart(wire.pack(*made[service]))
                    if status := stats[service].status_if_due():
                        publishers[service].send_multipart(wire.pack(status))
            if self.noise:  # one at a time: a queue holds four
                publishers["renderer"].send_multipart(self.noise.pop())
            while viewer.poll(0, zmq.POLLIN):
                header, _ = wire.unpack(viewer.recv_multipart())
                if isinstance(header, wire.ControlMessage):
                    self.controls.append(header)
                elif isinstance(header, wire.StatusMessage):
                    self.viewers.append(header)
        transport.close()

    def end(self) -> None:
        self._stop_asked.set()
        self.join()


class ViewerProcess:
    """The viewer's process, on a free port unless one is given."""

    def __init__(self, folder: Path, port: int | None = None, top: str = "", more: str = "") -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = port or free.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"
        self.settings = folder / "vemlight.toml"
        self.settings.write_text(f'{top}\n[wire]\nfolder = "{folder}"\n[viewer]\nport = {self.port}\n{more}\n')
        command = [sys.executable, "-m", "vemlight.viewer", str(self.settings)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def first_line(self) -> str:
        """Its first line: it listens now."""
        assert self.process.stdout
        return self.process.stdout.readline()

    def get(self, path: str, body: bytes | None = None, **headers: str) -> tuple[int, bytes]:
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        try:
            with urlopen(Request(self.url + path, body, named), timeout=PATIENCE_S) as answer:
                return answer.status, answer.read()
        except HTTPError as error:
            return error.code, error.read()

    def health(self) -> dict:
        return json.loads(self.get("/healthz")[1])

    def state(self, service: Service) -> str:
        return next(row["state"] for row in self.health()["services"] if row["service"] == service)

    def choose(self, **choices) -> tuple[int, bytes]:
        return self.get("/control", json.dumps(choices).encode(), Content_Type="application/json")

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()
