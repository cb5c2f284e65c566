"""A receiver of streaming ACN, written from the layout of ANSI E1.31-2018 alone: it shares no code with the sender."""

import socket
import struct
import threading
import time
from typing import NamedTuple

SO_TIMESTAMPNS = 35  # asm-generic/socket.h; Python has no name for it


class Received(NamedTuple):
    """at_s: monotonic. kind: "data", "sync" or "discovery"."""

    at_s: float
    kind: str
    cid: bytes
    universe: int
    sequence: int
    priority: int
    preview: bool
    terminated: bool
    sync: int
    slots: bytes
    size: int


def parsed(packet: bytes, at_s: float = 0.0) -> Received:
    """Raises AssertionError for what the standard does not allow."""
    size = len(packet)
    assert packet[:16] == bytes([0, 0x10, 0, 0]) + b"ASC-E1.17\x00\x00\x00"
    assert int.from_bytes(packet[16:18]) == 0x7000 | (size - 16)
    vector, cid = int.from_bytes(packet[18:22]), packet[22:38]
    assert int.from_bytes(packet[38:40]) == 0x7000 | (size - 38)
    frame = int.from_bytes(packet[40:44])
    if vector == 8:
        kind = {1: "sync", 2: "discovery"}[frame]
        sync = int.from_bytes(packet[45:47]) if kind == "sync" else 0
        return Received(at_s, kind, cid, sync, packet[44] if kind == "sync" else 0, 0, False, False, sync, packet[120:], size)
    assert (vector, frame, size) == (4, 2, 638)
    name, (priority,), (sync, universe) = packet[44:108], packet[108:109], (packet[109:111], packet[113:115])
    assert name.rstrip(b"\0") == b"vemlight"
    assert packet[115:125] == bytes([0x72, 0x0B, 0x02, 0xA1, 0, 0, 0, 1, 0x02, 0x01])
    assert packet[125] == 0  # start code of levels
    options = packet[112]
    return Received(at_s, "data", cid, int.from_bytes(universe), packet[111], priority, bool(options & 0x80), bool(options & 0x40),
                    int.from_bytes(sync), packet[126:], size)  # fmt: skip


class SacnReceiver(threading.Thread):
    """Collects what comes to an address; `raw`: also what is no streaming ACN."""

    def __init__(self, address: str, port: int = 0) -> None:
        super().__init__(daemon=True)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**22)
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)  # of the kernel: this thread may be late
        self._socket.bind((address, port))
        self._socket.settimeout(0.05)
        self.port = self._socket.getsockname()[1]
        self.packets: list[Received] = []
        self.raw: list[bytes] = []
        self._ending = False

    def run(self) -> None:
        while not self._ending:
            try:
                packet, ancillary, _, _ = self._socket.recvmsg(2048, 64)
            except TimeoutError:
                continue
            late_s = time.time() - _arrival_s(ancillary)
            self.raw.append(packet)
            if packet[4:13] == b"ASC-E1.17":
                self.packets.append(parsed(packet, time.monotonic() - late_s))

    def data(self, universe: int = 1) -> list[Received]:
        return [packet for packet in self.packets if packet.kind == "data" and packet.universe == universe]

    def wait_for(self, found, timeout_s: float = 20.0):
        """The first packet for which `found` is true."""
        give_up_s, seen = time.monotonic() + timeout_s, 0
        while True:
            new = self.packets[seen:]
            for packet in new:
                if found(packet):
                    return packet
            seen += len(new)
            assert time.monotonic() < give_up_s, f"not within {timeout_s} s"
            time.sleep(0.01)

    def close(self) -> None:
        self._ending = True
        self.join()
        self._socket.close()


def _arrival_s(ancillary) -> float:
    """When the kernel got the packet, realtime."""
    seconds, nanoseconds = struct.unpack("qq", ancillary[0][2][:16])
    return seconds + nanoseconds / 1e9


def most_in_a_second(times_s: list[float]) -> int:
    """The most packets within any second."""
    first, most = 0, 0
    for last, at_s in enumerate(times_s):
        while at_s - times_s[first] >= 1.0:
            first += 1
        most = max(most, last - first + 1)
    return most


def accepted(packets: list[Received]) -> list[Received]:
    """Those whose sequence a receiver accepts (E1.31, 6.7.2): not up to 20 behind the last one."""
    taken: list[Received] = []
    for packet in packets:
        if taken and -20 < (packet.sequence - taken[-1].sequence + 128) % 256 - 128 <= 0:
            continue
        taken.append(packet)
    return taken
