"""Who may ask what: against other people's web pages that reach for this one through the user's browser.

A page elsewhere can point its own name at this machine's address (DNS rebinding): the Host header then carries that name, and is
refused. It can also call this address straight: browsers then send its Origin, and what would act or open a socket is refused.
"""

import ipaddress
import socket
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from services.settings import Viewer

HEADERS = {
    "Content-Security-Policy": "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches what listens at `host`, a name or a number."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def gate(settings: Viewer) -> Middleware:
    """The middleware that refuses foreign names and foreign pages with 403 and one line."""
    names = {"localhost", settings.host.lower(), *(name.lower() for name in settings.names)}
    if not is_loopback(settings.host):
        names.add(socket.gethostname().lower())

    @web.middleware
    async def checked(request: web.Request, handler: Handler) -> web.StreamResponse:
        if not known_host(request.headers.get("Host", ""), names):
            raise web.HTTPForbidden(text="unknown Host: open the page by number, or add the name to [viewer] names\n")
        origin = request.headers.get("Origin")
        if origin is not None and urlsplit(origin).netloc.lower() != request.headers["Host"].lower():
            raise web.HTTPForbidden(text="another page's request: only this viewer's own page may do that\n")
        return await handler(request)

    return checked


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
    """On every answer that has not gone out yet."""
    for name, value in HEADERS.items():
        response.headers.setdefault(name, value)
