"""The newest lights from a vemlight viewer's websocket, by the standard library alone; knows nothing of Blender.

Protocol: RFC 6455. The layout of a message: docs/clients.md of vemlight.
"""

import base64
import contextlib
import hashlib
import os
import socket
import ssl
import struct
import threading
from array import array
from typing import NamedTuple
from urllib.parse import urlsplit

HEAD = struct.Struct("<4BI2d")
KIND, LAYOUT, COVARIANCE = 3, 1, 6
MAX_MESSAGE = 8 * 2**20  # bytes: 100,000 lights have 5.6 MB
MAX_ANSWER = 16 * 1024  # bytes of the answer to the request for a websocket
TIMEOUT_S = 15.0  # without a byte: the viewer asks for a sign of life each 10 s
RETRY_S = 1.0
MAGIC = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455, section 1.3
CONTINUATION, TEXT, BINARY, CLOSE, PING = 0, 1, 2, 8, 9
PORTS = {"http": 80, "https": 443}


class Frame(NamedTuple):
    """One frame's lights. ids: n whole numbers. directions, irradiance: 3 n floats; covariances: 6 n, or None for points."""

    sequence: int
    time_s: float
    ids: list[int]
    directions: array
    irradiance: array
    covariances: array | None


class FeedError(Exception):
    """Why there are no lights, for the panel."""


def decoded(message: bytes) -> Frame:
    """Raises FeedError for anything but lights in this layout."""
    if len(message) < HEAD.size:
        raise FeedError("the viewer sent something else than lights")
    kind, layout, extent, _, count, sequence, time_s = HEAD.unpack_from(message)
    if kind != KIND or layout != LAYOUT:
        raise FeedError("the viewer is of another version than this extension")
    if len(message) != HEAD.size + count * (32 + 4 * extent):
        raise FeedError("a frame of another length than it says")
    arrays, at = [], HEAD.size
    for code, floats in (("d", 1), ("f", 3), ("f", 3), ("f", extent)):
        numbers = array(code)
        end = at + count * floats * numbers.itemsize
        numbers.frombytes(message[at:end])
        if struct.pack("=H", 1) != struct.pack("<H", 1):
            numbers.byteswap()
        arrays.append(numbers)
        at = end
    ids, directions, irradiance, covariances = arrays
    whole = [int(number) for number in ids]
    return Frame(int(sequence), time_s, whole, directions, irradiance, covariances if extent == COVARIANCE else None)


