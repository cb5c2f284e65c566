"""Attacks on the viewer's page, by name. Each returns after how many seconds it was cut, or None."""

import base64
import contextlib
import http.client
import json
import os
import selectors
import socket
import struct
import time
from collections.abc import Callable, Iterator

SECONDS = 6.0  # for which an attack goes on
Client = Callable[[], socket.socket]
HOST = b"Host: localhost\r\n"


def _connected(port: int) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port), timeout=2.0)
    connection.settimeout(0.5)
    return connection


def _many(port: int, count: int, start: bytes, drip: bytes = b"", every_s: float = 0.5) -> float | None:
    """So many connections that send `start` and then `drip` now and then; those that end are opened again. When the first was ended."""
    began_s, cut_s, last_s = time.monotonic(), None, time.monotonic()
    selector = selectors.DefaultSelector()

    def add() -> None:
        with contextlib.suppress(OSError):
            connection = _connected(port)
            connection.sendall(start)
            connection.setblocking(False)
            selector.register(connection, selectors.EVENT_READ)

    while time.monotonic() - began_s < SECONDS:
        for _ in range(min(100, count - len(selector.get_map()))):
            add()
        for key, _ in selector.select(0.05):
            connection = key.fileobj
            assert isinstance(connection, socket.socket)
            with contextlib.suppress(BlockingIOError):
                try:
                    ended = not connection.recv(65536)
                except ConnectionError:
                    ended = True
                if ended:
                    cut_s = time.monotonic() - began_s if cut_s is None else cut_s
                    selector.unregister(connection)
                    connection.close()
        if drip and time.monotonic() - last_s > every_s:
            last_s = time.monotonic()
            for key in list(selector.get_map().values()):
                with contextlib.suppress(OSError):
                    key.fileobj.send(drip)  # type: ignore[union-attr]
    for key in list(selector.get_map().values()):
        key.fileobj.close()  # type: ignore[union-attr]
    return cut_s


def _flood(port: int, start: bytes, data: bytes) -> float | None:
    """Sends without end on one connection, and on another when that is cut. When the first was cut."""
    began_s, first = time.monotonic(), None
    while time.monotonic() - began_s < SECONDS:
        at_s = time.monotonic()
        try:
            with contextlib.closing(_connected(port)) as connection:
                connection.sendall(start)
                while time.monotonic() - began_s < SECONDS:
                    with contextlib.suppress(TimeoutError):
                        connection.sendall(data)
        except OSError:
            first = time.monotonic() - at_s if first is None else first
            time.sleep(0.005)
    return first


def half_open(port: int) -> float | None:
    return _many(port, 1100, b"GET /healthz HT")


def silent(port: int) -> float | None:
    return _many(port, 1100, b"")


def slow_headers(port: int) -> float | None:
    return _many(port, 200, b"GET /healthz HTTP/1.1\r\n" + HOST, b"X: y\r\n")


def slow_body(port: int) -> float | None:
    return _many(port, 200, b"POST /control HTTP/1.1\r\n" + HOST + b"Content-Type: application/json\r\nContent-Length: 30000\r\n\r\n", b" ")


def slow_body_unasked(port: int) -> float | None:
    return _many(port, 200, b"GET /healthz HTTP/1.1\r\n" + HOST + b"Content-Length: 1000000000\r\n\r\n", b" ")


def endless_header(port: int) -> float | None:
    return _flood(port, b"GET /healthz HTTP/1.1\r\n", b"X" * 65536)


def endless_headers(port: int) -> float | None:
    return _flood(port, b"GET /healthz HTTP/1.1\r\n", b"X: y\r\n" * 10000)


def endless_chunks(port: int) -> float | None:
    start = b"POST /control HTTP/1.1\r\n" + HOST + b"Content-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n"
    return _flood(port, start, b"10000\r\n" + bytes(65536) + b"\r\n")


def pipelined(port: int) -> float | None:
    return _flood(port, b"", (b"GET /healthz HTTP/1.1\r\n" + HOST + b"\r\n") * 1000)


def malformed(port: int) -> float | None:
    """A thousand and more requests that are none."""
    kinds = [b"\x00\xff\x00\r\n\r\n", b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"GET / HTTP/1.1\r\nA b\r\n\r\n",
             b"POST /control HTTP/1.1\r\n" + HOST + b"Content-Length: x\r\n\r\n",
             b"POST /control HTTP/1.1\r\n" + HOST + b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n",
             b"GET http://[/ HTTP/1.1\r\n" + HOST + b"\r\n", b"GET / HTTP/1.1\r\n" + HOST + HOST + b"\r\n"]  # fmt: skip
    began_s = time.monotonic()
    while time.monotonic() - began_s < SECONDS:
        for kind in kinds:
            with contextlib.suppress(OSError), contextlib.closing(_connected(port)) as connection:
                connection.sendall(kind)
                connection.recv(4096)
    return None


def _websocket(port: int) -> bytes:
    key = base64.b64encode(os.urandom(16))
    upgrade = b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: " + key
    return b"GET /ws HTTP/1.1\r\nHost: localhost:" + str(port).encode() + b"\r\n" + upgrade + b"\r\n\r\n"


def _frame(opcode: int, body: bytes, final: bool = True) -> bytes:
    """A client's frame; its mask is zero."""
    return struct.pack("!BB4x", opcode | 0x80 * final, 0x80 | len(body)) + body


def names_flood(port: int) -> float | None:
    return _flood(port, _websocket(port), 1000 * _frame(1, b"disc"))


