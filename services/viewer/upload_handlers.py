"""The addresses of uploads: POST /uploads announces one, PUT /uploads/ID/N sends file N, POST /uploads/ID has it decoded, DELETE
removes it.
"""

import asyncio
from contextlib import nullcontext

import msgspec
from aiohttp import web

from vemlight.errors import UserError
from vemlight.files import decoded_json
from vemlight.viewer.connections import connection_of
from vemlight.viewer.uploads import BLOCK, MAX_FILES, Announcement
from vemlight.viewer.viewer_state import ViewerState

MAX_ANNOUNCEMENT = 320 * MAX_FILES  # bytes: a name of 255 letters and a size for each file
STALLED_S = 20.0  # for LEAST bytes of a file; a phone in a lift is back by then. 5 to 60 s would do
LEAST = 20 * 1024  # bytes of a file in that time, until its last: 1 kB a second, which no connection of a person falls below for long
STALLED = "upload: it stalled; send it again\n"
BYTES = "application/octet-stream"  # what another page cannot send unasked


class UploadHandlers:
    """The handlers, over one state."""

    def __init__(self, state: ViewerState) -> None:
        self._state, self._uploads = state, state.uploads

    def routes(self) -> list[web.RouteDef]:
        return [
            web.post("/uploads", self.announce),
            web.put("/uploads/{number}/{index:[0-9]{1,4}}", self.receive),
            web.post("/uploads/{number}", self.check),
            web.delete("/uploads/{number}", self.remove),
        ]

    async def announce(self, request: web.Request) -> web.Response:
        """Takes an Announcement as JSON; answers with the number."""
        self._check_type(request, "application/json")
        try:
            announced = decoded_json(await self._body(request), Announcement)
            number = self._uploads.announce(announced)
        except TimeoutError as error:
            raise web.HTTPRequestTimeout(text=STALLED, headers={"Connection": "close"}) from error
        except ValueError as error:
            raise web.HTTPBadRequest(text=f"upload: {error}\n") from error
        return web.json_response({"id": number}, status=201)

    async def _body(self, request: web.Request) -> bytes:
        """What was sent, of a length that was told. Raises ValueError for more than an announcement has."""
        if not 0 < (request.content_length or 0) <= MAX_ANNOUNCEMENT:
            raise UserError(f"no length, or one that is not taken; send 1 to {MAX_ANNOUNCEMENT} bytes, with Content-Length")
        connection = connection_of(request)
        with connection.waiting() if connection else nullcontext():
            async with asyncio.timeout(STALLED_S):
                return await request.content.readexactly(request.content_length or 0)

    async def receive(self, request: web.Request) -> web.Response:
        """Takes a file's bytes, of the length that was announced."""
        self._check_type(request, BYTES)
        number, index = request.match_info["number"], int(request.match_info["index"])
        try:
            size = self._uploads.expected(number, index)
            if request.content_length != size:
                raise UserError(f"not as long as announced; send its {size} bytes, with Content-Length")
            if connection := connection_of(request):
                connection.expect_bytes(size)
            await self._uploads.receive(number, index, self._blocks(request))
        except TimeoutError as error:
            raise web.HTTPRequestTimeout(text=STALLED, headers={"Connection": "close"}) from error
        except UserError as error:
            raise web.HTTPBadRequest(text=f"upload: {error}\n", headers={"Connection": "close"}) from error
        return web.Response(status=204)

    async def _blocks(self, request: web.Request):
        """What comes, in blocks. Raises TimeoutError for a sender that keeps its place by some bytes now and then."""
        content = request.content
        while True:
            async with asyncio.timeout(STALLED_S):
                block = await content.read(BLOCK)
                while block and len(block) < LEAST and (more := await content.read(BLOCK)):
                    block += more
            if not block:
                return
            yield block

    async def check(self, request: web.Request) -> web.Response:
        """Answers when the upload is decoded, with what it is."""
        self._check_type(request, "application/json")
        try:
            facts = await self._uploads.check(request.match_info["number"])
        except UserError as error:
            raise web.HTTPBadRequest(text=f"upload: {error}\n") from error
        self._state.refresh()
        return web.Response(body=msgspec.json.encode({"facts": facts}), content_type="application/json")

    async def remove(self, request: web.Request) -> web.Response:
        number = request.match_info["number"]
        if number in self._state.playing_uploads:
            raise web.HTTPConflict(text="upload: it is in use; choose another source or scene first\n")
        self._uploads.remove(number)
        self._state.refresh()
        return web.Response(status=204)

    def _check_type(self, request: web.Request, wanted: str) -> None:
        if self._state.settings.mode == "lossless":
            raise web.HTTPBadRequest(text="upload: in lossless mode nothing else is played\n")
        if request.content_type != wanted:
            raise web.HTTPUnsupportedMediaType(text=f"upload: send Content-Type: {wanted}\n")
