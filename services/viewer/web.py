"""The viewer's addresses: the page, its websocket, pictures for other programs, lights, levels, health, metrics and control."""

import asyncio
import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import msgspec
from aiohttp import WSCloseCode, WSMsgType, web

from vemlight.errors import UserError
from vemlight.light import as_directional, lights_binary, mask, virtual_lamp
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.runtime.allowance import Allowance
from vemlight.viewer import environment_binary
from vemlight.viewer.authentication import add_headers, authentication_middleware
from vemlight.viewer.broadcast import Broadcast, Reader
from vemlight.viewer.connections import busy_middleware, connection_of
from vemlight.viewer.feeds import Feed
from vemlight.viewer.meter import Look
from vemlight.viewer.saved_settings import settings_file
from vemlight.viewer.scene_files import CHUNK, KEPT_FOR_S
from vemlight.viewer.upload_handlers import UploadHandlers
from vemlight.viewer.viewer_state import ViewerState

PAGE = Path(__file__).parent / "page"
CONTENT_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}  # of the page's files
MAX_PAGES = 64  # sockets and streams at once; each costs a task and one encoded frame on its way. 32 to 256 would do
MAX_BODY = 48 * 1024  # bytes; a control has under 100, with all that wire.ControlMessage may hold 36,000. Up to 128 kB would do
MAX_FEED_NAMES = 128  # bytes of a page's message: all names have 77; up to 1024 would do
HEARTBEAT_S = 10.0  # a page that does not answer within half of it is disconnected; any value in 5..60 does
STREAM_TIMEOUT_S = 10.0  # and so is a stream whose reader takes nothing for so long; any value in 5..60 does
BODY_S = 5.0  # for a control to come; 2 to 20 s would do
MESSAGES_BURST, MESSAGES_PER_S = 1000, 500  # of a page: it may name each of five feeds once for each picture; 250 to 2000 a second would do
# First byte of a binary message.
BINARY_FEEDS = {
    "disc": 1, "picture": 2, "lights.bin": lights_binary.KIND, "placed-lights.bin": lights_binary.PLACED_KIND,
    "environment.bin": environment_binary.KIND,
}  # fmt: skip
OWN_HEAD = {"lights.bin", "placed-lights.bin", "environment.bin"}  # feeds whose bytes begin with it; after the others' a JPEG follows
PAGE_FEEDS = ("summary", "lights", "levels", "disc", "picture")  # what a socket gets unless it asks for others
RETRY = {"Retry-After": "1"}


def constants_js() -> str:
    """The constants that the page has in common with the services, as a JavaScript module."""
    constants = {"LUMINANCE_WEIGHTS": LUMINANCE_WEIGHTS.tolist(), "BINARY_FEEDS": BINARY_FEEDS}
    constants |= {"MAX_MASKS": mask.MAX_MASKS, "MAX_MASK_POINTS": mask.MAX_MASK_POINTS, "MAX_POINTS": mask.MAX_POINTS}
    constants |= {"NEAR_IDS": as_directional.NEAR_IDS, "MAX_PAGES": MAX_PAGES}
    constants |= {name: getattr(virtual_lamp, name) for name in ("MAX_LAMPS", "MAX_LAMP_ID", "VIRTUAL_IDS_FROM")}
    return "".join(f"export const {name} = {json.dumps(value)};\n" for name, value in constants.items())


