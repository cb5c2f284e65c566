"""The second camera as a source of frames: what stands behind the scene. Numbers go on after the last frame with the first one again."""

import sys
import time
from pathlib import Path

import cv2
import numpy as np

from vemlight import settings
from vemlight.errors import UserError
from vemlight.plate.video_source import Pictures, open_pictures
from vemlight.runtime import wire
from vemlight.runtime.channels import Service

REOPEN_S = 1.0  # between two tries to find a camera that has gone
PlateMessage = tuple[wire.PlateMessage, tuple[np.ndarray, ...]]


class PlateSource:
    """A film or a folder of pictures; see `vemlight.runtime.loop.Source`."""

    service: Service = "plate"
    limit: int | None = None

    def __init__(self, settings: settings.Plate) -> None:
        """Raises UserError when there is nothing to see."""
        self._pictures: Pictures = open_pictures(Path(settings.source), settings.fps)
        self.fps = self._pictures.fps

    def __len__(self) -> int:
        return len(self._pictures)

    def message(self, sequence: int, index: int, time_s: float) -> wire.Message:
        """Raises UserError for a damaged picture."""
        return plate_message(self._pictures.picture(index), wire.stamp(sequence, time_s))


class PlateCamera:
    """A camera's pictures as they come; see `vemlight.runtime.loop.Camera`. One that goes away is waited for."""

    service: Service = "plate"
    limit: int | None = None

    def __init__(self, settings: settings.Plate) -> None:
        """Raises UserError for a camera that cannot be opened."""
        self._path, self._fps = settings.source, settings.fps
        self._camera, self._look_again_s = _opened(self._path, self._fps), 0.0
        if not self._camera.isOpened():
            raise UserError(f"{self._path}: cannot be opened as a camera; check [plate] source and who may read it")
        self._sequence, self._began_s = -1, time.monotonic()

    def message(self, wait_s: float) -> tuple[PlateMessage | None, int]:
        """The next picture, if one came; the driver tells of no losses."""
        if not self._camera.isOpened():
            time.sleep(wait_s)
            if time.monotonic() >= self._look_again_s:
                self._camera, self._look_again_s = _opened(self._path, self._fps), time.monotonic() + REOPEN_S
            return None, 0
        came, pixels = self._camera.read()
        if not came:
            print(f"vemlight: {self._path} is gone; waiting for it", file=sys.stderr, flush=True)
            self._camera.release()
            return None, 0
        self._sequence += 1
        return plate_message(pixels[..., ::-1], wire.stamp(self._sequence, time.monotonic() - self._began_s)), 0

    def close(self) -> None:
        self._camera.release()


def _opened(path: str, fps: float) -> cv2.VideoCapture:
    camera = cv2.VideoCapture(path, cv2.CAP_V4L2)
    camera.set(cv2.CAP_PROP_FPS, fps)
    camera.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest picture, not a queue of old ones
    return camera


def plate_message(pixels: np.ndarray, stamp: wire.Stamp) -> PlateMessage:
    """The message of a picture (h, w, 3) uint8 sRGB."""
    height, width, _ = pixels.shape
    return wire.PlateMessage(stamp=stamp, width=width, height=height), (pixels,)
