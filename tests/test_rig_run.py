"""`vemlight run` of a rig of cameras, between processes that speak over tcp with keys: each camera killed in turn, and a spare for it."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from tests.support.processes import children, vemlight
from tests.support.rig_listener import LoadedSpare, RigListener
from vemlight.light.images import write_exr
from vemlight.runtime.transport import make_keys

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


def test_each_camera_is_killed_in_turn_and_the_others_lose_nothing(rig):
    settings, process = rig
    seen = RigListener(settings, NAMES)
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
