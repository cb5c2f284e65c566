"""Pictures by index: of a video file, or of a folder in the order of names."""

import os
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from vemlight.errors import UserError
from vemlight.light.film_file import MAX_FPS, check_film_kind
from vemlight.light.images import read_picture
from vemlight.light.quiet import silent
from vemlight.runtime import wire
from vemlight.runtime.wire_fields import MAX_SIDE

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # AV_LOG_QUIET: FFmpeg's threads speak when `silent` has ended


class VideoSource(Protocol):
    """Pictures by index. fps: how many of them a second."""

    fps: float

    def __len__(self) -> int: ...

    def picture(self, index: int) -> np.ndarray:
        """Picture 0 .. len - 1: (h, w, 3) uint8, sRGB, row 0 on top. Raises UserError for one that cannot be read."""
        ...


class PictureFolder:
    """Picture files in the order of their names."""

    def __init__(self, folder: Path, fps: float) -> None:
        """Raises UserError for a folder without pictures."""
        self._paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES)
        self.fps = fps
        if not self._paths:
            raise UserError(f"{folder}: holds no {', '.join(PICTURE_SUFFIXES)}; name a folder of pictures, or a video")

    def __len__(self) -> int:
        return len(self._paths)

    def picture(self, index: int) -> np.ndarray:
        """See VideoSource."""
        return checked_size(read_picture(self._paths[index]), str(self._paths[index]))


class VideoFile:
    """A video's pictures, fast one after the other, slower in any order."""

    def __init__(self, path: Path) -> None:
        """Raises UserError for a file that is no video, whose pictures are too large, or whose end is missing."""
        self._path, self._next_index = path, 0
        check_film_kind(path)
        with silent():
            self._capture = cv2.VideoCapture(str(path))
        self.fps = self._capture.get(cv2.CAP_PROP_FPS)
        self._count = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if not self._capture.isOpened() or self._count < 1 or not 0 < self.fps <= MAX_FPS:
            raise UserError(f"{path}: is no video that can be played; convert it to .mp4, or name a folder of pictures")
        self._check_side(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH), self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if self._read(self._count - 1) is None:
            raise UserError(f"{path}: its last picture, of {self._count}, cannot be read; copy or convert it again")

    def __len__(self) -> int:
        return self._count

    def picture(self, index: int) -> np.ndarray:
        """See VideoSource."""
        pixels = self._read(index)
        if pixels is None:
            raise UserError(f"{self._path}: picture {index} is damaged; convert it again")
        return checked_size(np.ascontiguousarray(pixels[..., ::-1]), f"{self._path}: picture {index}")

    def _check_side(self, width: float, height: float) -> None:
        if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE):
            raise UserError(f"{self._path}: has {width:.0f} x {height:.0f} pixels, too many for a plate; make it smaller")

    def _read(self, index: int) -> np.ndarray | None:
        with silent():
            if index != self._next_index:
                self._capture.set(cv2.CAP_PROP_POS_FRAMES, index)
            came, pixels = self._capture.read()
        self._next_index = index + 1
        return pixels if came else None


def checked_size(pixels: np.ndarray, where: str) -> np.ndarray:
    """The picture. Raises UserError for one that is too large for a message."""
    if max(pixels.shape[:2]) > MAX_SIDE or pixels.nbytes > wire.MAX_PART:
        raise UserError(f"{where}: has {pixels.shape[1]} x {pixels.shape[0]} pixels, too many for a plate; make it smaller")
    return pixels


def open_video_source(path: Path, fps: float) -> VideoSource:
    """The video file or folder at `path`; fps: of a folder's pictures. Raises UserError when there is nothing to see."""
    if not os.path.exists(path):  # False for a name that is none, too
        raise UserError(f"{path}: there is no such video or folder; check the path")
    return PictureFolder(path, fps) if path.is_dir() else VideoFile(path)
