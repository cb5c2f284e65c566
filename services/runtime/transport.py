"""Sockets between the services: endpoints, limits against hostile peers, keys.

Each service binds two sockets: `publish` (XPUB: its frames in live mode, its status always) and `serve` (ROUTER: its frames on
request, lossless mode).
"""

import fcntl
import os
import re
import socket as network
import stat
import tempfile
from pathlib import Path
from typing import Any, Literal, NamedTuple

import zmq

from vemlight.errors import UserError
from vemlight.files import read_file, writing_to
from vemlight.runtime import wire
from vemlight.runtime.channels import BY_KIND, QUEUE_FRAMES, SERVICES, Instance
from vemlight.runtime.peer_guard import PeerGuard
from vemlight.runtime.peers import receive
from vemlight.runtime.wire_names import first_port, host_of
from vemlight.settings import Wire

Role = Literal["publish", "serve"]
ROLES: tuple[Role, ...] = ("publish", "serve")
MAX_SOCKET_PATH = 107  # bytes: sun_path holds 108 with the final 0
# At libzmq's 30 s, 800 silent connections hold 800 files; a handshake takes under 100 ms on a busy machine. 1 to 3 s would do.
HANDSHAKE_MS = 2000
# tcp: a host or container that vanished sends no FIN. After a second of silence its kernel is probed once a second, and the third
# probe in a row without an answer ends the connection: 4 s in all.
KEEPALIVE_S, KEEPALIVE_PROBES = 1, 3
# tcp: a peer that takes nothing of what waits for it for so long is disconnected, and connects again when it goes on: with keys each
# holds a copy of a frame. 5 to 30 s would do
TAKES_NOTHING_MS = 10_000
# bytes of a part to a socket that services bind. A request has 60, a subscription 9, the keys' handshake up to 600; 700 to 4096 would do
MAX_ASKED = 1024
KEYS_OVERHEAD = 64  # bytes that encryption adds to a part: 33; 33 and more would do
BACKLOG = 16  # peers that wait to be accepted; others try again. 8 to 64 would do
MAX_TAKEN = 256  # subscriptions at once, so that a flood of them does not keep a service from its work; 64 to 1024 would do
# A restarted service is found, and a link that heals is in use again, within the sum of the last two and a handshake. On the first attempt
# the system would wait a second and more before it asks again. A round trip by a geostationary satellite takes 600 ms.
RECONNECT_MS, MAX_RECONNECT_MS, CONNECT_MS = 50, 200, 650
ZAP_DOMAIN = "vemlight"  # the same on both sides: with a wildcard everyone is refused
KEY_NAME = "vemlight"
MAX_KEY_BYTES = 4096  # `vemlight keys` writes 800
Z85 = rb"[0-9A-Za-z.:+=^!/*?&<>()\[\]{}@%$#-]"  # ZeroMQ's 85 digits
KEY_LINE = re.compile(rb"^[ \t]*(public|secret)-key[ \t]*=[ \t]*[\"'](" + Z85 + rb"{40})[\"'][ \t\r]*$", re.MULTILINE)
_TOPICS = {kind.encode() for kind in BY_KIND}


def runtime_folder(settings: Wire) -> Path:
    """The folder of the ipc sockets, made with mode 0700. Raises UserError when others could use or write to it."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    default = Path(base) / "vemlight" if base else Path(tempfile.gettempdir()) / f"vemlight-{os.getuid()}"
    folder = Path(settings.folder) if settings.folder else default
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
    except OSError as error:
        raise UserError(f"{folder}: cannot hold the sockets ({error.strerror}); set [wire] folder to one you own") from error
    if found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o077:
        raise UserError(f"{folder}: others may use the sockets in it; run `chmod 700 {folder}` or set [wire] folder")
    longest = max(len(f"{folder}/{name}.{role}".encode()) for name in (*SERVICES, *settings.names.values()) for role in ROLES)
    if longest > MAX_SOCKET_PATH:
        raise UserError(_too_long(folder, longest))
    return folder


def _too_long(folder: Path, longest: int) -> str:
    return f"{folder}: is too long a path for a socket ({longest} of {MAX_SOCKET_PATH} bytes); set [wire] folder to a shorter one"


def endpoint(settings: Wire, name: Instance, role: Role) -> str:
    """Where a socket of the service or instance `name` is reached. Raises UserError where it has none."""
    if settings.transport == "ipc":
        path = runtime_folder(settings) / f"{name}.{role}"
        if len(bytes(path)) > MAX_SOCKET_PATH:
            raise UserError(_too_long(path.parent, len(bytes(path))))
        return f"ipc://{path}"
    first = first_port(settings, name)
    if first is None:
        raise UserError(f'[wire] ports: has none for {name}; give each its own two, such as ports = {{"{name}" = 5620}}')
    return f"tcp://{host_of(settings, name)}:{first + ROLES.index(role)}"


class Keys(NamedTuple):
    """The CURVE key pair of all services of an installation."""

    public: bytes
    secret: bytes


class _ClaimedSocket(NamedTuple):
    """An ipc socket's file, and the open file beside it that holds the lock."""

    path: Path
    lock_path: Path
    lock: int


