"""Pictures by index: of a video file, or of a folder in the order of names."""

from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from vemlight.errors import UserError
from vemlight.light.quiet import silent
from vemlight.runtime import wire

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
MAX_FPS = 1000.0  # in a video's header; a higher rate is taken for damage. Any value in 300 .. 10,000 does


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
            raise UserError(f"{folder}: holds no {', '.join(PICTURE_SUFFIXES)}; name another folder as [plate] source")

    def __len__(self) -> int:
        return len(self._paths)

    def picture(self, index: int) -> np.ndarray:
        """See VideoSource."""
        try:
            with silent():
                pixels = cv2.imread(str(self._paths[index]), cv2.IMREAD_COLOR)
        except cv2.error:  # for one too large for it
            pixels = None
        return checked_rgb(pixels, str(self._paths[index]))


class VideoFile:
    """A video's pictures, fast one after the other, slower in any order."""

    def __init__(self, path: Path) -> None:
        """Raises UserError for a file that is no video, or whose end is missing."""
        self._path, self._next_index = path, 0
        with silent():
            self._capture = cv2.VideoCapture(str(path))
        self.fps = self._capture.get(cv2.CAP_PROP_FPS)
        self._count = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if not self._capture.isOpened() or self._count < 1 or not 0 < self.fps <= MAX_FPS:
            raise UserError(f"{path}: is no video that can be played; convert it to .mp4, or name a folder of pictures")
        if self._read(self._count - 1) is None:
            raise UserError(f"{path}: its last picture, of {self._count}, cannot be read; copy or convert it again")

    def __len__(self) -> int:
        return self._count

    def picture(self, index: int) -> np.ndarray:
        """See VideoSource."""
        return checked_rgb(self._read(index), f"{self._path}: picture {index}")

    def _read(self, index: int) -> np.ndarray | None:
        with silent():
            if index != self._next_index:
                self._capture.set(cv2.CAP_PROP_POS_FRAMES, index)
            came, pixels = self._capture.read()
        self._next_index = index + 1
        return pixels if came else None


def checked_rgb(pixels: np.ndarray | None, where: str) -> np.ndarray:
    """RGB of OpenCV's BGR. Raises UserError for None, and for a picture that is too large for a message."""
    if pixels is None:
        raise UserError(f"{where}: is damaged or no picture; convert it again")
    if max(pixels.shape[:2]) > wire.MAX_SIDE or pixels.nbytes > wire.MAX_PART:
        raise UserError(f"{where}: has {pixels.shape[1]} x {pixels.shape[0]} pixels, too many for a plate; make it smaller")
    return np.ascontiguousarray(pixels[..., ::-1])


def open_video_source(path: Path, fps: float) -> VideoSource:
    """The video file or folder at `path`; fps: of a folder's pictures. Raises UserError when there is nothing to see."""
    if not path.exists():
        raise UserError(f"{path}: there is no such video or folder; check [plate] source")
    return PictureFolder(path, fps) if path.is_dir() else VideoFile(path)
