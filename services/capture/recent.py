"""The last seconds of a camera, kept in memory to look at again."""

from collections import deque

import numpy as np

from vemlight.capture.frames import Frame

RECENT_S = 10.0
MAX_BYTES = 128 * 2**20  # 10 s of 25 maps of 90 x 360 a second have 97 MB; of larger ones fewer frames are kept


class RecentFrames:
    """The newest frames, at most RECENT_S and MAX_BYTES of them."""

    def __init__(self) -> None:
        self._frames: deque[Frame] = deque()
        self.nbytes = 0

    def add(self, frame: Frame) -> None:
        """Takes a frame, whose arrays must not change afterwards."""
        self._frames.append(frame)
        self.nbytes += frame_bytes(frame)
        while len(self._frames) > 1 and (self.nbytes > MAX_BYTES or frame.time_s - self._frames[0].time_s > RECENT_S):
            self.nbytes -= frame_bytes(self._frames.popleft())

    @property
    def span_s(self) -> float:
        """How far they reach back."""
        return max(0.0, self._frames[-1].time_s - self._frames[0].time_s) if self._frames else 0.0

    def frozen(self) -> "RecentSource":
        """A source of the frames that are there now. Raises IndexError where there are none."""
        return RecentSource(list(self._frames))


class RecentSource:
    """Frames in memory by index; see `vemlight.capture.source.FrameSource`."""

    def __init__(self, frames: list[Frame]) -> None:
        self._frames = frames
        span_s = frames[-1].time_s - frames[0].time_s
        self.fps = (len(frames) - 1) / span_s if span_s > 0 else 1.0

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, k: int) -> Frame:
        return self._frames[k]


def frame_bytes(frame: Frame) -> int:
    """What a frame's arrays take."""
    return sum(array.nbytes for array in (frame.radiance, *frame.bright_cells) if isinstance(array, np.ndarray))
