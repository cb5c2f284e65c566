"""Authentication middleware: keeps out other people, and other web pages that make requests through the user's browser.

A page elsewhere can point its own name at this machine's address (DNS rebinding): the Host header then carries that name, and is
refused. It can also call this address directly: browsers then send its Origin, and the request is refused.
Where there is a token, every request carries it: a browser's in a cookie, which it gets for the token in the page's address; a program's in
the address (`?token=`) or as `Authorization: Bearer`.
"""

import hmac
import ipaddress
import socket
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from vemlight.runtime.token import is_loopback
from vemlight.settings import Viewer

HEADERS = {
    "Content-Security-Policy": "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
NO_TOKEN = "no token: open the whole address that vemlight printed at its start; programs add ?token= or Authorization: Bearer\n"


def authentication_middleware(settings: Viewer) -> Middleware:
    """The middleware that refuses foreign names and foreign pages with 403, a missing token with 401, and one line."""
    names = {"localhost", settings.host.lower(), *(name.lower() for name in settings.names)}
    if not is_loopback(settings.host):
        names.add(socket.gethostname().lower())
    cookie = f"vemlight-{settings.port}"  # browsers keep cookies by host, and a machine may have several viewers

    @web.middleware
    async def checked(request: web.Request, handler: Handler) -> web.StreamResponse:
        if not known_host(request.headers.get("Host", ""), names):
            raise web.HTTPForbidden(text="unknown Host: open the page by number, or add the name to [viewer] names\n")
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc.lower() != request.headers["Host"].lower():
            raise web.HTTPForbidden(text="another page's request: only this viewer's own page may do that\n")
        if settings.token:
            if not any(is_token(given, settings.token) for given in tokens(request, cookie)):
                raise web.HTTPUnauthorized(text=NO_TOKEN, headers={"WWW-Authenticate": "Bearer"})
            if request.path == "/" and list(request.query) == ["token"]:  # out of the address, which others may read
                bare = web.HTTPSeeOther("/")
                bare.set_cookie(cookie, settings.token, httponly=True, samesite="Lax", secure=request.secure)
                raise bare
        return await handler(request)

    return checked


def tokens(request: web.Request, cookie: str) -> list[str]:
    """Every token that a request carries."""
    scheme, _, credentials = request.headers.get("Authorization", "").partition(" ")
    bearer = credentials.strip() if scheme.lower() == "bearer" else ""
    return [bearer, request.query.get("token", ""), request.cookies.get(cookie, "")]


def is_token(given: str, token: str) -> bool:
    """Whether they are equal, in a time that does not reveal how much of it is right."""
    return hmac.compare_digest(given.encode(errors="replace"), token.encode())


def known_host(host: str, names: set[str]) -> bool:
    """Whether a Host header names this machine: by a number, which nobody can point elsewhere, or by one of `names`."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
        urlsplit(f"//{host}").port  # noqa: B018  raises when it is no number
    except ValueError:
        return False
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name in names
    return True


async def add_headers(_: web.Request, response: web.StreamResponse) -> None:
    """Adds HEADERS to a response before it is sent."""
    for name, value in HEADERS.items():
        response.headers.setdefault(name, value)
