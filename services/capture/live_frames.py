"""Cameras and streams: opened by their name, and so many of their frames taken by number, as files are."""

import time
from pathlib import Path
from typing import Protocol

from vemlight.capture.frames import Frame
from vemlight.capture.recorder import Recorder
from vemlight.errors import UserError
from vemlight.settings import Capture
from vemlight.source_names import is_stream, shown_source

WAIT_S = 0.5  # for the next frame, before Ctrl-C is looked for; any value from 0.01 to 5 does
SILENT_S = 10.0  # without a frame, after which a command that needs more of them ends; a run waits for ever


class LiveSource(Protocol):
    """Frames as they come; see CameraSource and StreamSource."""

    recorder: Recorder | None
    calibration: tuple[Path, ...]  # files that a recording needs beside its frames

    @property
    def fps(self) -> float: ...

    @property
    def state(self) -> str: ...

    @property
    def unrecorded(self) -> int: ...

    def next(self, wait_s: float) -> Frame | None: ...

    def close(self) -> None: ...


def open_live(settings: Capture) -> LiveSource:
    """The camera or the stream that the settings name. Raises UserError when it cannot be used."""
    if is_stream(settings.source):
        from vemlight.capture.stream_source import StreamSource

        return StreamSource(settings)
    from vemlight.capture.camera_source import CameraSource

    return CameraSource(settings)


class LiveFrames:
    """The next `count` frames of a camera or stream as a FrameSource that is read once, in order."""

    def __init__(self, settings: Capture, count: int) -> None:
        """Raises UserError when it cannot be used."""
        self._source, self._count, self._name = open_live(settings), count, shown_source(settings.source)
        self._taken = 0

    @property
    def fps(self) -> float:
        """Frames a second, as the camera or stream says."""
        return self._source.fps

    def __len__(self) -> int:
        return self._count

    def frame(self, k: int) -> Frame:
        """Frame k, which is the next one. Raises UserError when none comes within SILENT_S."""
        if k != self._taken:
            raise ValueError(f"frame {k} of a live source was asked for and {self._taken} is the next")
        until_s = time.monotonic() + SILENT_S
        while time.monotonic() < until_s:
            if frame := self._source.next(WAIT_S):
                self._taken += 1
                if self._taken == self._count:
                    self._source.close()
                return frame
        state = self._source.state
        self._source.close()
        raise UserError(f"{self._name}: fell silent after {k} of {self._count} frames ({state}); check it, or ask for fewer --frames")
