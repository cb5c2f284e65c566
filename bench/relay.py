"""The relay: how late frames are for many listeners, over slow links, and after cuts.

`python -m bench.relay [--listeners 200] [--seconds 20]`. Slow links: a TCP proxy with 1 Mbit/s and 200 ms each way, whose cuts hold all
bytes; and, as root with iproute2, two network namespaces with 1 Mbit/s (tbf) in whose cuts all packets are lost, since neither side has the
other's hardware address. Frames of 150 soft lights at 30 Hz, with keys. Ages are from the frame's stamp to the listener's hand.
"""

import argparse
import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import zmq

from tests.support.processes import children, free_port
from tests.support.slow_link import SlowLink
from vemlight.runtime import stamps, wire
from vemlight.runtime.transport import Transport, accept_subscriptions, make_keys, read_keys
from vemlight.settings import Wire

FPS, LIGHTS = 30, 150
CUT_S, CUTS = 5.0, 4
LOOKED_AT = 17  # of so many frames one is read: all listeners are in one process


def publish(folder: Path) -> None:
    """A sampler that only publishes, until it is killed."""
    transport = Transport(Wire(folder=str(folder)))
    publisher = transport.bind("sampler", "publish")
    random = np.random.default_rng(0)
    directions = random.normal(size=(LIGHTS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    covariances = np.tile([1e-3, 0, 0, 1e-3, 0, 0], (LIGHTS, 1))
    arrays = (np.arange(LIGHTS), directions, random.random((LIGHTS, 3)), covariances, np.zeros((0, 3)), np.zeros((0, 3)))
    start_s, sequence = time.monotonic(), 0
    while True:
        time.sleep(max(0, start_s + sequence / FPS - time.monotonic()))
        accept_subscriptions(publisher)
        header = wire.LightsMessage(stamp=stamps.stamp(sequence, sequence / FPS), count=LIGHTS, coverage="sphere", soft=True)
        publisher.send_multipart(wire.pack(header, arrays))
        sequence += 1


@contextlib.contextmanager
def relay(folder: Path, *options: str, host: str = "127.0.0.1", prefix: tuple[str, ...] = ()) -> Iterator[tuple[int, int]]:
    """Port of a relay that runs, and the id of the process that does its work."""
    port = free_port()
    command = [*prefix, sys.executable, "-m", "vemlight", "relay", "sampler", str(folder / "place.toml"), "--listen", f"{host}:{port}"]
    process = subprocess.Popen([*command, *options], stdout=subprocess.PIPE)
    assert process.stdout
    process.stdout.readline()
    yield port, children(process.pid)["exchange.relay"]
    process.kill()
    process.wait()


def listeners(count: int, address: str, keys: Path) -> tuple[zmq.Context[Any], zmq.Poller]:
    context: Any = zmq.Context()
    context.set(zmq.MAX_SOCKETS, 4096)
    poller, pair = zmq.Poller(), read_keys(keys)
    for _ in range(count):
        socket = context.socket(zmq.SUB)
        socket.linger, socket.curve_serverkey = 0, pair.public
        socket.curve_publickey, socket.curve_secretkey = pair
        socket.subscribe(b"lights")
        socket.connect(address)
        poller.register(socket, zmq.POLLIN)
    return context, poller


def fan_out(folder: Path, count: int, seconds: float) -> None:
    with relay(folder) as (port, pid):
        context, poller = listeners(count, f"tcp://127.0.0.1:{port}", folder / "keys")
        time.sleep(3)
        until_s, ages_ms, received, cpu_s = time.monotonic() + seconds, [], 0, cpu_of(pid)
        while time.monotonic() < until_s:
            for socket, _ in poller.poll(100):
                parts = socket.recv_multipart()
                received += 1
                if received % LOOKED_AT == 0:
                    header, _ = wire.unpack(parts)
                    assert isinstance(header, wire.LightsMessage)
                    ages_ms.append(stamps.age_ms(header.stamp))
        share = received / (count * FPS * seconds)
        p50, p99 = np.percentile(ages_ms, [50, 99])
        core = (cpu_of(pid) - cpu_s) / seconds
        ages = f"age p50 {p50:.1f} ms, p99 {p99:.1f} ms"
        print(f"{count} listeners: {100 * share:.1f} % of frames, {ages}, relay {100 * core:.0f} % of a core")
        context.destroy(linger=0)


def cpu_of(pid: int) -> float:
    """Seconds of processor time."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class Ages:
    """What a listener, by vemlight_client, receives in a thread or process of its own: (time, stamp's time) in s."""

    def __init__(self, address: str, keys: Path, prefix: tuple[str, ...] = ()) -> None:
        self.seen: list[tuple[float, int]] = []
        code = (
            "import sys, time, vemlight_client\n"
            "for frame in vemlight_client.lights(*sys.argv[1:]): print(time.monotonic(), frame.sequence, flush=True)"
        )
        self.process = subprocess.Popen([*prefix, sys.executable, "-c", code, address, str(keys)], stdout=subprocess.PIPE, text=True)
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout
        for line in self.process.stdout:
            at_s, sequence = line.split()
            self.seen.append((float(at_s), int(sequence)))

    def report(self, what: str, cut: Any) -> None:
        """Ages in a steady state, then after each of some cuts: `cut(True)` begins one."""
        time.sleep(6)
        steady = self.seen[-60:]
        rate = (len(steady) - 1) / (steady[-1][0] - steady[0][0])
        start_s = max(sequence / FPS - at_s for at_s, sequence in self.seen)  # the youngest frame seen is the measure of age 0
        ages_ms = [1e3 * (at_s + start_s - sequence / FPS) for at_s, sequence in steady]
        healed_s = []
        for _ in range(CUTS):
            cut(True)
            time.sleep(CUT_S)
            made = int((time.monotonic() + start_s) * FPS)  # the newest frame at the cut's end
            cut(False)
            end_s = time.monotonic()
            while not self.seen or self.seen[-1][1] < made:
                time.sleep(0.005)
                if time.monotonic() - end_s > 30:
                    break
            healed_s.append(time.monotonic() - end_s)
            time.sleep(3)
        times = ", ".join(f"{one:.2f}" for one in healed_s)
        print(f"{what}: {rate:.1f} frames a second, up to {max(ages_ms):.0f} ms older than the youngest; the newest {times} s after cuts")
        self.process.kill()


def slow_link(folder: Path) -> None:
    for options in ((), ("--count", "24")):
        with relay(folder, *options) as (port, _):
            link = SlowLink(port, 1e6 / 8, 0.2)
            ages = Ages(f"tcp://127.0.0.1:{link.port}", folder / "keys")
            ages.report(f"1 Mbit/s, 200 ms each way {' '.join(options)}", lambda on, link=link: setattr(link, "cut", on))
            link.end()


def namespaces(folder: Path) -> None:
    if os.geteuid() or not shutil.which("ip"):
        print("two network namespaces: need root and iproute2, left out")
        return

    def run(command: str) -> None:
        subprocess.run(command.split(), check=True)

    name, here, there = f"vemlight{os.getpid() % 10000}", f"vl{os.getpid() % 10000}a", f"vl{os.getpid() % 10000}b"
    try:
        run(f"ip netns add {name}")
        run(f"ip link add {here} type veth peer name {there} netns {name}")
        run(f"ip addr add 10.213.7.1/30 dev {here}")
        run(f"ip link set {here} up")
        run(f"ip netns exec {name} ip addr add 10.213.7.2/30 dev {there}")
        run(f"ip netns exec {name} ip link set {there} up")
        run(f"tc qdisc add dev {here} root tbf rate 1mbit burst 8kb latency 100ms")

        def cut(on: bool) -> None:
            for prefix, to, dev in ((), "10.213.7.2", here), (("ip", "netns", "exec", name), "10.213.7.1", there):
                change = ["replace", to, "lladdr", "02:00:00:00:00:99", "dev", dev, "nud", "permanent"] if on else ["del", to, "dev", dev]
                subprocess.run([*prefix, "ip", "neigh", *change], check=True)

        for options in ((), ("--count", "24")):
            with relay(folder, *options, host="10.213.7.1") as (port, _):
                ages = Ages(f"tcp://10.213.7.1:{port}", folder / "keys", ("ip", "netns", "exec", name))
                ages.report(f"namespaces, 1 Mbit/s, packets lost {' '.join(options)}", cut)
    finally:
        subprocess.run(["ip", "link", "del", here], check=False)
        subprocess.run(["ip", "netns", "del", name], check=False)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--listeners", type=int, nargs="+", default=[50, 200])
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--publish", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.publish:
        publish(asked.publish)
    with tempfile.TemporaryDirectory() as folder_name:
        folder = Path(folder_name)
        make_keys(folder / "keys")
        (folder / "place.toml").write_text(f'[wire]\nfolder = "{folder}"\nkeys = "{folder}/keys"\n')
        sampler = subprocess.Popen([sys.executable, "-m", "bench.relay", "--publish", str(folder)])
        try:
            for count in asked.listeners:
                fan_out(folder, count, asked.seconds)
            slow_link(folder)
            namespaces(folder)
        finally:
            sampler.kill()
            sampler.wait()


if __name__ == "__main__":
    main()
