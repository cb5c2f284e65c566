"""The whole chain live: pictures a second, lights, time from light to picture, and the processor time of each service.

    python -m bench.live [--seconds 20] [--targets 100,40,0] [SETTINGS]

All services play the source of SETTINGS (the bundled sequence) live for each target frame time in ms, 0 for none, first without a page and
then with one that takes every picture. Prints a line for each; processor times are milliseconds a picture.
"""

import argparse
import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import aiohttp
import msgspec
import numpy as np
import tomli_w

from vemlight.runtime import stamps, wire
from vemlight.runtime.transport import Transport
from vemlight.settings import Settings
from vemlight.settings_file import read_settings
from vemlight.viewer.web import BINARY_FEEDS

WARM_UP_S = 6.0  # the frame budget settles within a few dozen frames
START_S = 120.0  # GL, and the first time compiled code
TICKS = os.sysconf("SC_CLK_TCK")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def cpu_ms(parent: int) -> dict[str, float]:
    """Processor time so far of each service that runs under a supervisor."""
    used = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = stat.read_text().rpartition(")")[2].split()
            words = (stat.parent / "cmdline").read_text().split("\0")
            names = [word.removeprefix("vemlight.") for word in words if word.startswith("vemlight.")]
            if int(fields[1]) == parent and names:
                used[names[0]] = (int(fields[11]) + int(fields[12])) * 1e3 / TICKS
    return used


def pictures(subscription: Any, seconds: float) -> list[tuple[wire.ImageMessage, float]]:
    """The headers that come within that time, each with the age in ms of its light when it came."""
    came, until_s = [], time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0:
        if subscription.poll(int(left_s * 1e3) + 1):
            header, _ = wire.unpack(subscription.recv_multipart())
            if isinstance(header, wire.ImageMessage):
                came.append((header, stamps.age_ms(header.stamp)))
    return came


async def watch(port: int) -> None:
    """A page that takes every picture."""
    async with aiohttp.ClientSession() as session, session.ws_connect(f"http://127.0.0.1:{port}/ws") as page:
        async for message in page:
            if message.type is aiohttp.WSMsgType.BINARY:
                await page.send_str(next(name for name, code in BINARY_FEEDS.items() if code == message.data[0]))
            else:
                await page.send_str("summary" if '"services"' in message.data else "lights")


def started(module: str, *words: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-m", module, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def measured(settings: Settings, watched: bool, seconds: float) -> str:
    """A run's figures in words."""
    with tempfile.TemporaryDirectory() as folder:
        drawn = msgspec.structs.replace(settings.wire, folder=folder)
        settings = msgspec.structs.replace(settings, wire=drawn, viewer=msgspec.structs.replace(settings.viewer, port=free_port()))
        file = Path(folder) / "vemlight.toml"
        file.write_text(tomli_w.dumps(msgspec.to_builtins(settings)))
        run = started("vemlight", "run", str(file))
        transport, page = Transport(settings.wire), None
        try:
            subscription = transport.subscribe("renderer", "image")
            began_s = time.monotonic()
            while not pictures(subscription, 1.0):
                if time.monotonic() > began_s + START_S:
                    raise RuntimeError("no picture came: does `vemlight run` work here?")
            if watched:
                page = started("bench.live", "--watch", str(settings.viewer.port))
            pictures(subscription, WARM_UP_S)
            before, began_s = cpu_ms(run.pid), time.monotonic()
            came = pictures(subscription, seconds)
            took_s, after = time.monotonic() - began_s, cpu_ms(run.pid)
        finally:
            for process in (page, run):
                if process:
                    process.send_signal(signal.SIGINT)
                    process.wait()
            transport.close()
    lights, ages = [header.report.drawn_lights for header, _ in came], [age for _, age in came]
    spent = ", ".join(f"{name} {(after[name] - before[name]) / max(len(came), 1):.1f}" for name in before)
    return (
        f"{len(came) / took_s:.1f} pictures a second, {np.median(lights):.0f} lights, light to picture {np.percentile(ages, 50):.0f} ms "
        f"and {np.percentile(ages, 99):.0f} ms at the 99th percentile; {spent}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("settings", nargs="?", type=Path)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--targets", default="100,40,0")
    parser.add_argument("--watch", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.watch:
        asyncio.run(watch(options.watch))
        return
    settings = read_settings(options.settings)
    for target in map(float, options.targets.split(",")):
        for watched in (False, True):
            drawing = msgspec.structs.replace(settings.renderer, frame_ms=target)
            line = measured(msgspec.structs.replace(settings, renderer=drawing), watched, options.seconds)
            print(f"target {target:g} ms, {'a page' if watched else 'no page'}: {line}", flush=True)


if __name__ == "__main__":
    main()
