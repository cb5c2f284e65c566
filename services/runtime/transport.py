"""Sockets between the services: endpoints, limits against hostile peers, keys. The numbers' reasons are measurements in the comments.

Each service binds two sockets: `publish` (XPUB: its frames in live mode, its status always) and `serve` (ROUTER: its frames on
request, lossless mode).
"""

import fcntl
import os
import socket as network
import stat
import tempfile
from pathlib import Path
from typing import Any, Literal

import zmq
import zmq.auth
from zmq.auth.thread import ThreadAuthenticator

from vemlight.errors import UserError
from vemlight.runtime import wire
from vemlight.runtime.channels import CHANNELS, QUEUE_FRAMES, SERVICES, Service
from vemlight.settings import Wire

Role = Literal["publish", "serve"]
ROLES: tuple[Role, ...] = ("publish", "serve")
HANDSHAKE_MS = 2000  # libzmq's 30 s lets 800 silent connections hold 800 files
PROBE_S, PROBES = 1, 3  # tcp: after a second of silence the peer's kernel is asked; a host or container that vanished says no goodbye
ZAP_DOMAIN = "vemlight"  # the same on both sides: with a wildcard everyone is refused
KEY_NAME = "vemlight"
TOPICS = {channel.kind.encode() for channel in CHANNELS}


