"""Peers: who has sent a message, and what it did beyond what is allowed. services/runtime/peer_guard.py disconnects it for that."""

import contextlib
import ctypes
import fcntl
import socket as network
import struct
import termios
import time
from typing import Any, NamedTuple

import zmq

from vemlight.runtime import wire
from vemlight.runtime.allowance import Allowance

MANY_PARTS = 1000  # of a message: then its sender is disconnected, and the rest is dropped fast. Any value over wire.MAX_PARTS does
STRIDE = 64  # parts dropped at once, which may be a few of the next message, too; 16 to 1000 would do
REFUSED_BURST, REFUSED_PER_S = 32, 0.5  # unreadable messages of a peer: a few come from another version or a fault; 8 to 100 would do
SUBSCRIPTIONS_BURST, SUBSCRIPTIONS_PER_S = 64, 8  # of a peer: there are 11 topics
SO_COOKIE = 57  # asm-generic/socket.h: a number of this socket alone, while the number of its file is used again
# A lost packet is sent again after AGAIN_MS at most. By its own backing off, TCP would be silent for seconds after a cut of a few: 6.4 s
# are the sum of its first five waits. Linux 6.15 and later (include/uapi/linux/tcp.h); before, all is as it was
TCP_RTO_MAX_MS, AGAIN_MS = 44, 1000
TCP_BYTES_RECEIVED = 128  # offset of tcpi_bytes_received in struct tcp_info (linux/tcp.h)


class Monitor(NamedTuple):
    """A watched socket: where its events come, what it is called, whether peers connect to it, and how much it may be sent unfinished."""

    events: Any
    service: str
    accepts: bool
    max_unfinished: int
    max_growth: int
    busy_looks: int


class OwnWork:
    """Whether the process is in a step of its own: memory that grows meanwhile is not what peers send. Used as `with WORK:`."""

    def __init__(self) -> None:
        self.is_on = False

    def __enter__(self) -> None:
        self.is_on = True

    def __exit__(self, *_: object) -> None:
        self.is_on = False


WORK = OwnWork()


class Peer:
    """One connection. The loops note what they took from it; the guard's thread judges it."""

    def __init__(self, file: int, monitor: Monitor) -> None:
        """Raises OSError when the connection is gone already."""
        self.file, self.monitor = file, monitor
        self.since_s = time.monotonic()
        self.took = False  # one of its messages was taken since the last look
        self.offence = ""  # what it did beyond all limits
        self.refused = Allowance(REFUSED_BURST, REFUSED_PER_S)
        self.subscriptions = Allowance(SUBSCRIPTIONS_BURST, SUBSCRIPTIONS_PER_S)
        self.mark = 0  # bytes received at its last message
        with Borrowed(file) as connection:
            self.cookie = connection.getsockopt(network.SOL_SOCKET, SO_COOKIE, 8)
            self.is_tcp = connection.family != network.AF_UNIX
            if self.is_tcp:
                self.name = connection.getpeername()[0]
                with contextlib.suppress(OSError):
                    connection.setsockopt(network.IPPROTO_TCP, TCP_RTO_MAX_MS, AGAIN_MS)
            else:
                pid, _, _ = struct.unpack("3i", connection.getsockopt(network.SOL_SOCKET, network.SO_PEERCRED, 12))
                self.name = f"process {pid}"

    def on_message(self) -> None:
        self.took = True

    def on_refused(self) -> None:
        """One of its messages could not be read."""
        if not self.refused.take():
            self.offence = f"more than {REFUSED_BURST} messages that cannot be read"

    def on_subscription(self) -> None:
        if not self.subscriptions.take():
            self.offence = f"more than {SUBSCRIPTIONS_BURST} subscriptions"

    def look(self) -> tuple[int, int]:
        """How many bytes it has sent and libzmq has read (tcp), and how many wait. Raises OSError when the connection is gone."""
        with Borrowed(self.file) as connection:
            if connection.getsockopt(network.SOL_SOCKET, SO_COOKIE, 8) != self.cookie:
                raise OSError("another connection's file")
            waiting = struct.unpack("i", fcntl.ioctl(self.file, termios.FIONREAD, bytes(4)))[0]
            received = 0
            if self.is_tcp:
                info = connection.getsockopt(network.IPPROTO_TCP, network.TCP_INFO, TCP_BYTES_RECEIVED + 8)
                received = struct.unpack_from("Q", info, TCP_BYTES_RECEIVED)[0] - waiting
            return received, waiting

    def shut_down(self) -> None:
        """Ends the connection, of which libzmq hears at once. Raises OSError when it is gone already."""
        with Borrowed(self.file) as connection:
            if connection.getsockopt(network.SOL_SOCKET, SO_COOKIE, 8) == self.cookie:
                reset(connection)


def reset(connection: network.socket) -> None:
    """Ends a connection at both sides. After a shutdown alone the kernel would go on to take what a tcp peer sends."""
    if connection.family == network.AF_UNIX:
        connection.shutdown(network.SHUT_RDWR)
    else:
        ctypes.CDLL(None).connect(connection.fileno(), bytes(16), 16)  # to AF_UNSPEC, which connect(2) says dissolves it


class Borrowed:
    """A socket object for libzmq's file, which stays open."""

    def __init__(self, file: int) -> None:
        self._socket = network.socket(fileno=file)

    def __enter__(self) -> network.socket:
        return self._socket

    def __exit__(self, *_: object) -> None:
        self._socket.detach()


PEERS: dict[int, Peer] = {}  # by file, which names a connection in the whole process: a message tells the file it came through


class Received(NamedTuple):
    """A message's parts, of too many only the first ones, and who sent it when that is known."""

    parts: list[bytes]
    sender: Peer | None


def receive(socket: Any) -> Received:
    """The next message that waits. Raises zmq.Again when there is none."""
    frame = socket.recv(zmq.NOBLOCK, copy=False)
    sender = _sender(frame)
    parts, more, count = [frame.bytes], frame.more, 1
    while more and count < MANY_PARTS:
        part = socket.recv(zmq.NOBLOCK)
        if count <= wire.MAX_PARTS + 1:  # one for the name of a consumer, and one too many
            parts.append(part)
        more, count = socket.getsockopt(zmq.RCVMORE), count + 1
    if more:
        if sender:
            sender.offence = f"sent a message of over {MANY_PARTS} parts"
        _drop_rest(socket)
    if sender:
        sender.on_message()
    return Received(parts, sender)


def _drop_rest(socket: Any) -> None:
    """Drops the rest of a message that may have millions of parts."""
    with contextlib.suppress(zmq.Again):
        while socket.getsockopt(zmq.RCVMORE):
            for _ in range(STRIDE):
                socket.recv(zmq.NOBLOCK)


def _sender(frame: Any) -> Peer | None:
    try:
        return PEERS.get(frame.get(zmq.SRCFD))
    except zmq.ZMQError:  # within this process
        return None
