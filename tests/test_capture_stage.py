"""A camera's frames as messages; the camera is replaced by a list of frames."""

import time

import numpy as np
import pytest

from vemlight import files
from vemlight.capture import stage
from vemlight.capture.frames import Frame
from vemlight.capture.stage import CaptureCamera, CaptureSource
from vemlight.runtime import stamps
from vemlight.settings import Capture, Settings


class ListedFrames:
    """Replaces `vemlight.capture.camera_source.CameraSource`."""

    state = "a camera"

    def __init__(self, _: Capture) -> None:
        self.frames: list[Frame] = []

    def next(self, _: float) -> Frame | None:
        return self.frames.pop(0) if self.frames else None


def frame(monotonic_ns: int, lost: int = 0) -> Frame:
    radiance = np.ones((4, 8, 3), np.float32)
    return Frame(radiance, "hemisphere", 0.5, None, 0, 0, lost=lost, monotonic_ns=monotonic_ns)


@pytest.fixture
def camera(monkeypatch: pytest.MonkeyPatch) -> tuple[CaptureCamera, list[Frame]]:
    monkeypatch.setattr(stage, "open_live", ListedFrames)
    made = CaptureCamera(Capture(source="/dev/video0"))
    return made, made._source.frames  # type: ignore[attr-defined]


def test_sequence_numbers_count_lost_frames(camera) -> None:
    made, frames = camera
    assert made.message(0.0) == (None, 0)
    frames += [frame(0), frame(0, lost=3), frame(0)]
    messages = [made.message(0.0) for _ in range(3)]
    assert [message[0].stamp.sequence for message, _ in messages] == [0, 4, 5]
    assert [lost for _, lost in messages] == [0, 3, 0]


@pytest.mark.parametrize("age_ns", [0, 40_000_000, 3_000_000_000])
def test_age_is_that_of_the_kernels_stamp(camera, age_ns: int) -> None:
    made, frames = camera
    before_ns, before_wall_ns = time.monotonic_ns(), time.time_ns()
    frames.append(frame(before_ns - age_ns))
    stamp = made.message(0.0)[0][0].stamp
    assert stamp.monotonic_ns == before_ns - age_ns
    assert before_wall_ns - age_ns <= stamp.captured_ns + 5_000_000  # the two clocks are read one after the other
    assert stamp.captured_ns <= time.time_ns() - age_ns
    assert stamps.age_ms(stamp) >= age_ns / 1e6


def test_a_stamp_in_the_future_counts_as_now(camera) -> None:
    made, frames = camera
    frames.append(frame(time.monotonic_ns() + 10**10))
    stamp = made.message(0.0)[0][0].stamp
    assert stamp.monotonic_ns <= time.monotonic_ns()
    assert stamp.captured_ns <= time.time_ns()


def test_invalid_pixels_are_counted_and_black() -> None:
    radiance = np.ones((4, 8, 3), np.float32)
    radiance[0, 0, 1], radiance[1, 1, 0], radiance[2, 2], radiance[3, 3, 2] = np.nan, np.inf, -1.0, -1e-30
    header, (sent, *_) = stage.map_message(Frame(radiance, "hemisphere", 0.0, None, 5, 7), stamps.stamp(0, 0.0))
    assert (header.report.invalid_cells, header.report.black_pixels, header.report.saturated_pixels) == (4, 5, 7)
    invalid = ~(np.isfinite(radiance) & (radiance >= 0))
    assert np.all(sent[invalid] == 0)
    assert np.all(sent[~invalid] == 1)


@pytest.mark.parametrize(
    ("mode", "frames", "limit", "said"),
    [
        ("lossless", 20, 16, "has 16 frames, not 20; all of them are played"),
        ("live", 20, 20, "has 16 frames, not 20; they are played again from the first"),
        ("lossless", 16, 16, ""),
        ("live", 0, None, ""),
    ],
)
def test_more_frames_than_there_are_is_said(sequence, capsys, monkeypatch, mode, frames, limit, said) -> None:
    monkeypatch.setattr(files, "_noticed", set())
    source = CaptureSource(Settings(mode=mode, capture=Capture(source=str(sequence), frames=frames, rows=4, cols=8)))
    assert source.limit == limit
    assert said in capsys.readouterr().err
