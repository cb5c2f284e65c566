"""Whole processes in lossless mode: each frame once, in order, whatever is killed."""

import os
import random
import signal
from pathlib import Path

import msgspec
import pytest

from tests.support.lights_files import read_lights
from tests.support.processes import LOADED_S, wait_until

CHAIN = ("capture", "sampler", "renderer")


def lines(path: Path) -> int:
    return path.read_bytes().count(b"\n") if path.exists() else 0


def run_chain(services, path: Path, out: Path, kills=()) -> None:
    """Runs the three services until the last is done; each of `kills` is (service, when that many pictures are there)."""
    running = {name: services.start(f"vemlight.{name}", str(path)) for name in CHAIN}
    for name, pictures in kills:
        wait_until(lambda pictures=pictures: lines(out / "manifest.jsonl") >= pictures, f"picture {pictures}")
        os.kill(running[name].pid, signal.SIGKILL)
        assert running[name].wait() == -signal.SIGKILL, f"{name} had ended before it could be killed"
        running[name] = services.start(f"vemlight.{name}", str(path))
    _, errors = running["renderer"].communicate(timeout=LOADED_S)
    assert running["renderer"].returncode == 0, errors.decode()
    for name in ("capture", "sampler"):
        running[name].send_signal(signal.SIGTERM)
        assert running[name].wait(timeout=10) == 0


@pytest.fixture(scope="module")
def undisturbed():
    """What a run without kills gave, filled by the first test that has one."""
    return {}


def outputs(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in out.iterdir()}


KILLS = (("sampler", 3), ("capture", 5), ("renderer", 7), ("sampler", 9), ("renderer", 11))  # each service early and late, in any order


@pytest.mark.parametrize("kills", [(), KILLS], ids=["undisturbed", "killed"])
def test_lossless_gives_each_frame_once_and_the_same_bytes_whatever_is_killed(kills, make_settings, services, tmp_path, undisturbed):
    out = tmp_path / "out"
    _, path = make_settings(mode="lossless", out=str(out))
    run_chain(services, path, out, kills)
    assert [row.sequence for row in read_lights(out / "lights.jsonl")] == list(range(16))
    manifest = [msgspec.json.decode(line) for line in (out / "manifest.jsonl").read_bytes().splitlines()]
    assert [entry["sequence"] for entry in manifest[1:-1]] == list(range(16))
    assert manifest[-1]["pictures"] == 16
    seen = outputs(out)
    assert {f"frame_{k:04d}.{kind}" for k in range(16) for kind in ("exr", "png")} | {
        "lights.jsonl",
        "manifest.jsonl",
        "contact.png",
    } == seen.keys()
    if not undisturbed:
        undisturbed.update(seen)
    assert seen == undisturbed
    assert not list((tmp_path / "sockets").iterdir()), "a socket file was left"


def test_random_bytes_at_every_socket_disturb_nothing(make_settings, services, tmp_path, undisturbed):
    import socket

    import zmq

    out = tmp_path / "out"
    settings, path = make_settings(mode="lossless", out=str(out))
    junk = random.Random(5)
    running = {name: services.start(f"vemlight.{name}", str(path)) for name in CHAIN}
    wait_until(lambda: lines(out / "manifest.jsonl") >= 2, "picture 2")
    context = zmq.Context()
    for file in sorted(Path(settings.wire.folder).glob("*.[sp]*e*")):
        if file.suffix == ".lock":
            continue
        with socket.socket(socket.AF_UNIX) as raw:
            raw.connect(str(file))
            raw.sendall(junk.randbytes(4000))
        peer = context.socket(zmq.DEALER if "serve" in file.name else zmq.SUB)
        peer.connect(f"ipc://{file}")
        if "serve" in file.name:
            for size in (0, 1, 50, 70_000):
                peer.send_multipart([junk.randbytes(size) for _ in range(junk.randint(1, 9))])
        else:
            for _ in range(200):
                peer.subscribe(junk.randbytes(30))
    _, errors = running["renderer"].communicate(timeout=LOADED_S)
    context.destroy(linger=0)
    assert running["renderer"].returncode == 0, errors.decode()
    assert [row.sequence for row in read_lights(out / "lights.jsonl")] == list(range(16))
    assert not undisturbed or outputs(out) == undisturbed
