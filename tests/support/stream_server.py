"""A server of this machine that streams JPEG pictures over HTTP, as network cameras do, and may refuse, fall silent or hang up."""

import base64
import contextlib
import io
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
from PIL import Image


def jpeg(pixels: np.ndarray) -> bytes:
    """A JPEG of (height, width, 3) uint8, colour of each pixel kept."""
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "JPEG", quality=97, subsampling=0)
    return data.getvalue()


class Pictures(ThreadingHTTPServer):
    """Streams `pictures` again and again at `fps`. connections: how many there were."""

    daemon_threads = True

    def __init__(self, pictures: list[bytes], fps: float, password: str = "", hang_up_after: int = 0, silent: bool = False) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.pictures, self.fps, self.password, self.hang_up_after, self.silent = pictures, fps, password, hang_up_after, silent
        self.connections, self.closing = 0, False

    @property
    def address(self) -> str:
        """Where the stream is, without a password."""
        return f"http://127.0.0.1:{self.server_port}/stream"


class _Handler(BaseHTTPRequestHandler):
    server: Pictures  # pyright: ignore[reportIncompatibleVariableOverride]

    def do_GET(self) -> None:
        server = self.server
        server.connections += 1
        wanted = "Basic " + base64.b64encode(server.password.encode()).decode()
        if server.password and self.headers.get("Authorization") != wanted:
            self.send_response(401)
            self.send_header("WWW-Authenticate", 'Basic realm="camera"')
            self.end_headers()
            return
        while server.silent and not server.closing:
            time.sleep(0.02)
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        with contextlib.suppress(OSError):
            self._stream()

    def _stream(self) -> None:
        count, began_s = 0, time.monotonic()
        while not self.server.closing and count != (self.server.hang_up_after or -1):
            data = self.server.pictures[count % len(self.server.pictures)]
            self.wfile.write(b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n" % (len(data), data))
            count += 1
            time.sleep(max(0.0, began_s + count / self.server.fps - time.monotonic()))

    def log_message(self, *_: Any) -> None:
        """Says nothing."""


@contextlib.contextmanager
def serving(pictures: list[bytes], fps: float = 25.0, **options: Any) -> Iterator[Pictures]:
    """A server that runs meanwhile; options: see Pictures."""
    server = Pictures(pictures, fps, **options)
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.closing = True
        server.shutdown()
        server.server_close()
