"""Thumbnails of a source's frames, made one after the other in a thread that takes what time the others leave."""

import os
import threading
import time
from collections.abc import Callable

import numpy as np

from vemlight.capture.frames import Frame
from vemlight.errors import UserError
from vemlight.light.colour import luminance_from_rgb, srgb_from_linear
from vemlight.light.sphere import cell_solid_angles
from vemlight.runtime.wire import MAX_THUMBNAILS, THUMBNAIL_SIDE

KEY, WHITE = 0.20, 6.0  # where the first disc's log-average goes and what becomes white, as on the page (Reinhard et al. 2002)
DARK = 1e-6  # of the mean: keeps black cells from ruling the log-average
PAUSE_S = 0.15  # between two: all 48 take 7 s more, and what plays is not disturbed for longer than one takes. 0.05 to 1 s would do
NO_THUMBNAILS = np.empty(0, np.int64), np.empty((0, THUMBNAIL_SIDE, THUMBNAIL_SIDE, 3), np.uint8)
NICE = 19  # the thread's priority: the lowest


def thumbnail_frames(frames: int) -> list[int]:
    """Which of so many frames are shown: evenly spaced, the first and the last among them, at most MAX_THUMBNAILS."""
    return sorted(set(np.linspace(0, frames - 1, min(frames, MAX_THUMBNAILS)).round().astype(int).tolist()))


def log_average(frame: Frame) -> float:
    """The log-average of a map's luminance by solid angle; 0 of a black one."""
    y = luminance_from_rgb(frame.radiance.astype(np.float64))
    area = cell_solid_angles(y.shape[0], y.shape[1], frame.coverage)
    mean = float(area @ y.mean(axis=1) / area.sum())
    return float(np.exp(area @ np.log(y + DARK * mean).mean(axis=1) / area.sum())) if mean > 0 else 0.0


def averaged(values: np.ndarray, axis: int, at_most: int) -> np.ndarray:
    """The values with at most so many along an axis: each the mean of those that it stands for."""
    count = values.shape[axis]
    if count <= at_most:
        return values
    starts = np.arange(at_most) * count // at_most
    shape = [-1 if k == axis else 1 for k in range(values.ndim)]
    return np.add.reduceat(values, starts, axis=axis) / np.diff(starts, append=count).reshape(shape)


def disc(frame: Frame, adapted: float) -> np.ndarray:
    """The sky from below, (side, side, 3) uint8 sRGB: zenith in the middle, +Y at the top, +X at the left; black outside the rim.

    adapted: the log-average that goes to KEY, of all discs the same, so that one sees where it is brighter.
    """
    middle = THUMBNAIL_SIDE / 2
    right = (np.arange(THUMBNAIL_SIDE) + 0.5 - middle) / middle
    up, radius = -right[:, None], np.hypot(right, right[:, None])
    small = averaged(averaged(np.nan_to_num(frame.radiance), 0, THUMBNAIL_SIDE), 1, 4 * THUMBNAIL_SIDE)
    row = np.minimum((radius * len(small)).astype(int), len(small) - 1)
    col = (np.arctan2(up, -right) % (2 * np.pi) * (small.shape[1] / (2 * np.pi))).astype(int) % small.shape[1]
    radiance = np.maximum(small[row, col].astype(np.float64), 0.0)
    y = luminance_from_rgb(radiance) * (KEY / adapted if adapted else 0.0)
    gain = (KEY / adapted if adapted else 0.0) * (1 + y / WHITE**2) / (1 + y)
    codes = 255 * srgb_from_linear(np.clip(radiance * gain[..., None], 0, 1))
    return np.where(radius[..., None] <= 1, codes.round(), 0).astype(np.uint8)


class Thumbnails:
    """Those of one source. A thread makes them by frames that `read` gives; it ends when all are made or `close` is called."""

    def __init__(self, frames: int, read: Callable[[], Callable[[int], Frame]]) -> None:
        """`read`: opens the source once more, in the thread, since what plays must not wait for it; gives its frames by number."""
        self._open, self._wanted = read, thumbnail_frames(frames)
        self._made: dict[int, np.ndarray] = {}
        self._closed = threading.Event()
        threading.Thread(target=self._make_all, name="thumbnails", daemon=True).start()

    def made(self) -> tuple[np.ndarray, np.ndarray]:
        """Frame numbers (n,) int64, ascending, and discs (n, side, side, 3) uint8, as far as there are."""
        made = dict(sorted(self._made.copy().items()))
        discs = np.array(list(made.values()), np.uint8).reshape(-1, THUMBNAIL_SIDE, THUMBNAIL_SIDE, 3)
        return np.array(list(made), np.int64), discs

    def close(self) -> None:
        self._closed.set()

    def _make_all(self) -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICE)
        adapted = 0.0
        try:
            frame_of = self._open()
            for k in self._in_order():
                frame = frame_of(k)
                adapted = adapted or log_average(frame)
                self._made[k] = disc(frame, adapted)
                if self._closed.wait(PAUSE_S):
                    return
        except (UserError, OSError):  # what plays says so when it comes to that frame
            return

    def _in_order(self) -> list[int]:
        """Every fourth first, so that one soon sees the whole in outline."""
        wanted = self._wanted
        return [*wanted[::4], *wanted[2::4], *wanted[1::2]]


class ThumbnailNews:
    """When thumbnails are sent: all of them, when some are new, and now and then for who has come since."""

    AGAIN_S = 10.0  # 33 kB a second
    NEW_S = 1.0

    def __init__(self) -> None:
        self._sent, self._sent_s = 0, float("-inf")

    def due(self, made: int) -> bool:
        """Whether so many are to be sent now."""
        since_s = time.monotonic() - self._sent_s
        if not made or since_s < (self.NEW_S if made > self._sent else self.AGAIN_S):
            return False
        self._sent, self._sent_s = made, time.monotonic()
        return True
