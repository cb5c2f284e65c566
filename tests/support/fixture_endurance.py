"""Packets of `vemlight dmx` for minutes, seen by a receiver at another address, on a loaded machine, killed and stopped.

    python -m tests.support.fixture_endurance [--minutes 3] [--load 2]

Prints what a fixture would have seen; status 1 when a bar is missed: 38 to 44 packets a second while it plays, never more than 44 in
any second, no gap above 1.05 s but for a kill or a stop, no packet without preview before it is armed, none dark, three terminated ones
within a second of SIGTERM.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from tests.support.sacn_receiver import Received, SacnReceiver, accepted, most_in_a_second
from vemlight.light.light_set import LightSet, lights_json, lights_row

RECEIVER = "127.0.0.34"
FPS = 25.0
RATE_HZ, MOST, GAP_S = 38.0, 44, 1.05
RIG = Path(__file__).parents[2] / "services" / "fixtures" / "rigs" / "dome.toml"


def write_light(path: Path, seconds: float) -> None:
    """A file of 72 lights that go round."""
    generator = np.random.default_rng(0)
    directions = generator.normal(size=(72, 3))
    irradiance = generator.uniform(0.2, 1, (72, 3))
    with open(path, "wb") as file:
        for k in range(round(seconds * FPS)):
            phi = 2 * np.pi * k / 600
            turn = np.array([[np.cos(phi), -np.sin(phi), 0], [np.sin(phi), np.cos(phi), 0], [0, 0, 1]])
            turned = directions @ turn.T / np.linalg.norm(directions, axis=1, keepdims=True)
            lights = LightSet.of(np.arange(72), turned, irradiance * (1 + 0.3 * np.sin(k / 9)))
            file.write(lights_json(lights_row(lights, k, k / FPS, "sphere")) + b"\n")


@contextmanager
def loaded(processes: int):
    """The machine with so many processes that compute."""
    spinning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait()


def started(rig: Path, lights: Path, *options: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "vemlight", "dmx", str(rig), "--lights", str(lights), *options]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL)


def gap_s(packets: list[Received]) -> float:
    return max(np.diff([packet.at_s for packet in packets]), default=0.0)


def played(receiver: SacnReceiver, rig: Path, lights: Path, seconds: float) -> dict[str, float]:
    """A play from arming to SIGTERM, and what came of it."""
    first = len(receiver.packets)
    process = started(rig, lights, "--arm")
    receiver.wait_for(lambda packet: packet.kind == "data" and receiver.packets.index(packet) >= first, 120)
    time.sleep(seconds)
    process.send_signal(signal.SIGTERM)
    sent_s = time.monotonic()
    process.wait(10)
    time.sleep(0.2)
    data = [packet for packet in receiver.packets[first:] if packet.kind == "data"]
    times_s = [packet.at_s for packet in data]
    return {
        "seconds": times_s[-1] - times_s[0], "packets": len(data), "rate Hz": (len(data) - 1) / (times_s[-1] - times_s[0]),
        "most in a second": most_in_a_second(times_s), "longest gap s": gap_s(data), "refused sequences": len(data) - len(accepted(data)),
        "dark": sum(not any(packet.slots) for packet in data), "terminated": sum(packet.terminated for packet in data),
        "end s": times_s[-1] - sent_s, "preview": sum(packet.preview for packet in data),
    }  # fmt: skip


def interrupted(receiver: SacnReceiver, rig: Path, lights: Path, number: signal.Signals, pause_s: float) -> dict[str, float]:
    """What comes when a process is killed and started again, or stopped and goes on: the gap, and sequences that a receiver refuses."""
    process = started(rig, lights, "--arm")
    first = len(receiver.packets)
    receiver.wait_for(lambda packet: packet.kind == "data" and receiver.packets.index(packet) >= first, 120)
    time.sleep(3)
    process.send_signal(number)
    if number == signal.SIGSTOP:
        time.sleep(pause_s)
        process.send_signal(signal.SIGCONT)
    else:
        process.wait()
        process = started(rig, lights, "--arm")
    time.sleep(8)
    process.terminate()
    process.wait(10)
    data = [packet for packet in receiver.packets[first:] if packet.kind == "data"]
    return {
        "longest gap s": gap_s(data), "refused sequences": len(data) - len(accepted(data)),
        "most in a second": most_in_a_second([packet.at_s for packet in data]), "dark": sum(not any(packet.slots) for packet in data),
        "sources": len({packet.cid for packet in data}),
    }  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--load", type=int, default=os.cpu_count() or 2, help="processes that compute meanwhile")
    options = parser.parse_args()
    receiver = SacnReceiver(RECEIVER)
    receiver.start()
    faults = []
    with tempfile.TemporaryDirectory() as folder, loaded(options.load):
        rig, lights = Path(folder) / "rig.toml", Path(folder) / "lights.jsonl"
        rig.write_text(RIG.read_text().replace('destination = "127.0.0.1"', f'destination = "{RECEIVER}:{receiver.port}"'))
        write_light(lights, 60 * options.minutes + 30)
        process = started(rig, lights)
        receiver.wait_for(lambda packet: packet.kind == "data", 120)
        time.sleep(2)
        process.terminate()
        process.wait(10)
        if not all(packet.preview for packet in receiver.packets):
            faults.append("a packet was live before it was armed")
        for name, found in (
            ("play", played(receiver, rig, lights, 60 * options.minutes)),
            ("kill -9", interrupted(receiver, rig, lights, signal.SIGKILL, 0)),
            ("stop for 1.5 s", interrupted(receiver, rig, lights, signal.SIGSTOP, 1.5)),
        ):
            print(f"{name}: " + ", ".join(f"{key} {value:.4g}" for key, value in found.items()), flush=True)
            faults += [f"{name}: {key}" for key, bad in (
                ("most in a second", found["most in a second"] > MOST), ("dark", found["dark"] > 0),
                ("rate Hz", not RATE_HZ <= found.get("rate Hz", RATE_HZ) <= MOST), ("terminated", found.get("terminated", 3) != 3),
                ("longest gap s", "end s" in found and found["longest gap s"] > GAP_S), ("end s", found.get("end s", 0) > 1),
            ) if bad]  # fmt: skip
    receiver.close()
    print("; ".join(faults) or "all bars are met")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
