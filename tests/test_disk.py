"""What the loop does when the disk refuses a frame: live it goes on, lossless it ends with one line."""

import errno

import numpy as np
import pytest

from vemlight.errors import UserError
from vemlight.runtime import loop, stamps, wire
from vemlight.runtime.service_stats import ServiceStats

FRAME: wire.Message = (wire.PlateMessage(stamp=stamps.stamp(0, 0.0), width=1, height=1), (np.zeros((1, 1, 3), np.uint8),))


class FullDisk:
    """A stage whose disk is full for the frames from `first` to before `end`."""

    service = "renderer"

    def __init__(self, first: int, end: int) -> None:
        self._full, self._frame = range(first, end), -1
        self.written: list[int] = []

    def write(self, state: None, message: wire.Message) -> None:
        self._frame += 1
        if self._frame in self._full:
            raise OSError(errno.ENOSPC, "No space left on device", "a.exr")
        self.written.append(self._frame)


def test_live_frames_go_on_and_are_written_again_when_there_is_room():
    stage, stats = FullDisk(2, 5), ServiceStats("renderer", 0)
    for _ in range(8):
        loop._write_if_possible(stage, None, FRAME, stats)  # type: ignore[arg-type]
    assert stage.written == [0, 1, 5, 6, 7]
    assert stats.unwritten == 3


def test_lossless_a_full_disk_is_one_line_with_the_way_out():
    with pytest.raises(UserError) as caught, loop._disk_needed("/out", "frame 7"):
        FullDisk(0, 1).write(None, FRAME)
    assert str(caught.value) == (
        "/out: frame 7 cannot be written (No space left on device); make room and run the same command again, which goes on from there"
    )
