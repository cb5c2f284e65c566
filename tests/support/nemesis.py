"""Kills and stops the processes of a lossless run at random moments until it is done, and compares its output with an undisturbed one.

python -m tests.support.nemesis [--frames 1000] [--pictures 40] [--seed 0] [--cameras 1] [--folder DIR]
"""

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import tomli_w

from tests.support.processes import children, free_port
from vemlight.light.images import write_exr

SKIES = 16  # different frames; a longer sequence links to them
KILL = 0.6  # fraction of kills; the others are stops
SUPERVISOR = 0.1  # fraction of what is done to the supervisor, and not to a service
STOP_S = (0.05, 1.0)  # how long something is stopped
EARLY, EARLY_S = 0.25, (0.0, 2.0)  # fraction of strikes that do not wait for pictures, and for how long they wait
LINE_BYTES = 480  # of a picture in the manifest


def write_sequence(folder: Path, frames: int, camera: int = 0) -> None:
    """Frames of 8 x 16: a sun walks through a sky and flickers; another sky for each camera."""
    folder.mkdir()
    rng = np.random.default_rng(camera)
    for k in range(min(SKIES, frames)):
        sky = rng.uniform(0.1, 1.0, (8, 16, 3)).astype(np.float32)
        sky[2, k] += 300
        write_exr(folder / f"sky_{k:06d}.exr", sky)
    for k in range(SKIES, frames):
        (folder / f"sky_{k:06d}.exr").hardlink_to(folder / f"sky_{k % SKIES:06d}.exr")


def write_input(folder: Path, frames: int, cameras: int) -> None:
    """Settings and sequences: one, or that of each camera of a rig."""
    content = {
        "capture": {"source": "" if cameras > 1 else "sequence", "rows": 6, "cols": 24},
        "sampler": {"count": 12},
        "renderer": {"width": 64, "height": 48, "shadow_map": 64},
        "viewer": {"port": free_port()},
    }
    if cameras > 1:
        rig = [{"name": f"c{k}", "source": f"sequence-{k}", "at": [float(k), 0.0, 1.0]} for k in range(cameras)]
        (folder / "rig.toml").write_text(tomli_w.dumps({"camera": rig}))
        content["rig"] = {"file": "rig.toml"}
    (folder / "vemlight.toml").write_text(tomli_w.dumps(content))
    for k in range(cameras):
        write_sequence(folder / (f"sequence-{k}" if cameras > 1 else "sequence"), frames, k)


def start(settings: Path, out: Path, log: Path) -> subprocess.Popen[bytes]:
    with open(log, "ab") as file:
        return subprocess.Popen([sys.executable, "-m", "vemlight", "run", settings, "--out", out], stdout=file, stderr=file)


def victim(rng: random.Random, supervisor: int) -> tuple[str, int]:
    """A process of the run, by name and number."""
    running = children(supervisor)
    if not running or rng.random() < SUPERVISOR:
        return "supervisor", supervisor
    return rng.choice(sorted(running.items()))


def wait_for_pictures(run: subprocess.Popen[bytes], manifest: Path, pictures: int) -> None:
    """Waits until about so many more pictures are there, or the run has ended."""
    until_bytes = size(manifest) + pictures * LINE_BYTES
    while run.poll() is None and size(manifest) < until_bytes:
        time.sleep(0.02)


def size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def strike(rng: random.Random, pid: int) -> str:
    """Kills a process, or stops it for a while; what was done, empty when it had ended by itself."""
    try:
        if rng.random() < KILL:
            os.kill(pid, signal.SIGKILL)
            return "killed"
        os.kill(pid, signal.SIGSTOP)
        time.sleep(rng.uniform(*STOP_S))
        os.kill(pid, signal.SIGCONT)
    except ProcessLookupError:
        return ""
    return "stopped"


def disturbed(settings: Path, out: Path, log: Path, rng: random.Random, pictures: int) -> Counter[str]:
    """Runs the command until it says that all is done, however often it must be started; what was done to which process.

    pictures: between two strikes, on average; every fourth strike comes while the last one's damage is still being repaired.
    """
    done: Counter[str] = Counter()
    while True:
        run = start(settings, out, log)
        done["started"] += 1
        while run.poll() is None:
            if rng.random() < EARLY:
                time.sleep(rng.uniform(*EARLY_S))
            else:
                wait_for_pictures(run, out / "manifest.jsonl", 1 + round(rng.expovariate(1 / pictures)))
            name, pid = victim(rng, run.pid)
            if run.poll() is None and (what := strike(rng, pid)):
                done[f"{name} {what}"] += 1
                if name == "supervisor" and what == "killed":
                    run.wait()
        if run.returncode == 0:
            return done
        if run.returncode not in (-signal.SIGKILL, 1):  # 1: a service was killed five times in a minute
            raise AssertionError(f"the run ended with status {run.returncode}: {log.read_text()[-2000:]}")


def digests(out: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(out.iterdir())}


def compare(folder: Path, frames: int, pictures: int, seed: int, cameras: int = 1) -> Counter[str]:
    """Makes a sequence for each camera, runs undisturbed and disturbed. Raises AssertionError when a file differs."""
    write_input(folder, frames, cameras)
    reference = start(folder / "vemlight.toml", folder / "reference", folder / "reference.log")
    if status := reference.wait():
        raise AssertionError(f"the undisturbed run ended with status {status}: {(folder / 'reference.log').read_text()[-2000:]}")
    done = disturbed(folder / "vemlight.toml", folder / "out", folder / "out.log", random.Random(seed), pictures)
    expected, found = digests(folder / "reference"), digests(folder / "out")
    different = [name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name)]
    assert not different, f"{len(different)} of {len(expected)} files differ, among them {sorted(different)[0]}"
    assert len(expected) == 2 * frames + 3
    return done


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--pictures", type=int, default=40, help="between two strikes, on average")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cameras", type=int, default=1, help="2 and more: a rig")
    parser.add_argument("--folder", type=Path, default=None)
    arguments = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="nemesis-", dir=arguments.folder))
    began_s = time.monotonic()
    counts = compare(folder, arguments.frames, arguments.pictures, arguments.seed, arguments.cameras)
    print(f"{arguments.frames} frames, all equal, in {time.monotonic() - began_s:.0f} s: {dict(counts)}")
