"""The second camera as a source of frames: the plate, a live picture of the real place behind the scene."""

import sys
import time
from pathlib import Path

import cv2
import numpy as np

from vemlight import settings
from vemlight.errors import UserError, of_setting
from vemlight.plate.video_source import VideoSource, open_video_source
from vemlight.runtime import stamps, wire
from vemlight.runtime.channels import Service

REOPEN_S = 1.0  # between two tries to open a camera that is gone; any value in 0.2 .. 5 does
PlateFrame = tuple[wire.PlateMessage, tuple[np.ndarray, ...]]


class PlateSource:
    """A video file or a folder of pictures, played again from the start after its end; see `vemlight.runtime.source_loop.Source`."""

    service: Service = "plate"
    limit: int | None = None

    def __init__(self, settings: settings.Plate) -> None:
        """Raises UserError when there is nothing to see."""
        with of_setting("[plate] source"):
            self._video: VideoSource = open_video_source(Path(settings.source), settings.fps)
        self.fps = self._video.fps

    def __len__(self) -> int:
        return len(self._video)

    def message(self, sequence: int, index: int, time_s: float) -> wire.Message:
        """Picture `index` as frame `sequence`. Raises UserError for one that is damaged."""
        return plate_frame(self._video.picture(index), stamps.stamp(sequence, time_s))

    def on_control(self, control: wire.ControlMessage) -> None:
        pass


class PlateCamera:
    """A camera's pictures as they come; see `vemlight.runtime.source_loop.Camera`. One that disappears is opened again when it is back."""

    service: Service = "plate"
    limit: int | None = None
    unwritten = 0

    def __init__(self, settings: settings.Plate) -> None:
        """Raises UserError for a camera that cannot be opened."""
        self._path, self._fps = settings.source, settings.fps
        self._camera, self._reopen_s = _opened(self._path, self._fps), 0.0
        if not self._camera.isOpened():
            raise UserError(f"{self._path}: cannot be opened as a camera; check [plate] source and who may read it")
        self._sequence, self._started_s = -1, time.monotonic()
        self._paused = False
        self._shown: np.ndarray | None = None

    def message(self, wait_s: float) -> tuple[PlateFrame | None, int]:
        """The next picture if one came, and 0: OpenCV does not report frames that the driver lost."""
        if not self._camera.isOpened():
            time.sleep(wait_s)
            if time.monotonic() >= self._reopen_s:
                self._camera, self._reopen_s = _opened(self._path, self._fps), time.monotonic() + REOPEN_S
            return None, 0
        came, pixels = self._camera.read()
        if not came:
            print(f"vemlight: {self._path} is gone; waiting for it", file=sys.stderr, flush=True)
            self._camera.release()
            return None, 0
        self._sequence += 1
        if not self._paused or self._shown is None:
            self._shown = pixels[..., ::-1]
        return plate_frame(self._shown, stamps.stamp(self._sequence, time.monotonic() - self._started_s)), 0

    def on_control(self, control: wire.ControlMessage) -> None:
        self._paused = control.paused

    def close(self) -> None:
        self._camera.release()


def _opened(path: str, fps: float) -> cv2.VideoCapture:
    camera = cv2.VideoCapture(path, cv2.CAP_V4L2)
    camera.set(cv2.CAP_PROP_FPS, fps)
    camera.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest picture, not a queue of old ones
    return camera


def plate_frame(pixels: np.ndarray, stamp: stamps.Stamp) -> PlateFrame:
    """The message of a picture (h, w, 3) uint8, sRGB."""
    height, width, _ = pixels.shape
    return wire.PlateMessage(stamp=stamp, width=width, height=height), (pixels,)
