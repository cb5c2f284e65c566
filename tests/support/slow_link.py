"""A slow network between two programs, as a TCP proxy: bytes a second, delay, and cuts in which nothing passes."""

import asyncio
import contextlib
import socket
import threading

HELD = 4096  # bytes that wait before the link: with the system's own, several hundred thousand, what arrives would be seconds old


class SlowLink:
    """Listens on `port` of 127.0.0.1 and connects to `to`. While `cut` nothing passes, in either direction, and nobody is told."""

    def __init__(self, to: int, bytes_per_s: float, delay_s: float) -> None:
        self.cut = False
        self.port = 0
        self._to, self._bytes_per_s, self._delay_s = to, bytes_per_s, delay_s
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()), daemon=True)
        self._thread.start()
        self._ready.wait()

    async def _run(self) -> None:
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        server = await asyncio.start_server(self._serve, "127.0.0.1", 0, limit=HELD)
        self.port = server.sockets[0].getsockname()[1]
        self._ready.set()
        await self._ended.wait()
        server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while self.cut:
            await asyncio.sleep(0.01)
        connection = socket.socket()
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, HELD)
        connection.connect(("127.0.0.1", self._to))
        there, back = await asyncio.open_connection(sock=connection, limit=HELD)
        ways = [asyncio.ensure_future(self._pass(*way)) for way in ((reader, back), (there, writer))]
        with contextlib.suppress(asyncio.CancelledError):  # by `end`
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for way in ways:
            way.cancel()
        await asyncio.gather(*ways, return_exceptions=True)
        for end in (back, writer):
            end.transport.abort()

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Reads as fast as the link is, so that the sender's buffers fill as on a slow one, and writes what was read a delay ago."""
        on_its_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

        async def arrive() -> None:
            while True:
                at_s, data = await on_its_way.get()
                await asyncio.sleep(max(0, at_s - self._loop.time()))
                while self.cut:
                    await asyncio.sleep(0.01)
                writer.write(data)
                await writer.drain()

        arriving = asyncio.ensure_future(arrive())
        try:
            while data := await reader.read(1500):
                await asyncio.sleep(len(data) / self._bytes_per_s)
                while self.cut:
                    await asyncio.sleep(0.01)
                on_its_way.put_nowait((self._loop.time() + self._delay_s, data))
        finally:
            arriving.cancel()

    def end(self) -> None:
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join()