class Transport:
    """A service's sockets: one context, the keys, and the limits that every socket gets."""

    def __init__(self, settings: Wire, context: zmq.Context[Any] | None = None) -> None:
        """Raises UserError when the keys cannot be used."""
        self.settings = settings
        self.context = context or zmq.Context()
        self._keys: Keys | None = None
        self._authenticator: Any = None  # a ThreadAuthenticator, with keys
        self._guard: PeerGuard | None = None
        self._claimed: list[_ClaimedSocket] = []
        if settings.transport == "tcp" and settings.keys:
            self._keys = read_keys(Path(settings.keys))

    def bind(self, service: Instance, role: Role, send_buffer: int = -1) -> Any:
        """The socket that `service` binds: XPUB or ROUTER. send_buffer: bytes that the kernel keeps for a peer; -1: as it likes.

        Raises UserError when the address is taken.
        """
        self._claim(service, role)
        if role == "publish":
            socket = self._socket(zmq.XPUB, QUEUE_FRAMES, MAX_ASKED)
            socket.setsockopt(zmq.XPUB_MANUAL, 1)  # see `accept_subscriptions`
        else:
            socket = self._socket(zmq.ROUTER, QUEUE_FRAMES, MAX_ASKED)
            socket.setsockopt(zmq.ROUTER_MANDATORY, 1)  # a consumer that died raises instead of swallowing frames
        socket.sndbuf = send_buffer
        if self._keys:
            self._authenticate()
            socket.curve_server = True
            socket.zap_domain = ZAP_DOMAIN.encode()
        address = endpoint(self.settings, service, role)
        door = Path(address.removeprefix("ipc://")) if self.settings.transport == "ipc" else None
        self._guard_of_peers().watch(socket, service, accepts=True, takes_frames=False, door=door)
        try:
            socket.bind(_numeric(address))
        except (zmq.ZMQError, OSError) as error:
            socket.close()
            raise UserError(f"{address}: {service} cannot listen there ({error.strerror}); stop what holds it or change [wire]") from error
        return socket

    def subscribe(self, service: Instance, *kinds: str) -> Any:
        """A SUB socket that receives these kinds of message from `service`; it may be made before the other is there."""
        takes_frames = any(wire.KINDS[kind].ARRAYS for kind in kinds)
        max_part = wire.MAX_PART if takes_frames else wire.MAX_HEADER + KEYS_OVERHEAD
        socket = self._socket(zmq.SUB, max(BY_KIND[kind].queue for kind in kinds), max_part)
        for kind in kinds:
            socket.subscribe(kind.encode())
        self._connect(socket, service, "publish", takes_frames)
        return socket

    def request_from(self, service: Instance) -> Any:
        """A DEALER socket that requests frames from `service`."""
        socket = self._socket(zmq.DEALER, QUEUE_FRAMES, wire.MAX_PART)
        self._connect(socket, service, "serve", takes_frames=True)
        return socket

    def close(self) -> None:
        """Closes every socket and removes the files of the ipc sockets."""
        if self._authenticator:
            self._authenticator.stop()
        if self._guard:
            self._guard.stop()
        self.context.destroy(linger=0)
        for claimed in self._claimed:
            claimed.path.unlink(missing_ok=True)
            claimed.lock_path.unlink(missing_ok=True)
            os.close(claimed.lock)

    def _claim(self, service: Instance, role: Role) -> None:
        """Locks an ipc socket's address: binding would silently take over its file from another process."""
        if self.settings.transport != "ipc":
            return
        path = runtime_folder(self.settings) / f"{service}.{role}"
        lock_path = path.with_suffix(f"{path.suffix}.lock")
        try:
            lock = _locked(lock_path)
        except BlockingIOError as error:
            raise UserError(f"{path}: another {service} runs there; stop it or set [wire] folder to another one") from error
        except OSError as error:
            raise UserError(f"{lock_path}: cannot be locked ({error.strerror}); make room, or set [wire] folder to another one") from error
        self._claimed.append(_ClaimedSocket(path, lock_path, lock))

    def _socket(self, kind: int, queue: int, max_part: int) -> Any:
        """A socket of that kind with its limits, whose queue holds that many messages a peer, of parts up to `max_part` bytes."""
        socket: Any = self.context.socket(kind)
        socket.linger, socket.backlog = 0, BACKLOG
        socket.maxmsgsize = max_part
        socket.handshake_ivl = HANDSHAKE_MS
        socket.sndhwm = socket.rcvhwm = queue
        socket.reconnect_ivl, socket.reconnect_ivl_max, socket.connect_timeout = RECONNECT_MS, MAX_RECONNECT_MS, CONNECT_MS
        socket.tcp_keepalive, socket.tcp_keepalive_cnt = 1, KEEPALIVE_PROBES
        socket.tcp_keepalive_idle = socket.tcp_keepalive_intvl = KEEPALIVE_S
        socket.setsockopt(zmq.TCP_MAXRT, TAKES_NOTHING_MS)
        if self._keys:
            socket.curve_publickey, socket.curve_secretkey = self._keys
        return socket

    def _connect(self, socket: Any, service: Instance, role: Role, takes_frames: bool) -> None:
        if self._keys:
            socket.curve_serverkey = self._keys.public
        self._guard_of_peers().watch(socket, service, accepts=False, takes_frames=takes_frames)
        socket.connect(endpoint(self.settings, service, role))

    def _guard_of_peers(self) -> PeerGuard:
        if self._guard is None:
            self._guard = PeerGuard(zmq.Context.shadow(self.context))
        return self._guard

    def _authenticate(self) -> None:
        """From now on only peers whose public key lies in the keys' folder can connect."""
        if self._authenticator is None:
            for path in sorted(Path(self.settings.keys).glob("*.key")):
                _keys_in(path, path.parent)  # a damaged one would end the authenticator's thread
            from zmq.auth.thread import ThreadAuthenticator  # here, since it loads asyncio

            self._authenticator = ThreadAuthenticator(self.context)
            self._authenticator.start()
            self._authenticator.configure_curve(domain=ZAP_DOMAIN, location=self.settings.keys)


