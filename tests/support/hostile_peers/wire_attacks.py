"""Attacks on the sockets of a service, by name. Each returns after how many seconds it was cut, or None."""

import contextlib
import resource
import socket
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import zmq

from tests.support.hostile_peers import zmtp
from vemlight.runtime import wire
from vemlight.runtime.transport import Transport, endpoint
from vemlight.settings import Settings

SECONDS = 4.0  # for which an attack goes on unless it is cut; a connection that is cut comes back
MB = 2**20


class Attack(NamedTuple):
    """An attack: what it does, the mode and the limit of files of the target, and whether it stands in for a service that others trust."""

    run: Callable[[Settings], float | None]
    mode: str = "live"
    files: int = 0  # 0: unlimited
    poses_as_capture: bool = False
    with_keys: bool = True  # it can be made with libzmq, whose own sockets have the keys


def _again_and_again(settings: Settings, role: str, kind: bytes, data: bytes, pause_s: float = 0.0) -> float | None:
    """A message without end to capture; each time it's cut, another one. After how long the first was."""
    began_s, first = time.monotonic(), None
    while time.monotonic() - began_s < SECONDS:
        try:
            with contextlib.closing(zmtp.opened(endpoint(settings.wire, "capture", role))) as connection:  # type: ignore[arg-type]
                zmtp.greet(connection, kind)
                cut_s = zmtp.send_until_cut(connection, data, SECONDS - (time.monotonic() - began_s), pause_s)
        except OSError:
            cut_s = None
            time.sleep(0.02)
        first = cut_s if first is None else first
    return first


def endless_1mb_requests(settings: Settings) -> float | None:
    return _again_and_again(settings, "serve", b"DEALER", zmtp.frame(bytes(MB), zmtp.MORE))


def endless_1mb_subscriptions(settings: Settings) -> float | None:
    return _again_and_again(settings, "publish", b"SUB", zmtp.frame(bytes(MB), zmtp.MORE))


def endless_small_requests(settings: Settings) -> float | None:
    return _again_and_again(settings, "serve", b"DEALER", 100 * zmtp.frame(bytes(1000), zmtp.MORE))


def endless_empty_requests(settings: Settings) -> float | None:
    return _again_and_again(settings, "serve", b"DEALER", 30000 * zmtp.frame(b"", zmtp.MORE))


def endless_empty_subscriptions(settings: Settings) -> float | None:
    return _again_and_again(settings, "publish", b"SUB", 30000 * zmtp.frame(b"", zmtp.MORE))


def slow_endless_requests(settings: Settings) -> float | None:
    return _again_and_again(settings, "serve", b"DEALER", 4096 * zmtp.frame(b"", zmtp.MORE), 0.001)


def _whole(settings: Settings, parts: list[bytes], times: int) -> float | None:
    """Whole messages through libzmq, with the keys if there are any."""
    transport = Transport(settings.wire)
    peer = transport.request_from("capture")
    ended = peer.get_monitor_socket(zmq.EVENT_DISCONNECTED)
    peer.send_multipart(parts)
    began_s = time.monotonic()
    for _ in range(times - 1):
        with contextlib.suppress(zmq.Again):
            peer.send_multipart(parts, zmq.NOBLOCK)
        if ended.poll(10):
            break
    cut_s = time.monotonic() - began_s if ended.poll(1e3 * SECONDS) else None
    transport.close()
    return cut_s


def whole_1200_x_1mb(settings: Settings) -> float | None:
    return _whole(settings, 1200 * [bytes(MB)], 1)


def whole_60_x_32mb(settings: Settings) -> float | None:
    return _whole(settings, 60 * [bytes(32 * MB)], 1)


def whole_million_empty(settings: Settings) -> float | None:
    return _whole(settings, 1_000_000 * [b""], 3)


def unreadable_requests(settings: Settings) -> float | None:
    random = np.random.default_rng(13)
    return _whole(settings, [b"request", random.bytes(300)], 200)


def hundred_thousand_subscriptions(settings: Settings) -> float | None:
    some = b"".join(zmtp.frame(b"\x01topic %d" % k) for k in range(100_000))
    return _again_and_again(settings, "publish", b"SUB", some)


def long_subscriptions(settings: Settings) -> float | None:
    random = np.random.default_rng(14)
    some = b"".join(zmtp.frame(b"\x01" + random.bytes(1 * MB)) for _ in range(8))
    return _again_and_again(settings, "publish", b"SUB", some)