class Site:
    """The handlers, over one state."""

    def __init__(self, state: ViewerState) -> None:
        self._state = state
        files = [path for path in sorted(PAGE.iterdir()) if path.suffix in CONTENT_TYPES]
        self._files = {f"/{path.name}": (path.read_bytes(), CONTENT_TYPES[path.suffix]) for path in files}
        self._files["/"] = self._files.pop("/index.html")
        self._files["/constants.js"] = constants_js().encode(), "text/javascript"
        self._metrics: Any = None  # a CollectorRegistry, made when it is first asked for
        self._sockets: set[web.WebSocketResponse] = set()
        first = {name: byte for name, byte in BINARY_FEEDS.items() if name not in OWN_HEAD}
        self._broadcast = Broadcast(state.feeds, first, set(BINARY_FEEDS), state.feeds_changed)

    def app(self) -> web.Application:
        middlewares = [busy_middleware, authentication_middleware(self._state.settings.viewer)]
        app = web.Application(middlewares=middlewares, client_max_size=MAX_BODY)
        app.on_response_prepare.append(add_headers)
        app.on_startup.append(self._start)
        app.on_shutdown.append(self._close_sockets)
        app.add_routes(
            [
                web.get("/", self.page),
                *(web.get(path, self.file) for path in self._files if path != "/"),
                web.get("/favicon.ico", self.no_icon),
                web.get("/ws", self.socket),
                web.get("/snapshot.jpg", self.snapshot),
                web.get("/stream.mjpg", self.stream),
                web.get("/scene.json", self.scene),
                web.get("/scene/{hash}.bin", self.scene_data),
                web.get("/lights", self.lights),
                web.get("/sky.bin", self.sky),
                web.get("/vemlight.toml", self.saved),
                web.post("/measure", self.measure),
                web.delete("/measure", self.stop_measuring),
                web.get("/measured.toml", self.measured),
                web.get("/levels", self.levels),
                web.get("/thumbnails.jpg", self.thumbnails),
                web.get("/meter", self.meter),
                web.get("/meter/cells", self.meter_cells),
                web.get("/healthz", self.health),
                web.get("/metrics", self.metrics),
                web.post("/control", self.control),
                *UploadHandlers(self._state).routes(),
            ]
        )
        return app

    async def page(self, request: web.Request) -> web.StreamResponse:
        """The page; with `?action=snapshot` or `stream`, as mjpg-streamer has it, the picture."""
        match request.query.get("action"):
            case None:
                return await self.file(request)
            case "snapshot":
                return await self.snapshot(request)
            case "stream":
                return await self.stream(request)
        raise web.HTTPBadRequest(text="action: is snapshot or stream\n")

    async def file(self, request: web.Request) -> web.Response:
        body, content_type = self._files[request.path]
        return web.Response(body=body, content_type=content_type, charset="utf-8")

    async def no_icon(self, _: web.Request) -> web.Response:
        return web.Response(status=204)

    async def snapshot(self, _: web.Request) -> web.Response:
        number, jpeg = await _newest(self._state.picture)
        if not number:
            return web.Response(status=503, text="no picture yet: the renderer has sent none\n", headers=RETRY)
        return web.Response(body=jpeg, content_type="image/jpeg")

    async def lights(self, _: web.Request) -> web.Response:
        number, line = await _newest(self._state.lights)
        if not number:
            return web.Response(status=503, text="no lights yet: the sampler has sent none\n", headers=RETRY)
        return web.Response(body=line, content_type="application/json")

    async def sky(self, _: web.Request) -> web.Response:
        """The newest map's luminance as numbers (sky_values.py)."""
        number, values = await _newest(self._state.sky)
        if not number:
            return web.Response(status=503, text="no map yet: the capture has sent none\n", headers=RETRY)
        return web.Response(body=values, content_type="application/octet-stream")

    async def saved(self, _: web.Request) -> web.Response:
        """What is seen, as a settings file to keep."""
        return _settings(settings_file(self._state.settings, self._state.control, self._state.timeline.header))

    async def measure(self, request: web.Request) -> web.Response:
        """Begins to look for settings that hold their rate on this machine; the summary says how it stands."""
        if request.content_type != "application/json":  # which a form on another page cannot send unasked
            raise web.HTTPUnsupportedMediaType(text="measure: send Content-Type: application/json\n")
        try:
            self._state.measure()
        except UserError as error:
            raise web.HTTPBadRequest(text=f"measure: {error}\n") from error
        return web.Response(status=202)

    async def stop_measuring(self, _: web.Request) -> web.Response:
        await self._state.measuring.stop()
        self._state.refresh()
        return web.Response(status=204)

    async def measured(self, _: web.Request) -> web.Response:
        """The settings that were found."""
        if not self._state.measuring.file:
            raise web.HTTPNotFound(text="nothing was measured: POST /measure begins it\n")
        return _settings(self._state.measuring.file)

    async def scene(self, _: web.Request) -> web.Response:
        scene = self._state.scene
        if not scene.hash:
            return web.Response(status=503, text=f"{scene.text}\n", headers=RETRY)
        return web.Response(body=scene.description, content_type="application/json")

    async def scene_data(self, request: web.Request) -> web.StreamResponse:
        """The scene's block of bytes, in chunks: a page that takes nothing holds up no more than one."""
        scene = self._state.scene
        if not scene.hash or request.match_info["hash"] != scene.hash:
            raise web.HTTPNotFound(text="no scene of this hash: read /scene.json again\n")
        headers = {"Cache-Control": f"private, max-age={KEPT_FOR_S}, immutable", "Content-Type": "application/octet-stream"}
        with self._counted():
            response = web.StreamResponse(headers=headers)
            response.content_length = len(scene.data)
            await response.prepare(request)
            for first in range(0, len(scene.data), CHUNK):
                try:
                    await asyncio.wait_for(response.write(scene.data[first : first + CHUNK]), STREAM_TIMEOUT_S)
                except (TimeoutError, ConnectionError):
                    _abort(request)
                    return response
            return response

    async def levels(self, _: web.Request) -> web.Response:
        number, line = await _newest(self._state.levels)
        if not number:
            return web.Response(status=503, text="no levels yet: there is no rig, or no light has come\n", headers=RETRY)
        return web.Response(body=line, content_type="application/json")

    async def thumbnails(self, request: web.Request) -> web.Response:
        """Those of the timeline, side by side; with `?number=` those alone, and nothing (204) when there are others by now."""
        timeline = self._state.timeline
        if request.query.get("number", str(timeline.number)) != str(timeline.number):
            return web.Response(status=204)
        data = timeline.thumbnails_jpeg()
        if not data:
            return web.Response(status=404, text="no thumbnails: the source is a camera, or has made none yet\n")
        return web.Response(body=data, content_type="image/jpeg")

    async def meter(self, request: web.Request) -> web.Response:
        """Readings of the newest map, its lights, and the plane that `azimuth` and `elevation` name."""
        try:
            look = look_from_query(request.query)
        except ValueError as error:
            raise web.HTTPBadRequest(text=f"meter: {error}\n") from error
        return _reading(await asyncio.to_thread(self._state.meter.readings, look), "application/json")

    async def meter_cells(self, _: web.Request) -> web.Response:
        return _reading(await asyncio.to_thread(self._state.meter.cells), "application/octet-stream")

    async def health(self, _: web.Request) -> web.Response:
        summary = self._state.summary()
        status = 200 if summary["healthy"] else 503
        return web.Response(status=status, body=msgspec.json.encode(summary), content_type="application/json")

    async def metrics(self, _: web.Request) -> web.Response:
        from prometheus_client import CONTENT_TYPE_LATEST, generate_latest  # here, since few ask for metrics

        from vemlight.viewer.metrics import registry

        self._metrics = self._metrics or registry(self._state.summary)
        return web.Response(body=generate_latest(self._metrics), headers={"Content-Type": CONTENT_TYPE_LATEST})

    async def control(self, request: web.Request) -> web.Response:
        """Takes choices and answers with all that are in force."""
        if request.content_type != "application/json":  # what a form on another page cannot send unasked
            raise web.HTTPUnsupportedMediaType(text="control: send Content-Type: application/json\n")
        try:
            connection = connection_of(request)
            with connection.waiting() if connection else nullcontext():
                async with asyncio.timeout(BODY_S):
                    body = await request.read()
            self._state.set_control(body)
        except TimeoutError as error:
            raise web.HTTPRequestTimeout(text=f"control: did not come within {BODY_S:g} s\n", headers={"Connection": "close"}) from error
        except UserError as error:
            raise web.HTTPBadRequest(text=f"{error}\n") from error
        return web.Response(body=msgspec.json.encode(self._state.control), content_type="application/json")

    async def stream(self, request: web.Request) -> web.StreamResponse:
        """The pictures as motion JPEG; a reader that is slower than they come misses some."""
        with self._counted():
            response = web.StreamResponse(headers={"Content-Type": "multipart/x-mixed-replace; boundary=frame"})
            await response.prepare(request)
            await response.write(b"--frame\r\n")
            number = 0
            while True:
                number, jpeg = await self._state.picture.after(number)
                head = f"Content-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n".encode()
                try:  # the boundary goes with the picture: browsers show a part when they see its end
                    await asyncio.wait_for(response.write(head + jpeg + b"\r\n--frame\r\n"), STREAM_TIMEOUT_S)
                except (TimeoutError, ConnectionError):
                    _abort(request)
                    return response

    async def socket(self, request: web.Request) -> web.WebSocketResponse:
        """To a page: summaries, lights and levels as text (JSON), disc and picture as binary (one byte that says which, then a JPEG).

        Of each feed one message at most is on its way: the page names the feed when it has shown it, or several with commas between, and
        only then the newest follows.
        `?feeds=lights.bin` gives that feed instead, `feeds=lights,picture` these two (docs/clients.md).
        """
        asked = set(request.query.get("feeds", ",".join(PAGE_FEEDS)).split(","))
        if not asked <= self._state.feeds.keys():
            raise web.HTTPBadRequest(text=f"feeds: choose from {', '.join(self._state.feeds)}, with commas between\n")
        with self._counted():
            socket = web.WebSocketResponse(heartbeat=HEARTBEAT_S, max_msg_size=MAX_FEED_NAMES, compress=False, autoping=False)
            await socket.prepare(request)
            if request.transport is None:  # gone already
                return socket
            reader = Reader(request.transport, asked, lambda: _abort(request))
            messages = Allowance(MESSAGES_BURST, MESSAGES_PER_S)
            self._sockets.add(socket)
            self._broadcast.add(reader)
            try:
                async for message in socket:
                    if not messages.take():
                        _abort(request)
                        break
                    if message.type is WSMsgType.PING:
                        await socket.pong(message.data)
                        continue
                    if message.type is WSMsgType.PONG:
                        continue
                    names = message.data.split(",") if message.type is WSMsgType.TEXT else [""]
                    if not self._state.feeds.keys() >= set(names):
                        await socket.close(code=WSCloseCode.POLICY_VIOLATION, message=b"send the names of feeds, with commas between")
                        break
                    for name in names:
                        self._broadcast.ask(reader, name)
            finally:
                self._broadcast.remove(reader)
                self._sockets.discard(socket)
            return socket

    @contextmanager
    def _counted(self) -> Iterator[None]:
        """One more page. Raises HTTPServiceUnavailable when there are MAX_PAGES."""
        state = self._state
        if state.pages >= MAX_PAGES:
            raise web.HTTPServiceUnavailable(text=f"{MAX_PAGES} pages are open already: close one\n", headers=RETRY)
        state.pages += 1
        try:
            yield
        finally:
            state.pages -= 1

    async def _start(self, _: web.Application) -> None:
        self._broadcast.start()

    async def _close_sockets(self, _: web.Application) -> None:
        self._broadcast.stop()
        await self._state.measuring.stop()
        for socket in list(self._sockets):
            await socket.close(code=WSCloseCode.GOING_AWAY)


