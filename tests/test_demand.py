"""Frames by request: what a consumer asks for, and what a maker sends."""

import numpy as np
import pytest

from tests.support.sockets import FakeSocket
from vemlight.runtime import demand, stamps, wire
from vemlight.runtime.demand import Pull, Supply
from vemlight.runtime.service_stats import ServiceStats


def frame(sequence: int) -> wire.Message:
    header = wire.MapMessage(stamp=stamps.stamp(sequence, sequence / 25), rows=1, cols=1, coverage="hemisphere")
    empty = np.empty(0, np.int64), np.empty((0, 3), np.float32), np.empty(0, np.float32)
    return header, (np.zeros((1, 1, 3), np.float32), *empty)


def request(consumer: bytes, first: int, count: int) -> list[bytes]:
    return [consumer, *wire.pack(wire.RequestMessage(first=first, count=count))]


def sent(socket: FakeSocket) -> list[tuple[bytes, str, int]]:
    """(consumer, kind, number) of what a maker sent."""
    headers = [(parts[0], wire.unpack(parts[1:])[0]) for parts in socket.sent]
    return [(to, type(header).__name__, header.sequence if isinstance(header, wire.EndMessage) else header.stamp.sequence)
            for to, header in headers if isinstance(header, wire.MapMessage | wire.EndMessage)]


@pytest.fixture
def supply() -> Supply:
    return Supply(FakeSocket(), ServiceStats("capture", 0))


def test_a_request_that_begins_where_the_last_one_ended_extends_it(supply):
    supply.socket.inbox += [request(b"a", 10, 4), request(b"a", 14, 2)]
    assert supply.earliest_requested() == 10
    supply.send(frame, end=None)
    assert [number for _, _, number in sent(supply.socket)] == [10, 11, 12, 13, 14, 15]


@pytest.mark.parametrize("first", [12, 20, 5])
def test_any_other_request_replaces_the_last_one(supply, first):
    supply.socket.inbox += [request(b"a", 10, 4), request(b"a", first, 2)]
    assert supply.earliest_requested() == first
    supply.send(frame, end=None)
    assert [number for _, _, number in sent(supply.socket)] == [first, first + 1]


def test_the_end_is_sent_in_place_of_the_first_frame_that_will_not_come(supply):
    supply.socket.inbox.append(request(b"a", 2, 4))
    supply.earliest_requested()
    supply.send(frame, end=3)
    assert sent(supply.socket) == [(b"a", "MapMessage", 2), (b"a", "EndMessage", 3)]
    assert supply.earliest_requested() is None


def test_64_consumers_are_served_and_no_more():
    stats = ServiceStats("capture", 0)
    supply = Supply(FakeSocket(), stats)
    supply.socket.inbox += [request(b"%d" % k, k, 1) for k in range(65)]
    assert supply.earliest_requested() == 0
    assert stats.refused == 1
    supply.send(frame, end=None)
    assert len(supply.socket.sent) == 64


def test_a_consumer_that_takes_nothing_gives_way_and_is_cut(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(demand.time, "monotonic", lambda: now[0])
    stats = ServiceStats("capture", 0)
    supply = Supply(FakeSocket(), stats)
    supply.socket.inbox += [request(b"%d" % k, k, 1) for k in range(64)]
    supply.earliest_requested()
    supply.socket.is_full = True
    supply.send(frame, end=None)  # from now on all queues are full
    supply.socket.inbox.append(request(b"new", 7, 1))
    supply.earliest_requested()
    assert stats.refused == 0  # the one that is full for longest made way
    now[0] += 1.9
    supply.send(frame, end=None)
    supply.socket.inbox.append(request(b"63", 63, 1))
    assert supply.earliest_requested() == 1
    now[0] += 0.2
    supply.send(frame, end=None)
    assert supply.earliest_requested() == 7  # "new" is full for 0.2 s only


def test_consumers_share_a_frames_memory(supply, monkeypatch):
    packed = []
    monkeypatch.setattr(demand.wire, "pack", lambda *message: packed.append(message) or [b"map", b""])
    message = frame(0)
    supply._requests.update({b"%d" % k: demand._Request(0, 1, float("inf"), None) for k in range(10)})
    supply.send(lambda _: message, end=None)
    assert len(supply.socket.sent) == 10
    assert len(packed) == 1


def requests(socket: FakeSocket) -> list[tuple[int, int]]:
    headers = [wire.unpack(parts)[0] for parts in socket.sent]
    return [(header.first, header.count) for header in headers if isinstance(header, wire.RequestMessage)]


def test_four_frames_are_asked_for_ahead_and_again_after_a_second(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(demand.time, "monotonic", lambda: now[0])
    pull = Pull(FakeSocket(), "map", ServiceStats("sampler", 0))
    assert pull.frame(0) is None
    assert requests(pull.socket) == [(0, 4)]
    now[0] += 0.9
    assert pull.frame(0) is None
    assert requests(pull.socket) == [(0, 4)]
    now[0] += 0.2
    assert pull.frame(0) is None
    assert requests(pull.socket) == [(0, 4), (0, 4)]


def test_the_window_is_topped_up_when_half_of_it_has_come():
    pull = Pull(FakeSocket(), "map", ServiceStats("sampler", 0))
    pull.frame(0)
    for due in range(3):
        pull.socket.inbox.append(wire.pack(*frame(due)))
        message = pull.frame(due)
        assert message
    assert requests(pull.socket) == [(0, 4), (4, 2), (6, 1)] or requests(pull.socket) == [(0, 4), (4, 2)]
