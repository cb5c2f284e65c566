"""Several renderers on one sampler: what each can draw, and none waits for another."""

import os
import signal
import time

import pytest

from tests.support.processes import LOADED_S
from vemlight.runtime import wire
from vemlight.runtime.reports import ImageReport
from vemlight.runtime.transport import Transport
from vemlight.sampler.stage import FORGOTTEN, StageState, budgets_after
from vemlight.sampler.state import initial_state
from vemlight.settings import Sampler

NAMES = ("renderer", "renderer.slow", "renderer.stopped")


def status(renderer: str, lights: int) -> wire.StatusMessage:
    return wire.StatusMessage(
        service=renderer, sequence=9, rate_hz=25, age_ms=1, step_ms=1, frames=9, skipped=0, dropped=0, refused=0, restarts=0,
        report=ImageReport(light_budget=lights),
    )  # fmt: skip


def budget_after_statuses(*statuses: wire.StatusMessage) -> int:
    state = StageState(Sampler(), initial_state())
    for each in statuses:
        state = state._replace(budgets=budgets_after(state.budgets, each))
    return state.light_budget


def test_the_fastest_renderer_says_how_many_lights_there_are():
    slow, fast = status("renderer.slow", 20), status("renderer", 90)
    assert budget_after_statuses(slow, fast, slow) == 90
    assert budget_after_statuses(fast, slow, status("renderer", 60)) == 60, "its newest word counts"
    assert budget_after_statuses(slow, fast, status("renderer.free", 0)) == 0, "one without a limit draws all"


def test_a_renderer_that_is_silent_no_longer_counts_until_it_is_back():
    slow, fast = status("renderer.slow", 20), status("renderer", 90)
    gone = [fast, *(FORGOTTEN + 1) * [slow]]
    assert budget_after_statuses(*gone[:-1]) == 90
    assert budget_after_statuses(*gone) == 20
    assert budget_after_statuses(*gone, fast) == 90
    assert budget_after_statuses(*100 * [slow]) == 20, "alone it always counts"


class Pictures:
    """What the renderers and the sampler publish."""

    def __init__(self, settings) -> None:
        self._transport = Transport(settings.wire)
        self._sockets = {name: self._transport.subscribe(name, "image") for name in NAMES}
        self._sockets["sampler"] = self._transport.subscribe("sampler", "lights")

    def during(self, seconds: float) -> dict[str, list[int]]:
        """Numbers of the frames that come in so many seconds from now on."""
        found: dict[str, list[int]] = {name: [] for name in self._sockets}
        self._numbers()
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            time.sleep(0.05)
            for name, numbers in self._numbers().items():
                found[name] += numbers
        return found

    def wait_for(self, name: str, after: int = -1) -> int:
        """A frame later than `after` of one of them."""
        until_s = time.monotonic() + LOADED_S
        while time.monotonic() < until_s:
            time.sleep(0.05)
            if (numbers := self._numbers()[name]) and numbers[-1] > after:
                return numbers[-1]
        raise AssertionError(f"{name} sent nothing")

    def _numbers(self) -> dict[str, list[int]]:
        found: dict[str, list[int]] = {}
        for name, socket in self._sockets.items():
            found[name] = []
            while socket.poll(0):
                header, _ = wire.unpack(socket.recv_multipart())
                assert isinstance(header, wire.FrameHeader)
                found[name].append(header.stamp.sequence)
        return found

    def close(self) -> None:
        self._transport.close()


@pytest.fixture
def place(make_settings, services):
    """A capture, a sampler and three renderers, one of them slower; gives the pictures, and what starts a renderer."""
    settings, path = make_settings(wire={"renderers": list(NAMES)}, capture={"fps": 8.0, "rows": 12, "cols": 48})
    running = {}

    def start(name: str) -> None:
        drawn = {"width": 400, "height": 300} if name == "renderer.slow" else {}
        _, file = make_settings(name=f"{name}.toml", wire={"names": {"renderer": name}, "elsewhere": ["capture"]}, renderer=drawn)
        running[name] = services.start("vemlight.renderer", str(file))

    for module in ("capture", "sampler"):
        services.start(f"vemlight.{module}", str(path))
    for name in NAMES:
        start(name)
    pictures = Pictures(settings)
    for name in (*NAMES, "sampler"):
        pictures.wait_for(name)
    yield pictures, running, start
    pictures.close()


def test_a_slow_a_stopped_and_a_killed_renderer_do_not_slow_the_others(place):
    pictures, running, start = place
    before = pictures.during(4)
    os.kill(running["renderer.stopped"].pid, signal.SIGSTOP)
    stopped = pictures.during(4)
    running["renderer.slow"].kill()
    killed = pictures.during(4)
    for name in ("renderer", "sampler"):
        assert len(stopped[name]) > 0.6 * len(before[name]), "a machine that others use varies by as much"
        assert len(killed[name]) > 0.6 * len(before[name])
    assert len(stopped["renderer.stopped"]) < 0.2 * len(before["renderer.stopped"]), "it was stopped"
    start("renderer.slow")
    pictures.wait_for("renderer.slow")
    newest = pictures.wait_for("sampler")
    os.kill(running["renderer.stopped"].pid, signal.SIGCONT)
    assert pictures.wait_for("renderer.stopped", after=newest) > newest, "what waited in its queue is passed over"
