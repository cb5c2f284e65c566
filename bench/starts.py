"""How soon it starts: the commands warm and with an empty cache of compiled code, and services that were killed. Run it on an idle machine.

    python -m bench.starts [--cold] [--kills 20]

Processor time is of the process and its children. A kill is SIGKILL of a service in a live run of the bundled sequence; the lights are
back when the first lights arrive that were made after it, the picture likewise.
"""

import argparse
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import msgspec
import numpy as np
import tomli_w
import zmq

from vemlight.runtime import wire
from vemlight.runtime.peers import receive
from vemlight.runtime.restarts import GIVE_UP_S, MAX_DEATHS
from vemlight.runtime.transport import Transport
from vemlight.settings import Settings

SERVICES = ("capture", "sampler", "renderer", "viewer")
RUNS = 5  # of a command; the median is printed
PAUSE_S = GIVE_UP_S / (MAX_DEATHS - 1) + 1  # between two kills of a service, however soon it is back: sooner, and the supervisor gives up
START_S, BACK_S = 300.0, 60.0  # longest waits for a first picture and after a kill


def timed(command: list[str], **environment: str) -> tuple[float, float]:
    """(processor time, wall time) of a command, s."""
    before, started_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run([sys.executable, *command], check=True, capture_output=True, env={**os.environ, **environment})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, time.monotonic() - started_s


def commands(folder: Path) -> dict[str, list[str]]:
    lights, picture = str(folder / "lights.jsonl"), str(folder / "picture.png")
    made = {f"import of {service}": ["-c", f"import vemlight.{service}.__main__"] for service in SERVICES}
    return made | {
        "vemlight --help": ["-m", "vemlight", "--help"],
        "vemlight lights MAP": ["-m", "vemlight", "lights", str(folder / "map.exr"), "--count", "72", "--out", lights],
        "vemlight render MAP": ["-m", "vemlight", "render", str(folder / "map.exr"), "--count", "72", "--out", picture],
    }


class Run:
    """A live run of the bundled sequence, and what it publishes."""

    def __init__(self, folder: Path, **environment: str) -> None:
        wired = msgspec.structs.replace(Settings().wire, folder=str(folder / "sockets"))
        viewer = msgspec.structs.replace(Settings().viewer, port=18765)
        settings = msgspec.structs.replace(Settings(), wire=wired, viewer=viewer)
        (folder / "run.toml").write_text(tomli_w.dumps(msgspec.to_builtins(settings)))
        self._transport = Transport(wired)
        self._lights = self._transport.subscribe("sampler", "lights")
        self._images = self._transport.subscribe("renderer", "image")
        command = [sys.executable, "-m", "vemlight", "run", str(folder / "run.toml")]
        self.process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env={**os.environ, **environment})
        self._begun_s = time.monotonic()

    def arrivals(self, since_ns: int, limit_s: float) -> tuple[float, float]:
        """Seconds until the first lights and the first picture of light captured after `since_ns` (monotonic); nan for none in time."""
        found, started_s = {}, time.monotonic()
        while len(found) < 2 and time.monotonic() < started_s + limit_s:
            zmq.select([self._lights, self._images], [], [], 0.05)
            for name, socket in (("lights", self._lights), ("image", self._images)):
                while socket.poll(0):
                    header, _ = wire.unpack(receive(socket).parts)
                    if isinstance(header, wire.FrameHeader) and header.stamp.monotonic_ns > since_ns:
                        found.setdefault(name, time.monotonic() - started_s)
        return found.get("lights", np.nan), found.get("image", np.nan)

    def kill(self, service: str) -> None:
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        for child in children:
            if f"vemlight.{service}" in Path(f"/proc/{child}/cmdline").read_text():
                os.kill(int(child), signal.SIGKILL)

    def processor_s(self) -> float:
        """Processor time of all services until now, s."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        ticks = [Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[11:13] for child in children]
        return sum(int(user) + int(system) for user, system in ticks) / os.sysconf("SC_CLK_TCK")

    def close(self) -> None:
        self.process.send_signal(signal.SIGINT)
        self.process.wait()
        self._transport.close()


def first_start(name: str, **environment: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder), **environment)
        lights_s, image_s = run.arrivals(0, START_S)
        processor_s = run.processor_s()
        print(f"{name}: lights after {lights_s:.1f} s, a picture after {image_s:.1f} s, {processor_s:.1f} s of processor time", flush=True)
        run.close()


def kills(count: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        run = Run(Path(folder))
        run.arrivals(0, START_S)
        for service in SERVICES[:3]:
            lights, images = [], []
            for _ in range(count):
                time.sleep(PAUSE_S)
                if run.process.poll() is not None:
                    sys.exit(f"the run has ended with status {run.process.returncode}")
                run.kill(service)
                light_s, image_s = run.arrivals(time.monotonic_ns(), BACK_S)
                lights.append(light_s)
                images.append(image_s)
            light, image = (f"{np.median(times):.2f} s (worst {np.max(times):.2f})" for times in (lights, images))
            print(f"kill -9 of {service}, {count} times: lights {light}, picture {image}", flush=True)
        run.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cold", action="store_true", help="also with an empty cache: minutes")
    parser.add_argument("--kills", type=int, default=20)
    chosen = parser.parse_args()
    from vemlight.light.images import write_exr

    with tempfile.TemporaryDirectory() as folder:
        write_exr(Path(folder) / "map.exr", np.random.default_rng(0).random((512, 1024, 3)).astype(np.float32))
        for name, command in commands(Path(folder)).items():
            timed(command)
            processor_s, wall_s = np.median([timed(command) for _ in range(RUNS)], axis=0)
            print(f"{name}: {processor_s:.2f} s of processor time, {wall_s:.2f} s", flush=True)
        if chosen.cold:
            with tempfile.TemporaryDirectory() as cache:
                processor_s, wall_s = timed(commands(Path(folder))["vemlight lights MAP"], NUMBA_CACHE_DIR=cache)
            print(f"vemlight lights MAP, empty cache: {processor_s:.1f} s of processor time, {wall_s:.1f} s", flush=True)
    first_start("vemlight run")
    if chosen.cold:
        with tempfile.TemporaryDirectory() as cache:
            first_start("vemlight run, empty cache", NUMBA_CACHE_DIR=cache)
    if chosen.kills:
        kills(chosen.kills)


if __name__ == "__main__":
    main()
