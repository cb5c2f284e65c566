"""When a source begins: a camera of which so many frames are wanted counts none that nobody hears."""

import os
import signal
import threading
from collections.abc import Iterator

import numpy as np
import pytest

from vemlight.runtime import stamps, wire
from vemlight.runtime.channels import Service
from vemlight.runtime.loop import publish_status
from vemlight.runtime.peers import receive
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.source_loop import run_camera
from vemlight.runtime.source_protocols import LISTENERS, CameraMessage, Listeners
from vemlight.runtime.transport import Transport, accept_subscriptions
from vemlight.settings import Settings

UNHEARD = 7  # frames before the sampler is ready
NO_CELLS = (np.empty(0, np.int64), np.empty((0, 3), np.float32), np.empty(0, np.float32))


class CountingCamera:
    """A frame whenever one is asked for. The sampler's first status is published after UNHEARD of them."""

    service: Service = "capture"
    unwritten = 0

    def __init__(self, settings: Settings, limit: int | None) -> None:
        self.limit, self.made = limit, 0
        self._transport = Transport(settings.wire)
        self._sampler, self._stats = self._transport.bind("sampler", "publish"), ServiceStats("sampler", 0)

    def message(self, wait_s: float) -> tuple[CameraMessage | None, int]:
        threading.Event().wait(0.05)
        accept_subscriptions(self._sampler)
        if self.made >= UNHEARD:
            publish_status(self._sampler, self._stats)
        self.made += 1
        header = wire.MapMessage(stamp=stamps.stamp(self.made, self.made / 20), rows=2, cols=4, coverage="hemisphere")
        return (header, (np.ones((2, 4, 3), np.float32), *NO_CELLS)), 1

    def on_control(self, control: wire.ControlMessage) -> None:
        pass

    def close(self) -> None:
        self._transport.close()


@pytest.fixture
def handlers() -> Iterator[None]:
    """The signals' handlers, as they were after the test."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize("limit", [3, None])
def test_of_so_many_frames_none_comes_before_the_listeners_are_ready(limit, make_settings, monkeypatch):
    settings, _ = make_settings()
    monkeypatch.setenv(LISTENERS, "sampler")
    camera = CountingCamera(settings, limit)
    seen: list[int] = []

    def listen() -> None:
        transport = Transport(settings.wire)
        frames = transport.subscribe("capture", "map", "end")
        while frames.poll(10_000):
            header, _ = wire.unpack(receive(frames).parts)
            if not isinstance(header, wire.MapMessage) or len(seen) == UNHEARD:
                break
            seen.append(header.stamp.sequence)
        transport.close()
        os.kill(os.getpid(), signal.SIGTERM)

    listener = threading.Thread(target=listen)
    listener.start()
    run_camera(settings, camera)
    listener.join()
    if limit:
        assert len(seen) == limit
        assert min(seen) > UNHEARD
    else:
        assert min(seen) <= UNHEARD  # it is looked at while the others still compile


def test_who_never_comes_is_named_and_waited_for_no_longer(make_settings, monkeypatch, capsys):
    settings, _ = make_settings()
    monkeypatch.setenv(LISTENERS, "sampler renderer nonsense")
    transport, sampler = Transport(settings.wire), Transport(settings.wire)
    publisher, stats = sampler.bind("sampler", "publish"), ServiceStats("capture", 0)
    listeners = Listeners(transport)
    waited = len(listeners.sockets)
    while len(listeners.sockets) == waited:
        assert listeners.awaited(stats)
        accept_subscriptions(publisher)
        publish_status(publisher, ServiceStats("sampler", 0))
    assert (waited, len(listeners.sockets), capsys.readouterr().err) == (2, 1, "")
    (socket,) = listeners.sockets
    monkeypatch.setattr(listeners, "_give_up_s", 0.0)
    assert not listeners.awaited(stats)
    assert not listeners.awaited(stats)
    said = capsys.readouterr().err.splitlines()
    assert said == ["vemlight: capture: plays without renderer, from which nothing has come for 900 s; see its own lines"]
    assert socket.closed
    transport.close()
    sampler.close()
