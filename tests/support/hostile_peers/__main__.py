"""Attacks services with peers that have the keys and mean harm, and prints what each attack costs.

    python -m tests.support.hostile_peers [--transport ipc|tcp|curve] [NAME ...]

A line for each attack: the largest memory of the service that it attacks, above what it had; whether it lived; when the attacker was cut;
the longest time between two frames at a subscriber that behaves, or when the first came after the attack.
"""

import argparse
import contextlib
import http.client
import itertools
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple
from urllib.request import Request, urlopen

import tomli_w
import zmq

from tests.support.hostile_peers.page_attacks import PAGE_ATTACKS
from tests.support.hostile_peers.wire_attacks import ATTACKS, Attack
from tests.support.processes import free_port
from tests.support.viewer_process import SimulatedServices
from vemlight.runtime import wire
from vemlight.runtime.channels import FRAMES, Service
from vemlight.runtime.demand import Pull
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.session import SESSION, make_session
from vemlight.runtime.transport import Transport, make_keys
from vemlight.settings import Settings, Wire
from vemlight.settings_file import read_settings
from vemlight.viewer.authentication import cookie_of

START_S = 20.0
AFTER_S = 5.0  # for frames to come again after an attack


class Cost(NamedTuple):
    """What an attack cost."""

    memory_mb: float  # most, above what the service had before
    lived: bool
    cut_s: float | None
    longest_gap_s: float  # between two frames at an honest peer
    lines: int  # printed by the service
    frames: int


def settings_file(folder: Path, transport: str, mode: str) -> Path:
    """Settings of a target in a folder of its own."""
    folder.chmod(0o700)
    wire_: dict[str, object] = {"folder": str(folder)}
    if transport != "ipc":
        wire_ |= {"transport": "tcp", "port": free_port() // 10 * 10, "insecure": transport == "tcp"}
    if transport == "curve":
        make_keys(folder / "keys")
        wire_["keys"] = str(folder / "keys")
    file = folder / "vemlight.toml"
    file.write_text(tomli_w.dumps({"mode": mode, "wire": wire_}))
    return file


class Target:
    """The service that is attacked, its memory, and its lines."""

    def __init__(self, file: Path, service: Service, files: int) -> None:
        """Uploads go to the folder of the settings."""
        make_session(session := file.parent / "session")
        environment = os.environ | {SESSION: str(session)}
        module = ["vemlight.viewer", str(file)] if service == "viewer" else ["tests.support.hostile_peers.targets", str(file), service]

        def limit() -> None:
            if files:
                resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))

        self._log = tempfile.TemporaryFile()  # noqa: SIM115, closed with this object
        self.process = subprocess.Popen(
            [sys.executable, "-m", *module], stderr=self._log, stdout=subprocess.DEVNULL, env=environment, preexec_fn=limit
        )
        self.most = 0
        self._said: bytes | None = None
        self._watching = threading.Thread(target=self._watch, daemon=True)
        self._watching.start()

    def memory(self) -> int:
        """Bytes of its own memory."""
        try:
            _, resident, shared = Path(f"/proc/{self.process.pid}/statm").read_text().split()[:3]
        except OSError:
            return 0
        return (int(resident) - int(shared)) * resource.getpagesize()

    def _watch(self) -> None:
        while self.process.poll() is None:
            self.most = max(self.most, self.memory())
            time.sleep(0.01)

    def end(self) -> bytes:
        """Its lines."""
        if self._said is None:
            if self.process.poll() is None:
                self.process.terminate()
            self.process.wait()
            self._log.seek(0)
            self._said = self._log.read()
        return self._said


class HonestPeer(threading.Thread):
    """Takes a service's frames as they come, by subscription or, in lossless mode, by request."""

    def __init__(self, settings: Settings, service: Service) -> None:
        super().__init__(daemon=True)
        self.came_s: list[float] = []
        self._settings, self._ended = settings, False
        self._service: Service = service

    def run(self) -> None:
        transport = Transport(self._settings.wire)
        stats, due = ServiceStats("viewer", 0), 0
        if self._settings.mode == "lossless":
            pull = Pull(transport.request_from(self._service), FRAMES[self._service].kind, stats)
            while not self._ended:
                if pull.frame(due):
                    due += 1
                    self.came_s.append(time.monotonic())
                    time.sleep(0.01)
                else:
                    pull.socket.poll(20)
        else:
            socket = transport.subscribe(self._service, "map" if self._service == "capture" else "lights")
            while not self._ended:
                if socket.poll(50):
                    wire.unpack(socket.recv_multipart(zmq.NOBLOCK))
                    self.came_s.append(time.monotonic())
        transport.close()

    def wait_for(self, frames: int, seconds: float) -> bool:
        until_s = time.monotonic() + seconds
        while len(self.came_s) < frames and time.monotonic() < until_s:
            time.sleep(0.02)
        return len(self.came_s) >= frames

    def end(self) -> None:
        self._ended = True
        if self.ident:
            self.join()


def cost_of(name: str, transport: str) -> Cost:
    """Runs one attack."""
    attack = ATTACKS[name]
    with tempfile.TemporaryDirectory() as folder:
        file = settings_file(Path(folder), transport, attack.mode)
        settings = read_settings(file)
        service: Service = "sampler" if attack.poses_as_capture else "capture"
        target = Target(file, service, attack.files)
        honest = HonestPeer(settings, service)
        try:
            return _cost(name, attack, file, target, honest)
        finally:
            honest.end()
            target.end()