def consumers_that_never_read(settings: Settings) -> float | None:
    """80 of them; each requests a thousand frames again and again."""
    transport = Transport(settings.wire)
    request = wire.pack(wire.RequestMessage(first=0, count=1024))
    consumers = [transport.request_from("capture") for _ in range(80)]
    until_s = time.monotonic() + 2 * SECONDS
    while time.monotonic() < until_s:
        for consumer in consumers:
            with contextlib.suppress(zmq.Again):
                consumer.send_multipart(request, zmq.NOBLOCK)
        time.sleep(0.2)
    transport.close()
    return None


def subscribers_beyond_the_files(settings: Settings) -> float | None:
    """300 of them."""
    soft = min(4096, resource.getrlimit(resource.RLIMIT_NOFILE)[1])
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, soft))
    context = zmq.Context()
    context.max_sockets = 2000
    transport = Transport(settings.wire, context)
    subscribers = [transport.subscribe("capture", "map") for _ in range(300)]
    time.sleep(SECONDS)
    transport.close()
    del subscribers
    return None


def raw_connections_beyond_the_files(settings: Settings) -> float | None:
    """2000 connections that say nothing, as fast as they can be opened."""
    address = endpoint(settings.wire, "capture", "publish")
    until_s = time.monotonic() + SECONDS
    opened: list[socket.socket] = []
    while time.monotonic() < until_s:
        try:
            opened.append(zmtp.opened(address))
        except OSError:
            time.sleep(0.001)
        if len(opened) > 2000:
            opened.pop(0).close()
    return None


def _as_capture(settings: Settings, data: bytes) -> float | None:
    """Publishes in capture's place."""
    listener = zmtp.listening(endpoint(settings.wire, "capture", "publish"))
    listener.settimeout(10.0)
    began_s, first = time.monotonic(), None
    while time.monotonic() - began_s < SECONDS:
        with contextlib.closing(listener.accept()[0]) as connection, contextlib.suppress(OSError):
            zmtp.greet(connection, b"XPUB")
            cut_s = zmtp.send_until_cut(connection, data, SECONDS)
            first = cut_s if first is None else first
    listener.close()
    return first


def frames_without_end(settings: Settings) -> float | None:
    return _as_capture(settings, zmtp.frame(b"map", zmtp.MORE) + zmtp.frame(bytes(MB), zmtp.MORE))


def frames_of_empty_parts(settings: Settings) -> float | None:
    return _as_capture(settings, zmtp.frame(b"map", zmtp.MORE) + 30000 * zmtp.frame(b"", zmtp.MORE))


def junk_frames(settings: Settings) -> float | None:
    return _as_capture(settings, zmtp.frame(b"map", zmtp.MORE) + 59 * zmtp.frame(bytes(32 * MB), zmtp.MORE) + zmtp.frame(bytes(32 * MB)))


ATTACKS = {
    "endless parts of 1 MB, requests": Attack(endless_1mb_requests, "lossless", with_keys=False),
    "endless parts of 1 MB, subscriptions": Attack(endless_1mb_subscriptions, with_keys=False),
    "endless parts of 1 kB, requests": Attack(endless_small_requests, "lossless", with_keys=False),
    "endless empty parts, requests": Attack(endless_empty_requests, "lossless", with_keys=False),
    "endless empty parts, subscriptions": Attack(endless_empty_subscriptions, with_keys=False),
    "endless empty parts, slowly": Attack(slow_endless_requests, "lossless", with_keys=False),
    "whole message of 1,200 x 1 MB": Attack(whole_1200_x_1mb, "lossless"),
    "whole message of 60 x 32 MB": Attack(whole_60_x_32mb, "lossless"),
    "whole messages of 10^6 empty parts": Attack(whole_million_empty, "lossless"),
    "unreadable requests": Attack(unreadable_requests, "lossless"),
    "10^5 subscriptions": Attack(hundred_thousand_subscriptions, with_keys=False),
    "subscriptions of 1 MB": Attack(long_subscriptions, with_keys=False),
    "80 consumers that never read": Attack(consumers_that_never_read, "lossless"),
    "300 subscribers at 256 files": Attack(subscribers_beyond_the_files, files=256),
    "2000 silent connections at 256 files": Attack(raw_connections_beyond_the_files, files=256),
    "frames without end": Attack(frames_without_end, poses_as_capture=True, with_keys=False),
    "frames of endless empty parts": Attack(frames_of_empty_parts, poses_as_capture=True, with_keys=False),
    "junk frames of 60 x 32 MB": Attack(junk_frames, poses_as_capture=True, with_keys=False),
}