class WebSocket:
    """A connection that receives binary messages and sends text."""

    def __init__(self, address: str, token: str = "") -> None:
        """address: http://HOST:PORT, or HOST:PORT. Raises FeedError where no viewer answers, OSError where nobody does."""
        url = urlsplit(address if "://" in address else f"http://{address}")
        if url.scheme not in PORTS or not url.hostname:
            raise FeedError("the address is not http://HOST:PORT")
        try:
            port = url.port or PORTS[url.scheme]
        except ValueError as error:
            raise FeedError("the address has no port between 1 and 65535") from error
        self._received = bytearray()
        self._socket = socket.create_connection((url.hostname, port), TIMEOUT_S)
        try:
            if url.scheme == "https":
                self._socket = ssl.create_default_context().wrap_socket(self._socket, server_hostname=url.hostname)
            self._upgrade(url.netloc.rpartition("@")[2], token)
        except BaseException:
            self._socket.close()
            raise

    def _upgrade(self, host: str, token: str) -> None:
        if any(letter in token for letter in "\r\n"):
            raise FeedError("the token has more than one line")
        key = base64.b64encode(os.urandom(16)).decode()
        lines = [
            "GET /ws?feeds=lights.bin HTTP/1.1", f"Host: {host}", "Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13",
            f"Sec-WebSocket-Key: {key}", *([f"Authorization: Bearer {token}"] if token else []), "", "",
        ]  # fmt: skip
        self._socket.sendall("\r\n".join(lines).encode())
        while b"\r\n\r\n" not in self._received:
            self._more()
            if len(self._received) > MAX_ANSWER:
                raise FeedError("what answers there is no viewer")
        head, _, rest = bytes(self._received).partition(b"\r\n\r\n")
        self._received = bytearray(rest)
        status, *fields = head.decode("latin-1").split("\r\n")
        code = status.split(" ")[1:2]
        if code == ["401"]:
            raise FeedError("the viewer wants its token" if not token else "the viewer refuses this token")
        accepted = base64.b64encode(hashlib.sha1((key + MAGIC).encode()).digest()).decode()
        if code != ["101"] or f"sec-websocket-accept: {accepted}".lower() not in (field.lower() for field in fields):
            raise FeedError(f"no viewer's websocket is there ({status[:60]})")

    def receive(self) -> bytes:
        """The next binary message. Raises FeedError at the connection's end and for what no viewer sends, OSError for a lost one."""
        message = bytearray()
        while True:
            first, second = self._take(2)
            length = second & 0x7F
            if length > 125:
                length = int.from_bytes(self._take(2 if length == 126 else 8), "big")
            if second & 0x80 or len(message) + length > MAX_MESSAGE:
                raise FeedError("what answers there is no viewer")
            payload = self._take(length)
            opcode = first & 0x0F
            if opcode == CLOSE:
                raise FeedError("the viewer ended the connection")
            if opcode == PING:
                self._send(0xA, payload)
            elif opcode in (BINARY, CONTINUATION):
                message += payload
                if first & 0x80:
                    return bytes(message)

    def send(self, text: str) -> None:
        """Sends a text of up to 125 bytes."""
        self._send(TEXT, text.encode())

    def _send(self, opcode: int, payload: bytes) -> None:
        mask = os.urandom(4)
        masked = bytes(byte ^ mask[k % 4] for k, byte in enumerate(payload[:125]))
        self._socket.sendall(bytes([0x80 | opcode, 0x80 | len(masked)]) + mask + masked)

    def _take(self, count: int) -> bytes:
        while len(self._received) < count:
            self._more()
        taken = bytes(self._received[:count])
        del self._received[:count]
        return taken

    def _more(self) -> None:
        data = self._socket.recv(65536)
        if not data:
            raise FeedError("the viewer ended the connection")
        self._received += data

    def close(self) -> None:
        """Wakes a thread that waits in `receive`, too."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


class Feed:
    """A thread that keeps the newest frame, also while Blender is busy, and connects again when the viewer went."""

    def __init__(self, address: str, token: str = "") -> None:
        self.state = "connecting"  # for the panel
        self._address, self._token = address, token
        self._frame: Frame | None = None
        self._ended = threading.Event()
        self._socket: WebSocket | None = None
        self._thread = threading.Thread(target=self._run, name="vemlight lights", daemon=True)
        self._thread.start()

    def take(self) -> Frame | None:
        """The newest frame, once; None when none has come since."""
        frame, self._frame = self._frame, None
        return frame

    def end(self) -> None:
        """Ends the thread and waits for it."""
        self._ended.set()
        if socket_ := self._socket:
            socket_.close()
        self._thread.join(TIMEOUT_S)

    def _run(self) -> None:
        while not self._ended.is_set():
            try:
                self._receive()
            except FeedError as error:
                self.state = str(error)
            except OSError as error:
                self.state = f"no viewer answers ({error.strerror or error})"
            self._ended.wait(RETRY_S)
        self.state = "not connected"

    def _receive(self) -> None:
        self._socket = connection = WebSocket(self._address, self._token)
        try:
            self.state = "connected"
            while not self._ended.is_set():
                self._frame = decoded(connection.receive())
                connection.send("lights.bin")
        finally:
            connection.close()


def is_this_machine(address: str) -> bool:
    """Whether an address needs no network."""
    host = urlsplit(address if "://" in address else f"http://{address}").hostname or ""
    return host in ("localhost", "::1") or host.startswith("127.")