def _locked(path: Path) -> int:
    """The file of that name, made and locked. Raises BlockingIOError where another process has it, OSError where it cannot be made."""
    while True:
        lock = os.open(path, os.O_CREAT | os.O_RDWR, 0o600)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(lock), os.stat(path)):
                return lock
        except FileNotFoundError:  # who had it has removed it between the two calls: the next of that name is another file
            pass
        except OSError:
            os.close(lock)
            raise
        os.close(lock)


def accept_subscriptions(publisher: Any) -> set[str]:
    """Takes the subscriptions that wait at a publisher, and only those to our channels: an XPUB keeps each one, 10 kB apiece.

    Returns the kinds of message to which somebody has subscribed now.
    """
    subscribed: set[str] = set()
    for _ in range(MAX_TAKEN):
        try:
            subscription, sender = receive(publisher)
        except zmq.Again:
            break
        if sender:
            sender.on_subscription()
        if kind := _accept(publisher, b"".join(subscription)):
            subscribed.add(kind)
    return subscribed


async def keep_accepting_subscriptions(publisher: Any) -> None:
    """`accept_subscriptions` for a publisher of zmq.asyncio, until it is cancelled."""
    waiting = zmq.Socket.shadow(publisher)
    while True:
        await publisher.poll()
        accept_subscriptions(waiting)


def _accept(publisher: Any, subscription: bytes) -> str:
    """`subscription`: 1 to subscribe or 0 to unsubscribe, and the topic. Returns the kind subscribed to, if there is such."""
    topic, subscribes = subscription[1:], subscription[:1] == b"\x01"
    if topic not in _TOPICS:
        return ""
    publisher.setsockopt(zmq.SUBSCRIBE if subscribes else zmq.UNSUBSCRIBE, topic)
    return topic.decode() if subscribes else ""


def _numeric(address: str) -> str:
    """tcp sockets bind to numbers, not names."""
    if not address.startswith("tcp://"):
        return address
    host, port = address.removeprefix("tcp://").rsplit(":", 1)
    return f"tcp://{network.gethostbyname(host)}:{port}"


def make_keys(folder: Path) -> None:
    """Makes the CURVE key pair; the secret file gets mode 0600. Raises UserError when there is one already."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    secret = folder / f"{KEY_NAME}.key_secret"
    if secret.exists():
        raise UserError(f"{secret}: there are keys already; remove them first if they are to be replaced")
    import zmq.auth

    before = os.umask(0o077)
    try:
        with tempfile.TemporaryDirectory(dir=folder) as made, writing_to(folder):  # a full disk leaves no half of a key
            for path in map(Path, zmq.auth.create_certificates(made, KEY_NAME)):
                os.replace(path, folder / path.name)
    finally:
        os.umask(before)


def read_keys(folder: Path) -> Keys:
    """The key pair in a folder. Raises UserError when it is missing, damaged, or others may read the secret one."""
    secret = folder / f"{KEY_NAME}.key_secret"
    found = _keys_in(secret, folder)
    public, private = found.get("public", b""), found.get("secret")
    if private is None:
        raise UserError(f"{secret}: holds no secret key; make new ones with `vemlight keys`")
    try:
        fit = zmq.curve_public(private) == public
    except zmq.ZMQError:
        fit = False
    if not fit:
        raise UserError(f"{secret}: its two keys do not fit together; make new ones with `vemlight keys`, or copy the file again")
    if stat.S_IMODE(secret.stat().st_mode) & 0o077:
        raise UserError(f"{secret}: others may read this key; run `chmod 600 {secret}`")
    return Keys(public, private)


def _keys_in(path: Path, folder: Path) -> dict[str, bytes]:
    """What a key file of CZMQ's form holds: "public" and perhaps "secret", 40 characters each. Raises UserError where there is no key."""
    if not path.exists():
        raise UserError(f"{path}: there is no such file; make keys with `vemlight keys {folder}`")
    found = {name.decode(): key for name, key in KEY_LINE.findall(read_file(path, MAX_KEY_BYTES))}
    if "public" not in found:
        raise UserError(f"{path}: holds no key; make new ones with `vemlight keys`, or take the file away")
    return found
