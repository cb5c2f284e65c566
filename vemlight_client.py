"""Lights of a running vemlight in another Python program, without vemlight: needs pyzmq, numpy, and msgpack or msgspec.

    from vemlight_client import lights

    for frame in lights("tcp://127.0.0.1:5602"):
        print(frame.sequence, len(frame.ids), frame.directions[0], frame.irradiance.sum(axis=0))

The wire protocol that it reads is described in proto/README.md.
"""

import os
import re
import tempfile
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import zmq

VERSION = 2  # of the wire protocol
POLL_MS = 100  # between two looks at the clock
QUEUE = 1000  # messages that wait at most, half a minute and 5 MB of them; a full queue would keep the old and drop the new
MAX_PART = 64 * 2**20  # bytes
# A connection from which nothing comes for so long, not even the status twice a second, is made anew: a new one takes ten ways over the
# link before its first frame, and after a shorter cut the old one goes on sooner
SILENCE_S = 10.0
RECONNECT_MS, CONNECT_MS = 50, 700  # between two attempts; for one, so that one is made soon after a cut's end
KEY = re.compile(r"^\s*(public|secret)-key\s*=\s*[\"'](.{40})[\"']\s*$", re.MULTILINE)


class Lights(NamedTuple):
    """One frame. ids: (n,) int64, the same as long as a light lives. directions: (n, 3) float32, unit vectors towards the light, z up.

    irradiance: (n, 3) float32, linear Rec. 709 on a plane that faces the light. covariances: (n, 6) float32, xx xy xz yy yz zz of the
    directions of each light's light; None: points. time_s: on the source's own clock.
    """

    sequence: int
    time_s: float
    ids: np.ndarray
    directions: np.ndarray
    irradiance: np.ndarray
    covariances: np.ndarray | None


def lights(
    address: str = "", keys: str | Path | None = None, timeout_s: float | None = None, context: "zmq.Context[Any] | None" = None
) -> Generator[Lights, None, None]:
    """The newest frame each time one is asked for; frames that came meanwhile are passed over. Ends never. Of a rig of cameras the
    sampler's lights are without near lights; a relay's have them, as directional lights.

    address: of the sampler's or a relay's `publish` socket, tcp://HOST:5602 or ipc:///FOLDER/sampler.publish; empty: this user's, on this
    machine. keys: the folder that `vemlight keys` made, for tcp with keys. Raises TimeoutError when none comes for `timeout_s`, ValueError
    for a message of another version of the protocol, FileNotFoundError and ValueError for keys that are not there or none.
    """
    decode = _decoder()
    pair = None if keys is None else _keys(Path(keys))
    address, owner = address or _own_address(), context or zmq.Context.instance()
    socket = _connected(owner, address, pair)
    try:
        frame_s = heard_s = time.monotonic()
        while True:
            newest: list[bytes] = []
            while socket.poll(0 if newest else POLL_MS):
                parts = socket.recv_multipart()
                heard_s = time.monotonic()
                newest = newest if parts[0] == b"status" else parts
            now_s = time.monotonic()
            if newest:
                yield _frame(newest, decode)
                frame_s = heard_s = time.monotonic()  # what the caller takes is no silence
            elif timeout_s is not None and now_s - frame_s > timeout_s:
                raise TimeoutError(f"{address}: no lights within {timeout_s} s; is the sampler running there?")
            elif now_s - heard_s > SILENCE_S:
                socket.close()
                socket, heard_s = _connected(owner, address, pair), now_s
    finally:
        socket.close()


def _connected(context: Any, address: str, keys: tuple[bytes, bytes] | None) -> Any:
    socket = context.socket(zmq.SUB)
    socket.linger, socket.rcvhwm, socket.maxmsgsize = 0, QUEUE, MAX_PART
    socket.reconnect_ivl, socket.connect_timeout = RECONNECT_MS, CONNECT_MS
    if keys:
        socket.curve_publickey, socket.curve_secretkey = keys
        socket.curve_serverkey = keys[0]
    for kind in (b"lights", b"status"):
        socket.subscribe(kind)
    socket.connect(address)
    return socket


def _frame(parts: list[bytes], decode: Callable[[bytes], Any]) -> Lights:
    """Raises ValueError for anything but lights of this version."""
    header = decode(parts[1]) if len(parts) > 1 else None
    if not isinstance(header, dict) or header.get("kind") != "lights":
        raise ValueError("not a message of lights: is the address that of the sampler's `publish` socket?")
    if header.get("version", 1) != VERSION:
        raise ValueError(f"message of wire version {header.get('version', 1)}; this client reads {VERSION}")
    count = header["count"]
    shapes = [("<i8", (count,)), ("<f4", (count, 3)), ("<f4", (count, 3))] + [("<f4", (count, 6))] * bool(header.get("soft"))
    arrays = []
    for part, (dtype, shape) in zip(parts[2:], shapes, strict=False):
        array = np.frombuffer(part, dtype)
        if array.size != np.prod(shape):
            raise ValueError(f"lights: array of {array.size} numbers, the header says {shape}")
        arrays.append(array.reshape(shape))
    if len(arrays) != len(shapes):
        raise ValueError(f"lights: {len(arrays)} arrays, the header says {len(shapes)}")
    stamp = header["stamp"]
    return Lights(stamp["sequence"], stamp["time_s"], *arrays, *([None] * (4 - len(arrays))))


def _decoder() -> Callable[[bytes], Any]:
    try:
        from msgspec.msgpack import decode
    except ImportError:
        from msgpack import unpackb as decode  # pyright: ignore[reportMissingImports]
    return decode


def _keys(folder: Path) -> tuple[bytes, bytes]:
    found = dict(KEY.findall((folder / "vemlight.key_secret").read_text()))
    if found.keys() != {"public", "secret"}:
        raise ValueError(f"{folder / 'vemlight.key_secret'}: holds no key pair; copy the folder that `vemlight keys` made")
    return found["public"].encode(), found["secret"].encode()


def _own_address() -> str:
    """Where vemlight's services of this user publish by default."""
    base = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(base) / "vemlight" if base else Path(tempfile.gettempdir()) / f"vemlight-{os.getuid()}"
    return f"ipc://{folder}/sampler.publish"
