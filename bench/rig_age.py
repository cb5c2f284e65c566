"""How old the fused map of several cameras is when it is published, and what it takes of a processor.

    python -m bench.rig_age MAP... [--cameras 2,4,8] [--fps 30] [--seconds 10] [--kill]

Each camera is a capture process that replays the maps in turn (camera k begins with the k-th), all on this machine, with a fuse process and
this one as the only listener. A camera's frame is stamped with the moment when it was due, so that the age has the time of the capture, of
both sockets, and of fusing. --kill: kill -9 of each capture in turn, a second apart; what the others lose is printed, too.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import tomli_w

from vemlight.runtime import wire
from vemlight.runtime.transport import Transport
from vemlight.settings import Settings, read_settings

START_S = 120.0


def write_rig(folder: Path, maps: list[Path], cameras: int, fps: float) -> Path:
    """A settings file of a rig whose cameras stand on a circle of 1 m, the first map of each the next one."""
    rig = []
    for k in range(cameras):
        source = folder / f"camera{k}"
        source.mkdir()
        for n in range(len(maps)):
            file = maps[(n + k) % len(maps)]
            shutil.copy(file, source / f"frame_{n:03d}{file.suffix}")
        angle = 2 * np.pi * k / cameras
        rig.append({"name": f"camera{k}", "source": str(source), "at": [float(np.cos(angle)), float(np.sin(angle)), 1.0]})
    (folder / "rig.toml").write_text(tomli_w.dumps({"camera": rig}))
    (folder / "sockets").mkdir(mode=0o700)
    settings = {"rig": {"file": "rig.toml"}, "wire": {"folder": str(folder / "sockets")}, "capture": {"fps": fps}}
    path = folder / "vemlight.toml"
    path.write_text(tomli_w.dumps(settings))
    return path


def started(path: Path, service: str, *arguments: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", f"vemlight.{service}", str(path), *arguments]
    return subprocess.Popen(command, env={"OPENBLAS_NUM_THREADS": "1", **os.environ})


def processor_s(process: subprocess.Popen[bytes]) -> float:
    """User and system time so far (proc_pid_stat(5), fields 14 and 15)."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(settings: Settings, path: Path, cameras: int, seconds: float, kill: bool) -> str:
    """A row of the table."""
    captures = [started(path, "capture", f"camera{k}") for k in range(cameras)]
    fuse = started(path, "fuse")
    transport = Transport(settings.wire)
    try:
        socket = transport.subscribe("fuse", "points", "map")
        ages, sequences, until_s, busy_s = [], [], time.monotonic() + START_S, 0.0
        killed = 0
        while time.monotonic() < until_s:
            if not socket.poll(500):
                continue
            header, _ = wire.unpack(socket.recv_multipart())
            assert isinstance(header, wire.FrameHeader)
            if isinstance(header, wire.PointsMessage) and not sequences:
                if header.report.cameras < cameras:
                    continue
                busy_s, until_s = processor_s(fuse), time.monotonic() + seconds
            if isinstance(header, wire.MapMessage) and until_s - time.monotonic() <= seconds:
                ages.append(wire.age_ms(header.stamp))
                sequences.append(header.stamp.sequence)
            elif isinstance(header, wire.PointsMessage):
                sequences = sequences or [header.stamp.sequence]
            if kill and killed < cameras and len(ages) > 30 * (killed + 1):
                captures[killed].send_signal(signal.SIGKILL)
                captures[killed].wait()
                captures[killed] = started(path, "capture", f"camera{killed}")
                killed += 1
        busy_ms = 1e3 * (processor_s(fuse) - busy_s) / max(1, len(ages))
        p50, p99 = np.percentile(ages, [50, 99])
        return f"| {cameras} | {len(ages) / seconds:.1f} | {p50:.1f} | {p99:.1f} | {busy_ms:.1f} | {killed} |"
    finally:
        transport.close()
        for process in (*captures, fuse):
            process.kill()
            process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("maps", nargs="+", type=Path)
    parser.add_argument("--cameras", default="2,4,8")
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--kill", action="store_true")
    given = parser.parse_args()
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors; {given.fps:g} frames a second")
    print("| cameras | fused a second | age p50 ms | age p99 ms | fuse, processor ms a frame | killed |\n|---|---|---|---|---|---|")
    for cameras in map(int, given.cameras.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            path = write_rig(Path(folder), given.maps, cameras, given.fps)
            print(measure(read_settings(path), path, cameras, given.seconds, given.kill), flush=True)


if __name__ == "__main__":
    main()
