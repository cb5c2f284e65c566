"""What a service counts and times of its own frames, and of those that it lost."""

import errno

import numpy as np
import pytest

from vemlight.runtime import service_stats, stamps, wire
from vemlight.runtime.service_stats import LossCounter, ServiceStats


def frame(sequence: int) -> wire.Message:
    header = wire.PlateMessage(stamp=stamps.stamp(sequence, 0.0), width=1, height=1)
    return header, (np.zeros((1, 1, 3), np.uint8),)


@pytest.fixture
def clock(monkeypatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(service_stats.time, "monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize(("frames", "interval_s"), [(100, 0.04), (4, 3.0)])
def test_the_rate_is_that_of_the_last_two_seconds_or_of_the_last_two_frames(clock, frames, interval_s):
    stats = ServiceStats("plate", 0)
    for k in range(frames):
        clock[0] += 5 * interval_s if k < frames // 2 else interval_s  # slow at first
        stats.on_finished(frame(k), 0.001)
    status = stats.status_if_due()
    assert status
    assert status.rate_hz == pytest.approx(1 / interval_s)


def test_a_status_is_due_twice_a_second(clock):
    stats = ServiceStats("plate", 0)
    assert stats.status_if_due()
    clock[0] += 0.49
    assert stats.status_if_due() is None
    clock[0] += 0.02
    assert stats.status_if_due()


def test_refused_messages_are_counted_and_a_line_a_minute_says_why(clock, capsys):
    stats = ServiceStats("sampler", 0)
    for _ in range(100):
        stats.on_refused(ValueError("topic \x1b[2J on a message\nof kind map"))
        clock[0] += 1.0
    lines = capsys.readouterr().err.splitlines()
    line = "vemlight: sampler: refused a message: topic \\x1b[2J on a message\\nof kind map"
    assert lines == [line, f"{line} (and 59 like it since the last line)"]
    status = stats.status_if_due()
    assert status
    assert status.refused == 100


def test_frames_that_a_producer_counted_and_that_never_came_are_dropped():
    losses = LossCounter()
    losses.on_status(10)
    for _ in range(5):
        losses.on_frame()
    losses.on_status(17)
    assert losses.dropped == 2
    losses.on_status(3)  # it was started again
    for _ in range(2):
        losses.on_frame()
    losses.on_status(6)
    assert losses.dropped == 3


def test_a_full_disk_is_said_when_it_begins_and_when_it_is_over(clock, capsys):
    stats = ServiceStats("renderer", 0)
    full = OSError(errno.ENOSPC, "No space left on device")
    for error in (None, full, full, full, None, None):
        stats.on_written(error)
    begins, over = capsys.readouterr().err.splitlines()
    assert begins.startswith("vemlight: renderer: nothing is written (No space left on device)")
    assert over == "vemlight: renderer: writes again; 3 frames were not written"
    status = stats.status_if_due()
    assert status
    assert status.unwritten == 3


def test_a_disk_that_takes_every_second_frame_does_not_fill_the_log(clock, capsys):
    stats = ServiceStats("renderer", 0)
    for k in range(200):
        stats.on_written(OSError(errno.ENOSPC, "No space left on device") if k % 2 else None)
        clock[0] += 0.5
    assert stats.unwritten == 100
    assert len(capsys.readouterr().err.splitlines()) == 4  # two lines a minute
