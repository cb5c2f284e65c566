"""Authentication middleware: keeps out other people, and other web pages that make requests through the user's browser.

A page elsewhere can point its own name at this machine's address (DNS rebinding): the Host header then carries that name, and is
refused. It can also call this address directly: browsers then send its Origin, and the request is refused.
Where there is a token, every request carries it: a browser's by a cookie, which it gets for the token in the page's address; a program's in
the address (`?token=`) or as `Authorization: Bearer`.
"""

import hashlib
import hmac
import ipaddress
import socket
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from vemlight.runtime.allowance import Allowance
from vemlight.runtime.token import is_loopback
from vemlight.settings import Viewer
from vemlight.viewer.connections import connection_of

HEADERS = {
    "Content-Security-Policy": "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
PORTS = {"http": 80, "https": 443}
GUESSES_BURST, GUESSES_PER_S = 20, 0.2  # wrong tokens of an address: a person mistypes a few. In a year six million
MAX_ADDRESSES = 1024  # of which wrong tokens are counted
SCRYPT = {"n": 2**14, "r": 8, "p": 1}  # 16 MB and 50 ms once at the start, and for each guess
FOREIGN = "another page's request: only this viewer's own page may do that; the websocket also those in [viewer] origins\n"
TOO_MANY = "too many wrong tokens from this address: wait a minute\n"
NO_TOKEN = "no token: open the whole address that vemlight printed at its start; programs add ?token= or Authorization: Bearer\n"


def authentication_middleware(settings: Viewer) -> Middleware:
    """The middleware that refuses foreign names and foreign pages with 403, a missing token with 401, and one line."""
    names = {"localhost", settings.host.lower(), *(name.lower() for name in settings.names)}
    if not is_loopback(settings.host):
        names.add(socket.gethostname().lower())
    cookie = f"vemlight-{settings.port}"  # browsers keep cookies by host, and a machine may have several viewers

    guesses = Guesses(settings.token)

    @web.middleware
    async def checked(request: web.Request, handler: Handler) -> web.StreamResponse:
        hosts = request.headers.getall("Host", [])
        if len(hosts) != 1 or not known_host(hosts[0], names):
            raise web.HTTPForbidden(text="unknown Host: open the page by number, or add the name to [viewer] names\n")
        scheme = request.headers.get("X-Forwarded-Proto", request.scheme)  # a TLS proxy's; another page in a browser cannot add it
        # A page elsewhere that the settings name may read the feeds, for which a browser sends no cookie: it needs the token itself.
        others = settings.origins if request.path == "/ws" else ()
        if any(not (origin in others or is_origin(origin, scheme, hosts[0])) for origin in request.headers.getall("Origin", [])):
            raise web.HTTPForbidden(text=FOREIGN)
        if settings.token:
            guesses.check(request, tokens(request), request.cookies.get(cookie, ""))
            if request.path == "/" and list(request.query) == ["token"]:  # out of the address, which others may read
                bare = web.HTTPSeeOther("/")
                bare.set_cookie(cookie, guesses.cookie, httponly=True, samesite="Lax", secure=request.secure)
                raise bare
        return await handler(request)

    return checked


class Guesses:
    """Compares tokens, and limits how often an address may be wrong; who has the cookie is never refused for others' guesses."""

    def __init__(self, token: str) -> None:
        self.cookie = cookie_of(token) if token else ""
        self._token = token
        self._wrong: dict[str, Allowance] = {}

    def check(self, request: web.Request, given: list[str], cookie: str) -> None:
        """Raises HTTPUnauthorized for a request without the token and HTTPTooManyRequests after too many wrong ones."""
        connection = connection_of(request)
        if is_token(cookie, self.cookie) or (connection and connection.has_token and any(is_token(one, self._token) for one in given)):
            return
        if not any(given):
            raise web.HTTPUnauthorized(text=NO_TOKEN, headers={"WWW-Authenticate": "Bearer"})
        allowance = self._of_address(connection.address if connection else request.remote or "")
        if not allowance.has():
            raise web.HTTPTooManyRequests(text=TOO_MANY, headers={"Retry-After": str(round(1 / GUESSES_PER_S))})
        if not any(is_token(one, self._token) for one in given):
            allowance.take()
            raise web.HTTPUnauthorized(text=NO_TOKEN, headers={"WWW-Authenticate": "Bearer"})
        if connection:
            connection.has_token = True

    def _of_address(self, address: str) -> Allowance:
        if address not in self._wrong:
            if len(self._wrong) >= MAX_ADDRESSES:
                self._wrong = {known: allowance for known, allowance in self._wrong.items() if not allowance.is_full}
            if len(self._wrong) >= MAX_ADDRESSES:
                self._wrong.pop(next(iter(self._wrong)))
            self._wrong[address] = Allowance(GUESSES_BURST, GUESSES_PER_S)
        return self._wrong[address]


def cookie_of(token: str) -> str:
    """What a browser keeps in place of the token: trying a token by it costs as much work as SCRYPT takes (RFC 7914)."""
    return hashlib.scrypt(token.encode(), salt=b"vemlight page", **SCRYPT).hex()


def tokens(request: web.Request) -> list[str]:
    """Every token that a request carries by itself."""
    scheme, _, credentials = request.headers.get("Authorization", "").partition(" ")
    bearer = credentials.strip() if scheme.lower() == "bearer" else ""
    return [bearer, request.query.get("token", "")]


def is_origin(origin: str, scheme: str, host: str) -> bool:
    """Whether an Origin header names the page itself: its scheme, name and port."""
    own = f"{scheme}://{host}"
    try:
        return _place(origin) == _place(own)
    except ValueError:
        return False


def _place(url: str) -> tuple[str, str, int]:
    parts = urlsplit(url)
    if parts.scheme not in PORTS or not parts.hostname:
        raise ValueError(f"{url}: is no page's")
    return parts.scheme, parts.hostname, parts.port or PORTS[parts.scheme]


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
