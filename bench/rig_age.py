"""How old the fused map of several cameras is when it is received, and what fusing takes of a processor.

    python -m bench.rig_age [MAP...] [--cameras 2,4,8] [--fps 30] [--seconds 10]

What each camera sees of a simulated room with lamps, with new noise in each of a few frames, is made beforehand and published for all
cameras by one process, so that few cores carry many cameras; a fuse process takes it, and this one is the only listener. With MAPs, camera
k begins with the k-th of them, and they are played in turn. A frame is stamped with the moment when it was due.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import msgspec
import numpy as np
import tomli_w

from tests.support.analytic_rooms import maps_of, noisy, random_room
from vemlight.capture.source import open_files
from vemlight.capture.stage import map_message
from vemlight.fuse.rig_file import read_camera_rig
from vemlight.light.environment_map import EnvironmentMap
from vemlight.runtime import stamps, wire
from vemlight.runtime.instances import captures
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Capture, Settings
from vemlight.settings_file import read_settings

START_S = 240.0  # compiling, and the room
ROOM, VARIANTS = 3, 4  # seed of the room; frames with noise of their own, of each camera
HELD = 10  # frames for which a MAP is shown


def write_rig(folder: Path, cameras: int, fps: float) -> Path:
    """A settings file of a rig whose cameras stand on a circle of 1 m."""
    angles = 2 * np.pi * np.arange(cameras) / cameras
    rig = [{"name": f"c{k}", "source": "none", "at": [float(np.cos(a)), float(np.sin(a)), 1.0]} for k, a in enumerate(angles)]
    (folder / "rig.toml").write_text(tomli_w.dumps({"camera": rig}))
    (folder / "sockets").mkdir(mode=0o700)
    path = folder / "vemlight.toml"
    wanted = {"rig": {"file": "rig.toml"}, "wire": {"folder": str(folder / "sockets")}, "capture": {"fps": fps}}
    path.write_text(tomli_w.dumps(wanted))
    return path


def room_frames(settings: Settings) -> list[list[wire.Message]]:
    """Of each camera of the rig what it sees, in a few variants."""
    rig, random = read_camera_rig(Path(settings.rig.file)), np.random.default_rng(0)
    return [[_message(noisy(seen, random)) for _ in range(VARIANTS)] for seen in maps_of(random_room(ROOM), rig, random)]


def _message(seen: EnvironmentMap) -> wire.Message:
    rows, cols, _ = seen.radiance.shape
    stamp, bright = stamps.stamp(0, 0.0), seen.bright_cells
    header = wire.MapMessage(stamp=stamp, rows=rows, cols=cols, coverage=seen.coverage, bright_samples=len(bright.cells))
    return header, (seen.radiance, *bright)


def map_frames(settings: Settings, maps: list[Path]) -> list[list[wire.Message]]:
    """Of each camera the maps, its own first, each held for a while."""
    made = [map_message(open_files(Capture(source=str(path))).frame(0), stamps.stamp(0, 0.0)) for path in maps]
    turns = [made[k % len(made) :] + made[: k % len(made)] for k in range(len(captures(settings)))]
    return [[each for each in turn for _ in range(HELD)] for turn in turns]


def play(settings: Settings, maps: list[Path]) -> None:
    """Publishes frames as all cameras of the rig, until it is killed."""
    frames = map_frames(settings, maps) if maps else room_frames(settings)
    transport, fps = Transport(settings.wire), settings.capture.fps
    publishers = [transport.bind(name, "publish") for name in captures(settings)]
    number = int(time.monotonic() * fps)
    while True:
        number += 1
        time.sleep(max(0.0, number / fps - time.monotonic()))
        stamp = msgspec.structs.replace(stamps.stamp(number, number / fps), monotonic_ns=round(number / fps * 1e9))
        for own, publisher in zip(frames, publishers, strict=True):
            accept_subscriptions(publisher)
            header, arrays = own[number % len(own)]
            publisher.send_multipart(wire.pack(msgspec.structs.replace(header, stamp=stamp), arrays))


def processor_s(process: subprocess.Popen[bytes]) -> float:
    """User and system time so far (proc_pid_stat(5), fields 14 and 15)."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(path: Path, maps: list[Path], seconds: float) -> str:
    """Cells of a row."""
    settings = read_settings(path)
    environment = {"OPENBLAS_NUM_THREADS": "1", **os.environ}
    fuse = subprocess.Popen([sys.executable, "-m", "vemlight.fuse", str(path)], env=environment)
    player = subprocess.Popen([sys.executable, "-m", "bench.rig_age", *map(str, maps), "--play", str(path)], env=environment)
    transport = Transport(settings.wire)
    try:
        socket = transport.subscribe("fuse", "map", "status", "points")
        ages: list[float] = []
        near = 0
        skipped, busy_s, until_s = 0, 0.0, time.monotonic() + START_S
        while time.monotonic() < until_s:
            if not socket.poll(500):
                continue
            header, _ = wire.unpack(socket.recv_multipart())
            if isinstance(header, wire.StatusMessage):
                skipped = header.skipped
            elif isinstance(header, wire.PointsMessage):
                near = header.count
            elif isinstance(header, wire.MapMessage):
                if not ages:
                    busy_s, until_s = processor_s(fuse), time.monotonic() + seconds
                ages.append(stamps.age_ms(header.stamp))
        busy_ms = 1e3 * (processor_s(fuse) - busy_s) / max(1, len(ages))
        p50, p99 = np.percentile(ages, [50, 99])
        return f"{near} | {len(ages) / seconds:.1f} | {skipped} | {p50:.1f} | {p99:.1f} | {busy_ms:.1f}"
    finally:
        transport.close()
        for process in (player, fuse):
            process.kill()
            process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("maps", nargs="*", type=Path)
    parser.add_argument("--cameras", default="2,4,8")
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--play", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.play:
        play(read_settings(given.play), given.maps)
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors; {given.fps:g} frames a second")
    print("| cameras | near lights | fused a second | passed over | age p50 ms | age p99 ms | fuse, processor ms a frame |")
    print("|---|---|---|---|---|---|---|")
    for cameras in map(int, given.cameras.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            print(f"| {cameras} | {measure(write_rig(Path(folder), cameras, given.fps), given.maps, given.seconds)} |", flush=True)


if __name__ == "__main__":
    main()
