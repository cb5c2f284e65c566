"""Frames of one moment from several services."""

import numpy as np

from tests.support.sockets import FakeSocket
from vemlight.runtime import stamps, wire
from vemlight.runtime.instances import Input
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.sync import NearestInTime


def plate(sequence: int, captured_ns: int, monotonic_ns: int, boot_id: str) -> list[bytes]:
    stamp = stamps.Stamp(sequence=sequence, time_s=0.0, captured_ns=captured_ns, monotonic_ns=monotonic_ns, boot_id=boot_id)
    return wire.pack(wire.PlateMessage(stamp=stamp, width=1, height=1), [np.zeros((1, 1, 3), np.uint8)])


class OneSocket:
    """A transport whose every subscription is one socket."""

    def __init__(self) -> None:
        self.socket = FakeSocket()

    def subscribe(self, *_: str) -> FakeSocket:
        return self.socket


def nearest(frames: list[list[bytes]], stamp: stamps.Stamp) -> int:
    transport = OneSocket()
    transport.socket.inbox += frames
    ((header, _),) = NearestInTime(transport).frames_at(stamp, [Input("plate", "plate")], ServiceStats("renderer", 0))  # type: ignore[arg-type]
    assert isinstance(header, wire.PlateMessage)
    return header.stamp.sequence


def test_on_one_machine_the_monotonic_clock_decides_and_between_two_the_real_one():
    stamp = stamps.Stamp(sequence=9, time_s=0.0, captured_ns=1000, monotonic_ns=50, boot_id="here")
    assert nearest([plate(1, 1000, 90, "here"), plate(2, 5000, 51, "here")], stamp) == 2
    assert nearest([plate(1, 1000, 90, "there"), plate(2, 5000, 51, "there")], stamp) == 1
    nameless = stamps.Stamp(sequence=9, time_s=0.0, captured_ns=1000, monotonic_ns=50, boot_id="")
    assert nearest([plate(1, 1000, 90, ""), plate(2, 5000, 51, "")], nameless) == 1


def test_the_last_16_frames_are_remembered():
    stamp = stamps.Stamp(sequence=0, time_s=0.0, captured_ns=0, monotonic_ns=0, boot_id="here")
    assert nearest([plate(k, k, k, "here") for k in range(40)], stamp) == 40 - 16
