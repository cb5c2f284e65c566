"""`vemlight run` of a rig of cameras, between processes that speak over tcp with keys: each camera killed in turn, and a spare for it."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import tomli_w
import zmq

from tests.support.processes import LOADED_S, children, vemlight
from vemlight.light.images import write_exr
from vemlight.runtime import wire
from vemlight.runtime.service_stats import LossCounter
from vemlight.runtime.transport import Transport, make_keys

NAMES: tuple[str, ...] = ("a", "b", "c")
FPS = 6.0


@pytest.fixture
def rig(tmp_path, run):
    """Settings and process of a run of three cameras that are replayed."""
    for c, name in enumerate(NAMES):
        (tmp_path / name).mkdir()
        for k in range(4):
            image = np.full((8, 16, 3), 0.25, np.float32)
            image[2, (3 * k + c) % 16] = 50
            write_exr(tmp_path / name / f"f_{k}.exr", image)
    cameras = [{"name": name, "source": name, "at": [c, 0, 1]} for c, name in enumerate(NAMES)]
    (tmp_path / "rig.toml").write_text(tomli_w.dumps({"camera": cameras}))
    make_keys(tmp_path / "keys")
    first = 20_000 + os.getpid() % 400 * 24
    ports = {f"capture.{name}": first + 14 + 2 * c for c, name in enumerate(NAMES)}
    return run(
        rig={"file": str(tmp_path / "rig.toml")}, capture={"source": "", "rows": 8, "cols": 32, "fps": FPS},
        wire={"transport": "tcp", "keys": str(tmp_path / "keys"), "port": first, "ports": ports},
    )  # fmt: skip


class Cameras:
    """What each capture publishes, and fuse: how many frames were lost on the way, and the newest statuses and reports."""

    def __init__(self, settings) -> None:
        self._transport = Transport(settings.wire)
        self._sockets = {name: self._transport.subscribe(f"capture.{name}", "map", "status") for name in NAMES}
        self._sockets["fuse"] = self._transport.subscribe("fuse", "points")
        self._names = {socket: name for name, socket in self._sockets.items()}
        self._losses = {name: LossCounter() for name in NAMES}
        self.numbers: dict[str, list[int]] = {name: [] for name in self._sockets}
        self.restarts = dict.fromkeys(NAMES, -1)
        self.cameras: list[int] = []

    def until(self, true, what: str) -> None:
        """Takes what comes until `true` holds; seven processes start and compile meanwhile."""
        until_s = time.monotonic() + 3 * LOADED_S
        while not true():
            assert time.monotonic() < until_s, what
            for socket in zmq.select(list(self._names), [], [], 0.1)[0]:
                self._take(self._names[socket], wire.unpack(socket.recv_multipart())[0])

    def _take(self, name: str, header) -> None:
        if isinstance(header, wire.StatusMessage):
            self.restarts[name] = header.restarts
            self._losses[name].on_status(header.frames)
            return
        self.numbers[name].append(header.stamp.sequence)
        if isinstance(header, wire.PointsMessage):
            self.cameras.append(header.report.cameras)
        else:
            self._losses[name].on_frame()

    def lost(self, name: str) -> int:
        return self._losses[name].dropped

    def more(self, name: str, count: int) -> None:
        wanted = len(self.numbers[name]) + count
        self.until(lambda: len(self.numbers[name]) >= wanted, f"frames of {name}")

    def close(self) -> None:
        self._transport.close()


def test_each_camera_is_killed_in_turn_and_the_others_lose_nothing(rig):
    settings, process = rig
    seen = Cameras(settings)
    try:
        seen.until(lambda: 3 in seen.cameras, "a moment of three cameras")
        for killed in NAMES:
            seen.until(LoadedSpare(process.pid), "a spare that has loaded")
            before, restarts = children(process.pid), dict(seen.restarts)
            os.kill(before[f"capture.{killed}"], signal.SIGKILL)
            seen.until(lambda killed=killed: seen.restarts[killed] == 1, "its return")
            for name in (killed, "fuse"):
                seen.more(name, 6)
            after = children(process.pid)
            assert after[f"capture.{killed}"] == before["runtime.spare"], "the spare has taken its place and name"
            for name in set(NAMES) - {killed}:
                assert after[f"capture.{name}"] == before[f"capture.{name}"]
                assert seen.restarts[name] == restarts[name]
                assert seen.lost(name) <= 0.1 * len(seen.numbers[name]), "what a busy machine costs this listener, and no more"
            assert after["fuse"] == before["fuse"]
        assert np.percentile(seen.cameras[seen.cameras.index(3) :], 10) >= 2, "a busy machine may hold up another one for a moment"
        health = vemlight("health", "capture.b", str(Path(settings.rig.file).with_name("vemlight.toml")))
        assert (health.returncode, health.stdout.split(":")[1]) == (0, " capture.b")
    finally:
        seen.close()
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=20) == 0


class LoadedSpare:
    """Whether a run has a spare that waits for its standard input: it has used no processor time for half a second."""

    def __init__(self, run: int) -> None:
        self._run, self._used, self._since_s = run, [""], time.monotonic()

    def __call__(self) -> bool:
        spare = children(self._run).get("runtime.spare")
        used = Path(f"/proc/{spare}/stat").read_text().rpartition(")")[2].split()[11:13] if spare else [""]
        if used != self._used:
            self._used, self._since_s = used, time.monotonic()
        return used != [""] and time.monotonic() > self._since_s + 0.5
