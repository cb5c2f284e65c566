"""Cells that are no light are counted and said."""

import numpy as np

from vemlight.capture.frames import Frame
from vemlight.capture.invalid_cells import InvalidCells
from vemlight.capture.stage import map_message
from vemlight.runtime import stamps


def test_cells_are_counted_over_all_frames(capsys):
    counted = InvalidCells()
    radiance = np.ones((4, 8, 3), np.float32)
    counted.add(radiance)
    counted.say()
    assert capsys.readouterr().err == ""
    radiance[0, :2, 1] = np.nan, -1
    radiance[3, 7] = np.inf, 1e30, 2
    counted.add(radiance)
    counted.say()
    assert "3 of 64 cells of the map were nan, infinite or negative in 1 of 2 frames" in capsys.readouterr().err


def test_a_service_says_it_once_and_counts_in_its_status(capsys):
    radiance = np.ones((4, 8, 3), np.float32)
    radiance[1, 1, 0] = np.nan
    for _ in range(2):
        header, arrays = map_message(Frame(radiance, "sphere", 0.0, None, 0, 0), stamps.stamp(0, 0.0))
        assert header.report.invalid_cells == 1
        assert arrays[0][1, 1, 0] == 0
    assert capsys.readouterr().err.count("count as dark") <= 1
