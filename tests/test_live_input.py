"""Which frame a live stage takes: the newest, and not one that has waited in a queue."""

import numpy as np
import pytest

from tests.support.sockets import FakeSocket
from vemlight.runtime import loop, stamps, wire
from vemlight.runtime.service_stats import ServiceStats


class StubSocket(FakeSocket):
    """A socket at which batches of messages wait: the first at once, each other after a poll. Remembers how long it was polled."""

    def __init__(self, *batches: list[wire.Message]) -> None:
        super().__init__()
        self._batches = [[wire.pack(*message) for message in batch] for batch in batches]
        self.inbox.extend(self._batches.pop(0))
        self.polled_ms: list[int] = []

    def poll(self, timeout_ms: int) -> bool:
        self.polled_ms.append(timeout_ms)
        self.inbox.clear()
        self.inbox.extend(self._batches.pop(0) if self._batches else [])
        return bool(self.inbox)


def frame(sequence: int) -> wire.Message:
    header = wire.PlateMessage(stamp=stamps.stamp(sequence, 0.0), width=1, height=1)
    return header, (np.zeros((1, 1, 3), np.uint8),)


def status(frames: int) -> wire.Message:
    return wire.StatusMessage(
        service="capture", sequence=0, rate_hz=25, age_ms=1, step_ms=1, frames=frames, skipped=0, dropped=0, refused=0, restarts=0
    ), ()


def newest(socket: StubSocket, stats: ServiceStats) -> int | None:
    """The number of the frame that is taken."""
    message = loop.LiveInput(socket, stats).newest()
    if message is None:
        return None
    assert isinstance(message[0], wire.FrameHeader)
    return message[0].stamp.sequence


@pytest.mark.parametrize(("age_ms", "polls"), [(45.0, 0), (75.0, 1)])
def test_a_frame_older_than_one_and_a_half_intervals_is_passed_over_for_the_next(monkeypatch, age_ms, polls):
    ages = iter([age_ms, 1.0])
    monkeypatch.setattr(stamps, "age_ms", lambda _stamp: next(ages))
    socket, stats = StubSocket([frame(3)], [frame(7)]), ServiceStats("sampler", 0)
    assert newest(socket, stats) == (7 if polls else 3)
    assert len(socket.polled_ms) == polls
    assert all(40 <= timeout_ms <= 80 for timeout_ms in socket.polled_ms)
    assert stats.skipped == polls


def test_a_stale_frame_is_taken_when_no_other_comes(monkeypatch):
    monkeypatch.setattr(stamps, "age_ms", lambda _stamp: 500.0)
    assert newest(StubSocket([frame(3)]), ServiceStats("sampler", 0)) == 3


def test_of_the_frames_that_wait_the_newest_is_taken_and_the_others_count_as_skipped():
    stats = ServiceStats("sampler", 0)
    assert newest(StubSocket([frame(3), frame(4), frame(6)]), stats) == 6
    assert (stats.skipped, stats.dropped) == (2, 0)  # a gap in the numbers is not a loss: frame 5 may never have been made
    assert newest(StubSocket([]), stats) is None


def test_what_the_producer_counted_and_never_came_is_dropped():
    stats = ServiceStats("sampler", 0)
    newest(StubSocket([status(10), frame(10), frame(11), status(15)]), stats)
    assert stats.dropped == 3


def test_the_end_holds_until_a_frame_comes_after_it():
    ended = wire.EndMessage(sequence=5), ()
    live = loop.LiveInput(StubSocket([frame(4), ended], [frame(0)]), ServiceStats("sampler", 0))
    assert live.newest()
    assert live.end == wire.EndMessage(sequence=5)
    live._socket.poll(0)
    assert live.newest()
    assert live.end is None
