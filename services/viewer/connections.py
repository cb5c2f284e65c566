"""The page's connections: how many, how long a request may take to arrive, and how much may come.

aiohttp parses requests and has limits on their parts; what it does not limit is decided here, around each connection's protocol.
"""

import asyncio
import contextlib
import ipaddress
import logging
import socket
from collections.abc import Callable, Iterator
from typing import cast

from aiohttp import web

from vemlight.runtime.allowance import Allowance
from vemlight.runtime.log_lines import LogLines
from vemlight.runtime.open_files import peer_limit

MAX_CONNECTIONS = 256  # four for each of web.MAX_PAGES pages; 128 to 1024 would do, if there are files
PART_OF_ADDRESS = 2  # an address has the half: a proxy brings everybody from one. 2 to 4 would do
HEADER_S = 5.0  # from the connection to the end of the first request's headers; 2 to 20 s would do
IDLE_S = 15.0  # to the next request's, and for the last answer to be taken: browsers keep connections for a while. 5 to 60 s would do
TAKES_NOTHING_MS = 10_000  # a reader who takes nothing of what was sent for so long is gone; 5 to 60 s would do
# Bytes of a connection: a page that drags each of MAX_POSES objects sends a control of 24 kB 30 times a second.
BYTES_BURST, BYTES_PER_S = 2 * 2**20, 2**20
IPV6_PREFIX = 64  # bits of an address that its owner does not choose


class Connection(asyncio.Protocol):
    """One connection: passes everything on to aiohttp's protocol, within the limits."""

    def __init__(self, site: "Connections", inner: asyncio.Protocol) -> None:
        self.address = ""
        self.is_busy = False  # a request is being answered
        self.has_token = False  # it has brought the token once
        self._site, self._inner = site, inner
        self._bytes, self._expected = Allowance(BYTES_BURST, BYTES_PER_S), 0
        self._transport: asyncio.Transport | None = None
        self._deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self.address = _network((transport.get_extra_info("peername") or ("",))[0])
        with contextlib.suppress(OSError):
            transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, TAKES_NOTHING_MS)
        self._inner.connection_made(transport)
        self._site.admit(self)
        self._expect_request(HEADER_S)

    def data_received(self, data: bytes) -> None:
        expected = min(self._expected, len(data))
        self._expected -= expected
        if self._bytes.take(len(data) - expected):
            self._inner.data_received(data)
        else:
            self.end("more bytes than a page sends")

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_waiting()
        self._site.forget(self)
        self._inner.connection_lost(exc)

    def pause_writing(self) -> None:
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self._inner.resume_writing()

    @contextlib.contextmanager
    def busy(self) -> Iterator[None]:
        """While a request is being answered."""
        self._stop_waiting()
        self.is_busy = True
        try:
            yield
        finally:
            self.is_busy = False
            self._expect_request(IDLE_S)

    @contextlib.contextmanager
    def waiting(self) -> Iterator[None]:
        """Within `busy`, while the rest of the request is still to come."""
        self.is_busy = False
        try:
            yield
        finally:
            self.is_busy = True

    def expect_bytes(self, count: int) -> None:
        """Lets so many more bytes come, of a request that has been looked at."""
        self._expected += count

    def end(self, reason: str = "") -> None:
        """Ends it at once; a line says why."""
        if reason:
            self._site.lines.say(reason, f"viewer: ended a connection of {self.address}: {reason}")
        self._stop_waiting()
        self._site.forget(self)
        if self._transport:
            self._transport.abort()

    def _expect_request(self, seconds: float) -> None:
        if self._transport and not self._transport.is_closing():
            self._deadline = asyncio.get_running_loop().call_later(seconds, self.end)

    def _stop_waiting(self) -> None:
        if self._deadline:
            self._deadline.cancel()
            self._deadline = None


class Connections:
    """All of them: makes the protocol of each new one. Over a limit the one that has waited longest without a request gives way."""

    def __init__(self, server: Callable[[], asyncio.Protocol], lines: LogLines) -> None:
        self.lines = lines
        self._server = server
        self._open: dict[Connection, None] = {}  # the oldest first

    def __call__(self) -> Connection:
        return Connection(self, self._server())

    def admit(self, new: Connection) -> None:
        """Counts a new connection."""
        self._open[new] = None
        limit = min(MAX_CONNECTIONS, peer_limit())
        of_address = [connection for connection in self._open if connection.address == new.address]
        if len(of_address) > max(1, limit // PART_OF_ADDRESS):
            self._make_way(of_address, new, f"more than {limit // PART_OF_ADDRESS} of one address")
        elif len(self._open) > limit:
            self._make_way(list(self._open), new, f"more than {limit}")

    def _make_way(self, among: list[Connection], new: Connection, reason: str) -> None:
        next((connection for connection in among if not connection.is_busy), new).end(reason)

    def forget(self, connection: Connection) -> None:
        self._open.pop(connection, None)


@web.middleware
async def busy_middleware(request: web.Request, handler: Callable) -> web.StreamResponse:
    """Tells the connection when a request has come and when it is answered."""
    connection = connection_of(request)
    if connection is None:
        return await handler(request)
    with connection.busy():
        return await handler(request)


def connection_of(request: web.Request) -> Connection | None:
    """The connection that a request came through; None when it is gone."""
    protocol = request.transport.get_protocol() if request.transport else None
    return protocol if isinstance(protocol, Connection) else None


def _network(address: str) -> str:
    """The address, or of IPv6 the network: its owner has all the others in it."""
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address
    return address if parsed.version == 4 else str(ipaddress.ip_network((int(parsed), IPV6_PREFIX), strict=False))


class LineHandler(logging.Handler):
    """Log records of asyncio and aiohttp as lines, one of each kind a minute."""

    def __init__(self, lines: LogLines) -> None:
        super().__init__(logging.WARNING)
        self._lines = lines

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        self._lines.say(str(record.msg), f"viewer: {record.getMessage()}{f': {error!r}' if error else ''}")