def _cost(name: str, attack: Attack, file: Path, target: Target, honest: HonestPeer) -> Cost:
    honest.start()
    if attack.poses_as_capture:
        time.sleep(1.5)
    elif not honest.wait_for(10, START_S):
        raise SystemExit(f"{target.end().decode()}\n{name}: the target does not start")
    before, target.most = target.memory(), 0
    began_s = time.monotonic()
    attacker = subprocess.run([sys.executable, "-m", __spec__.name, "--attack", name, str(file)], stdout=subprocess.PIPE, check=False)
    cut_s = json.loads(attacker.stdout or b"null")
    ended_s = time.monotonic()
    most = target.most
    capture = None
    if attack.poses_as_capture:
        (file.parent / "capture.publish").unlink(missing_ok=True)
        began_s = ended_s
        capture = Target(file, "capture", 0)
    come = len(honest.came_s)
    honest.wait_for(come + 5, AFTER_S)
    lived = target.process.poll() is None
    if capture:
        capture.end()
    times = [began_s, *(t for t in honest.came_s if t > began_s), time.monotonic()]
    gap = max(b - a for a, b in itertools.pairwise(times))
    honest.end()
    lines = target.end().decode().splitlines()
    for line in lines[:6]:
        print(f"    {line[:200]}")
    return Cost((most - before) / 1e6, lived, cut_s, gap, len(lines), len(times) - 2)


class HonestPage(threading.Thread):
    """Asks for the viewer's health again and again, each time by a new connection."""

    def __init__(self, port: int, token: str) -> None:
        super().__init__(daemon=True)
        self.came_s: list[float] = []
        self._url, self._ended = f"http://127.0.0.1:{port}/metrics", False
        self._headers = {"Cookie": f"vemlight-{port}={cookie_of(token)}"} if token else {}

    def run(self) -> None:
        while not self._ended:
            with contextlib.suppress(OSError, http.client.HTTPException), urlopen(Request(self._url, headers=self._headers), timeout=2.0):
                self.came_s.append(time.monotonic())
            time.sleep(0.05)

    def end(self) -> None:
        self._ended = True
        self.join()


def page_cost_of(name: str) -> Cost:
    """Runs one attack on the page of a viewer that may have 1,024 files open."""
    token = "a-token-of-letters" if name == "wrong tokens" else ""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o700)
        file, port = Path(folder) / "vemlight.toml", free_port()
        file.write_text(tomli_w.dumps({"wire": {"folder": folder}, "viewer": {"port": port, "token": token}}))
        services = SimulatedServices(Wire(folder=folder))
        services.start()
        target, honest = Target(file, "viewer", 1024), HonestPage(port, token)
        honest.start()
        until_s = time.monotonic() + START_S
        while len(honest.came_s) < 5 and time.monotonic() < until_s:
            time.sleep(0.05)
        before, target.most, began_s = target.memory(), 0, time.monotonic()
        command = [sys.executable, "-m", __spec__.name, "--page-attack", name, str(port)]
        attacker = subprocess.run(command, stdout=subprocess.PIPE, check=False)
        time.sleep(1.0)
        honest.end()
        lived, most = target.process.poll() is None, target.most
        times = [began_s, *(t for t in honest.came_s if t > began_s), time.monotonic()]
        services.end()
        lines = target.end().decode().splitlines()
    for line in lines[:4]:
        print(f"    {line[:200]}")
    gap_s = max(b - a for a, b in itertools.pairwise(times))
    return Cost((most - before) / 1e6, lived, json.loads(attacker.stdout or b"null"), gap_s, len(lines), len(times) - 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--transport", choices=("ipc", "tcp", "curve"), default="ipc")
    parser.add_argument("--attack", nargs=2, metavar=("NAME", "SETTINGS"), help=argparse.SUPPRESS)
    parser.add_argument("--page-attack", nargs=2, metavar=("NAME", "PORT"), help=argparse.SUPPRESS)
    parser.add_argument("names", nargs="*", metavar="NAME", help="; ".join([*ATTACKS, *PAGE_ATTACKS]))
    given = parser.parse_args()
    if given.page_attack:
        print(json.dumps(PAGE_ATTACKS[given.page_attack[0]](int(given.page_attack[1]))))
        return
    if given.attack:
        print(json.dumps(ATTACKS[given.attack[0]].run(read_settings(Path(given.attack[1])))))
        return
    for name in given.names or [*ATTACKS, *PAGE_ATTACKS]:
        if name in PAGE_ATTACKS:
            _print("page", name, page_cost_of(name))
        elif given.transport != "curve" or ATTACKS[name].with_keys:
            _print(given.transport, name, cost_of(name, given.transport))


def _print(where: str, name: str, cost: Cost) -> None:
    cut = "not cut" if cost.cut_s is None else f"cut after {cost.cut_s:.2f} s"
    print(
        f"{where:5} {name:38} {cost.memory_mb:7.0f} MB  {'lived' if cost.lived else 'DIED':5}  {cut:18} "
        f"longest gap {cost.longest_gap_s:5.2f} s  {cost.frames:4} frames  {cost.lines} lines",
        flush=True,
    )


if __name__ == "__main__":
    main()