def pings_flood(port: int) -> float | None:
    return _flood(port, _websocket(port), 1000 * _frame(9, b""))


def continuations_flood(port: int) -> float | None:
    return _flood(port, _websocket(port) + _frame(1, b"", final=False), 1000 * _frame(0, b"", final=False))


def large_frame(port: int) -> float | None:
    return _flood(port, _websocket(port) + struct.pack("!BBQ4x", 0x81, 0xFF, 2**40), bytes(65536))


def pages_that_never_read(port: int) -> float | None:
    """They name the feeds all the same."""
    names = b"".join(_frame(1, name) for name in (b"disc", b"picture", b"lights", b"summary"))
    return _never_read(port, 60, lambda: _websocket(port), names)


def streams_that_never_read(port: int) -> float | None:
    return _never_read(port, 60, lambda: b"GET /stream.mjpg HTTP/1.1\r\n" + HOST + b"\r\n", b"")


def _never_read(port: int, count: int, start: Callable[[], bytes], again: bytes) -> float | None:
    began_s, cut_s = time.monotonic(), None
    held: list[socket.socket] = []
    for _ in range(count):
        with contextlib.suppress(OSError):
            connection = socket.socket()
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.connect(("127.0.0.1", port))
            connection.sendall(start())
            connection.settimeout(0.01)
            held.append(connection)
    while time.monotonic() - began_s < 4 * SECONDS and cut_s is None:
        for connection in held:
            try:
                connection.send(again or b"\r\n")
            except TimeoutError:
                pass
            except OSError:
                cut_s = time.monotonic() - began_s
        time.sleep(0.2)
    for connection in held:
        connection.close()
    return cut_s


def _announced(port: int, size: int) -> bytes:
    """The number of an upload of one picture of so many bytes."""
    page = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
    body = json.dumps({"kind": "light", "label": "sky", "files": [{"name": "sky.hdr", "size": size}]})
    page.request("POST", "/uploads", body, {"Content-Type": "application/json"})
    return json.loads(page.getresponse().read())["id"].encode()


def _sending(number: bytes, size: int) -> bytes:
    head = b"Content-Type: application/octet-stream\r\nContent-Length: %d\r\n\r\n" % size
    return b"PUT /uploads/" + number + b"/0 HTTP/1.1\r\n" + HOST + head


def slow_upload(port: int) -> float | None:
    """One that was announced, byte for byte; the others of its number are refused."""
    size = 2**20
    return _many(port, 100, _sending(_announced(port, size), size) + b"#?RADIANCE\n", b"x")


def upload_without_end(port: int) -> float | None:
    """Goes on behind the announced bytes."""
    return _flood(port, _sending(_announced(port, 100), 100), bytes(65536))


def announcements(port: int) -> float | None:
    body = b'{"kind":"light","label":"x","files":[' + b",".join(1000 * [b'{"name":"a","size":0}']) + b"]}"
    head = b"Content-Type: application/json\r\nContent-Length: %d\r\n\r\n" % len(body)
    return _flood(port, b"", b"POST /uploads HTTP/1.1\r\n" + HOST + head + body)


def small_uploads(port: int) -> float | None:
    """Of no bytes, as many as are taken, and given back again."""
    page, began_s = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0), time.monotonic()
    kind = {"Content-Type": "application/json"}
    while time.monotonic() - began_s < SECONDS:
        with contextlib.suppress(OSError, http.client.HTTPException):
            page.request("POST", "/uploads", '{"kind":"light","label":"x","files":[{"name":"a.hdr","size":0}]}', kind)
            answer = page.getresponse()
            text = answer.read()
            if answer.status == 201:
                page.request("PUT", f"/uploads/{json.loads(text)['id']}/0", b"", {"Content-Type": "application/octet-stream"})
                page.getresponse().read()
    return None


def guesses(port: int) -> float | None:
    """Wrong tokens, as fast as they are answered; when the first was refused without being compared."""
    began_s, refused_s = time.monotonic(), None
    with contextlib.closing(_connected(port)) as connection:
        for answer in _answers(connection):
            if b" 429 " in answer and refused_s is None:
                refused_s = time.monotonic() - began_s
            if time.monotonic() - began_s > SECONDS:
                break
    return refused_s


def _answers(connection: socket.socket) -> Iterator[bytes]:
    k = 0
    while True:
        connection.sendall(b"GET /healthz?token=wrong-token-%08d HTTP/1.1\r\n" % k + HOST + b"\r\n")
        yield connection.recv(65536)
        k += 1


PAGE_ATTACKS: dict[str, Callable[[int], float | None]] = {
    "1,100 half-open requests": half_open,
    "1,100 silent connections": silent,
    "slow headers": slow_headers,
    "slow body": slow_body,
    "slow body that nobody asked for": slow_body_unasked,
    "header without end": endless_header,
    "headers without end": endless_headers,
    "body without end": endless_chunks,
    "requests without a pause": pipelined,
    "malformed requests": malformed,
    "page: names without a pause": names_flood,
    "page: pings without a pause": pings_flood,
    "page: message without end": continuations_flood,
    "page: frame of 2^40 bytes": large_frame,
    "60 pages that never read": pages_that_never_read,
    "60 streams that never read": streams_that_never_read,
    "an upload byte for byte": slow_upload,
    "an upload without end": upload_without_end,
    "announcements without a pause": announcements,
    "small uploads without a pause": small_uploads,
    "wrong tokens": guesses,
}
