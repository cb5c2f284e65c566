"""The ZeroMQ message transport protocol by hand, without keys (ZMTP 3.0, rfc.zeromq.org/spec/23): libzmq sends no message without end."""

import socket
import time

GREETING = b"\xff" + bytes(8) + b"\x7f" + b"\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32)
MORE, LONG, COMMAND = 1, 2, 4
HANDSHAKE_S = 5.0


def opened(endpoint: str) -> socket.socket:
    """A connection to `endpoint`, ipc or tcp."""
    scheme, _, address = endpoint.partition("://")
    if scheme == "ipc":
        connection = socket.socket(socket.AF_UNIX)
        connection.connect(address)
        return connection
    host, _, port = address.rpartition(":")
    return socket.create_connection((host, int(port)))


def listening(endpoint: str) -> socket.socket:
    """A socket that peers connect to."""
    scheme, _, address = endpoint.partition("://")
    if scheme == "ipc":
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(address)
        listener.listen()
        return listener
    host, _, port = address.rpartition(":")
    return socket.create_server((host, int(port)))


def frame(body: bytes, flags: int = 0) -> bytes:
    """A part, the last of its message unless `flags` has MORE."""
    if len(body) < 256:
        return bytes([flags, len(body)]) + body
    return bytes([flags | LONG]) + len(body).to_bytes(8, "big") + body


def greet(connection: socket.socket, kind: bytes) -> None:
    """Both sides' greetings and READY commands: afterwards parts can be sent. Raises OSError when the other side does not."""
    connection.settimeout(HANDSHAKE_S)
    name = b"Socket-Type"
    ready = b"\x05READY" + bytes([len(name)]) + name + len(kind).to_bytes(4, "big") + kind
    connection.sendall(GREETING)
    received = 0
    while received < len(GREETING):
        part = connection.recv(len(GREETING) - received)
        if not part:
            raise ConnectionResetError("cut before the handshake")
        received += len(part)
    connection.sendall(frame(ready, COMMAND))
    connection.recv(4096)


def send_until_cut(connection: socket.socket, data: bytes, seconds: float, pause_s: float = 0.0) -> float | None:
    """Sends `data` again and again; after how many seconds the other side has ended the connection, or None."""
    began_s = time.monotonic()
    connection.settimeout(0.5)
    while time.monotonic() - began_s < seconds:
        try:
            connection.sendall(data)
        except TimeoutError:
            continue
        except OSError:
            return time.monotonic() - began_s
        time.sleep(pause_s)
    return None
