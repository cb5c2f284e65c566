"""Pictures by index: of a film, or a folder's in the order of their names."""

from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from vemlight.errors import UserError
from vemlight.light.images import silent

SUFFIXES = (".png", ".jpg", ".jpeg")
LONGEST_SIDE = 8192  # pixels, of what travels between services
MOST_BYTES = 64 * 2**20  # of one picture's array, likewise


class Pictures(Protocol):
    """Pictures by index."""

    fps: float

    def __len__(self) -> int: ...

    def picture(self, k: int) -> np.ndarray:
        """Picture k of 0 .. len - 1: (h, w, 3) uint8, sRGB, row 0 on top. Raises UserError for one that cannot be read."""
        ...


class Folder:
    """Picture files in the order of their names."""

    def __init__(self, folder: Path, fps: float) -> None:
        """Raises UserError for a folder without pictures."""
        self._paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
        self.fps = fps
        if not self._paths:
            raise UserError(f"{folder}: holds no {', '.join(SUFFIXES)}; name another folder as [plate] source")

    def __len__(self) -> int:
        return len(self._paths)

    def picture(self, k: int) -> np.ndarray:
        """See Pictures."""
        try:
            with silent():
                pixels = cv2.imread(str(self._paths[k]), cv2.IMREAD_COLOR)
        except cv2.error:  # one too large for it
            pixels = None
        return checked(pixels, str(self._paths[k]))


class Film:
    """A film's pictures, one after the other or, slower, in any order."""

    def __init__(self, path: Path) -> None:
        """Raises UserError for a file that is no film or not whole."""
        with silent():
            self._path, self._film, self._next = path, cv2.VideoCapture(str(path)), 0
        self.fps = self._film.get(cv2.CAP_PROP_FPS)
        count = int(self._film.get(cv2.CAP_PROP_FRAME_COUNT))
        if not self._film.isOpened() or count < 1 or not 0 < self.fps <= 1000:
            raise UserError(f"{path}: is no film that can be played; convert it to .mp4, or name a folder of pictures")
        self._count = count
        if self._read(count - 1) is None:
            raise UserError(f"{path}: its last picture, of {count}, cannot be read; copy or convert it again")

    def __len__(self) -> int:
        return self._count

    def picture(self, k: int) -> np.ndarray:
        """See Pictures."""
        return checked(self._read(k), f"{self._path}: picture {k}")

    def _read(self, k: int) -> np.ndarray | None:
        with silent():
            if k != self._next:
                self._film.set(cv2.CAP_PROP_POS_FRAMES, k)
            came, pixels = self._film.read()
        self._next = k + 1
        return pixels if came else None


def checked(pixels: np.ndarray | None, where: str) -> np.ndarray:
    """RGB of OpenCV's BGR. Raises UserError for none, and for one that is too large to travel."""
    if pixels is None:
        raise UserError(f"{where}: is damaged or no picture; convert it again")
    if max(pixels.shape[:2]) > LONGEST_SIDE or pixels.nbytes > MOST_BYTES:
        raise UserError(f"{where}: has {pixels.shape[1]} x {pixels.shape[0]} pixels, too many for a plate; make it smaller")
    return np.ascontiguousarray(pixels[..., ::-1])


def open_pictures(path: Path, fps: float) -> Pictures:
    """The film or folder at `path`. Raises UserError when there is nothing to see."""
    if not path.exists():
        raise UserError(f"{path}: there is no such film or folder; check [plate] source")
    return Folder(path, fps) if path.is_dir() else Film(path)
