"""Kills each camera of a rig that runs in turn, and counts the frames of the others.

    python -m bench.rig_kills [--cameras 8] [--fps 30] [--seconds 5]

`vemlight run` of cameras that replay small lat-long maps into polar maps of 90 x 360. Frames that a camera made are told by its statuses,
those that came are counted here.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import tomli_w

from tests.support.processes import children, free_port
from tests.support.rig_listener import RigListener
from vemlight.light.images import write_exr
from vemlight.settings_file import read_settings

FRAMES = 8  # of each camera's recording


def write_rig(folder: Path, names: list[str], fps: float) -> Path:
    """A settings file of a rig whose cameras stand on a circle of 1 m."""
    angles = 2 * np.pi * np.arange(len(names)) / len(names)
    rig = []
    for c, (name, angle) in enumerate(zip(names, angles, strict=True)):
        (folder / name).mkdir()
        for k in range(FRAMES):
            image = np.full((32, 64, 3), 0.25, np.float32)
            image[8, (8 * k + c) % 64] = 100
            write_exr(folder / name / f"f_{k}.exr", image)
        rig.append({"name": name, "source": name, "at": [float(np.cos(angle)), float(np.sin(angle)), 1.0]})
    (folder / "rig.toml").write_text(tomli_w.dumps({"camera": rig}))
    (folder / "sockets").mkdir(mode=0o700)
    wanted = {
        "rig": {"file": "rig.toml"}, "wire": {"folder": "sockets"}, "capture": {"fps": fps}, "viewer": {"port": free_port()},
        "renderer": {"width": 64, "height": 48, "shadow_map": 64},
    }  # fmt: skip
    (folder / "vemlight.toml").write_text(tomli_w.dumps(wanted))
    return folder / "vemlight.toml"


def frames_during(heard: RigListener, seconds: float) -> dict[str, int]:
    """How many frames of each came in so many seconds from now on."""
    before, until_s = {name: len(numbers) for name, numbers in heard.numbers.items()}, time.monotonic() + seconds
    heard.until(lambda: time.monotonic() > until_s, "time")
    return {name: len(numbers) - before[name] for name, numbers in heard.numbers.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, default=8)
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--seconds", type=float, default=5.0)
    given = parser.parse_args()
    names = [f"c{k}" for k in range(given.cameras)]
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors; {given.cameras} cameras at {given.fps:g} frames a second")
    with tempfile.TemporaryDirectory() as folder:
        path = write_rig(Path(folder), names, given.fps)
        run = subprocess.Popen([sys.executable, "-m", "vemlight", "run", str(path)], stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        heard = RigListener(read_settings(path), names)
        try:
            heard.until(lambda: given.cameras in heard.cameras, "a moment of all cameras")
            undisturbed = frames_during(heard, given.seconds)
            print(
                f"undisturbed: {_shares(undisturbed, names, given)}, fused {undisturbed['fuse'] / given.seconds:.1f} a second", flush=True
            )
            for killed in names:
                began_s = time.monotonic()
                os.kill(children(run.pid)[f"capture.{killed}"], signal.SIGKILL)
                found = frames_during(heard, given.seconds)
                others = [name for name in names if name != killed]
                lost = sum(heard.lost(name) for name in others)
                fused = found["fuse"] / given.seconds
                print(f"{killed} killed: {_shares(found, others, given)}, {lost} lost on the way, fused {fused:.1f} a second", flush=True)
                heard.until(lambda killed=killed: heard.restarts[killed] > 0, "its return")
                heard.more(killed, 1)
                print(f"    back after {time.monotonic() - began_s:.1f} s or less", flush=True)
        finally:
            heard.close()
            run.terminate()
            run.wait()


def _shares(found: dict[str, int], names: list[str], given: argparse.Namespace) -> str:
    shares = [100 * found[name] / (given.fps * given.seconds) for name in names]
    return f"{min(shares):.0f} to {max(shares):.0f} % of the frames of each"


if __name__ == "__main__":
    main()