def runtime_folder(wire_settings: Wire) -> Path:
    """The folder of the ipc sockets, made with mode 0700. Raises UserError when others could write to it."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    default = Path(base) / "vemlight" if base else Path(tempfile.gettempdir()) / f"vemlight-{os.getuid()}"
    folder = Path(wire_settings.folder) if wire_settings.folder else default
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
    except OSError as error:
        raise UserError(f"{folder}: cannot hold the sockets ({error.strerror}); set [wire] folder to one you own") from error
    if found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o077:
        raise UserError(f"{folder}: others may use the sockets in it; run `chmod 700 {folder}` or set [wire] folder")
    longest = max(len(f"{folder}/{service}.{role}") for service in SERVICES for role in ROLES)
    if longest > 107:  # sun_path holds 108 bytes with its end
        raise UserError(f"{folder}: is too long a path for a socket ({longest} of 107 bytes); set [wire] folder to a shorter one")
    return folder


def endpoint(wire_settings: Wire, service: Service, role: Role) -> str:
    """Where `service` is reached."""
    if wire_settings.transport == "ipc":
        return f"ipc://{runtime_folder(wire_settings)}/{service}.{role}"
    host = wire_settings.hosts.get(service, "127.0.0.1")
    return f"tcp://{host}:{wire_settings.port + 2 * SERVICES.index(service) + ROLES.index(role)}"


class Transport:
    """A service's way to its sockets: one context, the keys, and the limits that every socket gets."""

    def __init__(self, settings: Wire, context: zmq.Context[Any] | None = None) -> None:
        """Raises UserError when the keys cannot be used."""
        self.settings = settings
        self.context = context or zmq.Context()
        self._keys: tuple[bytes, bytes] | None = None
        self._gate: ThreadAuthenticator | None = None
        self._claimed: list[tuple[int, Path]] = []
        if settings.transport == "tcp" and settings.keys:
            self._keys = read_keys(Path(settings.keys))

    def bind(self, service: Service, role: Role) -> Any:
        """The socket that `service` binds: XPUB or ROUTER. Raises UserError when the port is taken."""
        self._claim(service, role)
        kind = zmq.XPUB if role == "publish" else zmq.ROUTER
        socket = self._limited(kind)
        if role == "publish":
            socket.setsockopt(zmq.XPUB_MANUAL, 1)  # see `admit`
        else:
            socket.setsockopt(zmq.ROUTER_MANDATORY, 1)  # a consumer that died raises instead of swallowing frames
        if self._keys:
            self._guard()
            socket.curve_server = True
            socket.zap_domain = ZAP_DOMAIN.encode()
        address = endpoint(self.settings, service, role)
        try:
            socket.bind(_numeric(address))
        except (zmq.ZMQError, OSError) as error:
            socket.close()
            raise UserError(
                f"{address}: {service} cannot listen there ({error.strerror}); stop what holds it or change [wire]"
            ) from error
        return socket

    def subscribe(self, service: Service, *kinds: str) -> Any:
        """A SUB socket that hears these kinds of message from `service`; it may start before the other does."""
        socket = self._limited(zmq.SUB)
        for kind in kinds:
            socket.subscribe(kind.encode())
        self._call(socket, service, "publish")
        return socket

    def ask(self, service: Service) -> Any:
        """A DEALER socket that asks `service` for frames."""
        socket = self._limited(zmq.DEALER)
        self._call(socket, service, "serve")
        return socket

    def close(self) -> None:
        """Closes every socket and lets the ipc files go."""
        if self._gate:
            self._gate.stop()
        self.context.destroy(linger=0)
        for lock, path in self._claimed:
            path.unlink(missing_ok=True)
            path.with_suffix(f"{path.suffix}.lock").unlink(missing_ok=True)
            os.close(lock)

    def _claim(self, service: Service, role: Role) -> None:
        """An ipc socket would take over its file from another process without a word: whoever binds holds a lock beside it."""
        if self.settings.transport != "ipc":
            return
        path = runtime_folder(self.settings) / f"{service}.{role}"
        lock = os.open(path.with_suffix(f"{path.suffix}.lock"), os.O_CREAT | os.O_RDWR, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(lock)
            raise UserError(f"{path}: another {service} runs there; stop it or set [wire] folder to another one") from error
        self._claimed.append((lock, path))

    def _limited(self, kind: int) -> Any:
        socket: Any = self.context.socket(kind)
        socket.linger = 0
        socket.maxmsgsize = wire.MAX_PART
        socket.handshake_ivl = HANDSHAKE_MS
        socket.sndhwm = socket.rcvhwm = QUEUE_FRAMES
        socket.reconnect_ivl, socket.reconnect_ivl_max = 50, 500  # ms
        socket.tcp_keepalive, socket.tcp_keepalive_cnt = 1, PROBES
        socket.tcp_keepalive_idle = socket.tcp_keepalive_intvl = PROBE_S
        if self._keys:
            socket.curve_publickey, socket.curve_secretkey = self._keys
        return socket

    def _call(self, socket: Any, service: Service, role: Role) -> None:
        if self._keys:
            socket.curve_serverkey = self._keys[0]
        socket.connect(endpoint(self.settings, service, role))

    def _guard(self) -> None:
        """Only peers whose public key lies in the keys' folder are let in."""
        if self._gate is None:
            self._gate = ThreadAuthenticator(self.context)
            self._gate.start()
            self._gate.configure_curve(domain=ZAP_DOMAIN, location=self.settings.keys)


def admit(publisher: Any) -> None:
    """Takes the subscriptions that wait at a publisher, and only those to our channels: an XPUB keeps each one, 10 kB apiece."""
    while publisher.poll(0, zmq.POLLIN):
        _admit_one(publisher, publisher.recv(zmq.NOBLOCK))


async def keep_admitting(publisher: Any) -> None:
    """`admit` for a publisher of zmq.asyncio, until it is cancelled."""
    while True:
        _admit_one(publisher, await publisher.recv())


def _admit_one(publisher: Any, wish: bytes) -> None:
    topic = wish[1:]
    if topic in TOPICS:
        publisher.setsockopt(zmq.SUBSCRIBE if wish[:1] == b"\x01" else zmq.UNSUBSCRIBE, topic)


def _numeric(address: str) -> str:
    """tcp sockets bind to numbers, not names."""
    if not address.startswith("tcp://"):
        return address
    host, port = address.removeprefix("tcp://").rsplit(":", 1)
    return f"tcp://{network.gethostbyname(host)}:{port}"


def make_keys(folder: Path) -> None:
    """Makes the CURVE key pair that the services of one installation share; the secret file gets mode 0600."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    secret = folder / f"{KEY_NAME}.key_secret"
    if secret.exists():
        raise UserError(f"{secret}: there are keys already; remove them first if they are to be replaced")
    zmq.auth.create_certificates(folder, KEY_NAME)
    secret.chmod(0o600)


def read_keys(folder: Path) -> tuple[bytes, bytes]:
    """(public, secret). Raises UserError when they are missing or others may read the secret."""
    secret = folder / f"{KEY_NAME}.key_secret"
    try:
        if stat.S_IMODE(secret.stat().st_mode) & 0o077:
            raise UserError(f"{secret}: others may read this key; run `chmod 600 {secret}`")
        public, private = zmq.auth.load_certificate(secret)
    except OSError as error:
        raise UserError(f"{secret}: cannot be read ({error.strerror}); make keys with `vemlight keys {folder}`") from error
    except ValueError as error:
        raise UserError(f"{secret}: holds no key; make new ones with `vemlight keys`") from error
    if private is None:
        raise UserError(f"{secret}: holds no secret key; make new ones with `vemlight keys`")
    return public, private
