"""A network link between two namespaces of this machine that delays, loses and cuts packets, for programs on either side.

Each namespace has a TUN device (Linux, networking/tuntap.rst), and a thread here carries the packets from one to the other, so that the
kernels' TCP meets what it meets on a real link: lost packets are sent again by its own backing off, connections are opened anew.
"""

import ctypes
import fcntl
import heapq
import itertools
import os
import random
import select
import struct
import subprocess
import threading
import time
from pathlib import Path

TUN = Path("/dev/net/tun")
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000  # linux/if_tun.h
CLONE_NEWNET = 0x40000000
HERE, THERE = "10.213.9.1", "10.213.9.2"
MTU = 1500
QUEUE_PACKETS = 256  # that wait for a link of so many bytes a second: more are lost, as at a router's


def possible() -> bool:
    """Whether this process may make namespaces and TUN devices."""
    if os.geteuid() or not os.access(TUN, os.W_OK):
        return False
    name = f"vl-try-{os.getpid()}"
    try:
        made = subprocess.run(["ip", "netns", "add", name], capture_output=True, check=False).returncode == 0
    except OSError:
        return False
    subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)
    return made


class PacketLink:
    """Two namespaces with the addresses HERE and THERE. Programs run in them by `prefix(0)` and `prefix(1)`."""

    def __init__(self, delay_s: float = 0.0, loss: float = 0.0, bytes_per_s: float = 0.0) -> None:
        """delay_s: of a packet, each way. loss: fraction of packets. bytes_per_s: 0 without a limit."""
        self.cut = False
        self._delay_s, self._loss, self._bytes_per_s = delay_s, loss, bytes_per_s
        self._random = random.Random(0)
        self._names = [f"vl{os.getpid()}{side}" for side in "ab"]
        self._files: list[int] = []
        self._ended = False
        for name, address in zip(self._names, (HERE, THERE), strict=True):
            _run("ip", "netns", "add", name)
            self._files.append(_tun_in(name))
            _run("ip", "-n", name, "link", "set", "lo", "up")
            _run("ip", "-n", name, "addr", "add", f"{address}/30", "dev", "tun0")
            _run("ip", "-n", name, "link", "set", "tun0", "mtu", str(MTU), "up")
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def prefix(self, side: int) -> tuple[str, ...]:
        """What stands before a command that runs on a side."""
        return ("ip", "netns", "exec", self._names[side])

    def _carry(self) -> None:
        waiting: list[tuple[float, int, int, bytes]] = []  # when a packet arrives, its number, where, and itself
        free_s, numbers = [0.0, 0.0], itertools.count()
        while not self._ended:
            left_s = max(0.0, waiting[0][0] - time.monotonic()) if waiting else 0.05
            for file in select.select(self._files, [], [], min(left_s, 0.05))[0]:
                packet, to = os.read(file, 2 * MTU), 1 - self._files.index(file)
                now_s = time.monotonic()
                takes_s = len(packet) / self._bytes_per_s if self._bytes_per_s else 0.0
                if self.cut or self._random.random() < self._loss or free_s[to] > now_s + QUEUE_PACKETS * takes_s:
                    continue
                free_s[to] = max(free_s[to], now_s) + takes_s
                heapq.heappush(waiting, (free_s[to] + self._delay_s, next(numbers), to, packet))
            while waiting and waiting[0][0] <= time.monotonic():
                _, _, to, packet = heapq.heappop(waiting)
                if not self.cut:
                    os.write(self._files[to], packet)

    def __enter__(self) -> "PacketLink":
        return self

    def __exit__(self, *_: object) -> None:
        self._ended = True
        self._thread.join()
        for file in self._files:
            os.close(file)
        for name in self._names:
            subprocess.run(["ip", "netns", "del", name], check=False)


def _run(*command: str) -> None:
    subprocess.run(command, check=True)


def _tun_in(namespace: str) -> int:
    """The open file of a new device tun0 in a namespace, whose packets are read and written here."""
    files: list[int] = []

    def open_there() -> None:  # a thread of its own: only that enters
        libc = ctypes.CDLL(None, use_errno=True)
        space = os.open(f"/run/netns/{namespace}", os.O_RDONLY)
        try:
            if libc.setns(space, CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), "setns")
        finally:
            os.close(space)
        file = os.open(TUN, os.O_RDWR)
        fcntl.ioctl(file, TUNSETIFF, struct.pack("16sH14x", b"tun0", IFF_TUN | IFF_NO_PI))
        files.append(file)

    thread = threading.Thread(target=open_there)
    thread.start()
    thread.join()
    return files[0]