def look_from_query(query: Mapping[str, str]) -> Look:
    """Where a page's meter looks, in whole degrees. Raises ValueError, which says what may be asked."""
    try:
        azimuth, elevation, scale = (float(query.get(name, "0")) for name in ("azimuth", "elevation", "scale"))
    except ValueError as error:
        raise ValueError("azimuth, elevation and scale are numbers") from error
    if not (math.isfinite(azimuth) and -90 <= elevation <= 90 and (scale == 0 or 1e-12 <= scale <= 1e12)):
        raise ValueError("azimuth is finite, elevation from -90 to 90 degrees, scale from 1e-12 to 1e12 cd/m2 a unit")
    return Look(round(azimuth) % 360, round(elevation), scale)


async def _newest(feed: Feed) -> tuple[int, bytes]:
    """As `Feed.newest`. Raises HTTPServiceUnavailable where that could not be encoded: what is older is not the newest."""
    found = await feed.newest()
    if feed.failure:
        raise web.HTTPServiceUnavailable(text=f"the newest cannot be sent: {feed.failure}\n", headers=RETRY)
    return found


def _settings(text: bytes) -> web.Response:
    """A settings file to keep."""
    headers = {"Content-Disposition": 'attachment; filename="vemlight.toml"'}
    return web.Response(body=text, content_type="application/toml", charset="utf-8", headers=headers)


def _reading(content: bytes | None, content_type: str) -> web.Response:
    if content is None:
        return web.Response(status=503, text="no map yet: the capture has sent none\n", headers=RETRY)
    return web.Response(body=content, content_type=content_type)


def _abort(request: web.Request) -> None:
    """Ends a connection without waiting for what was written to it."""
    if request.transport:
        request.transport.abort()
