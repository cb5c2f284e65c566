"""Live: which frames of several cameras show one moment, as they come. A value of its own; clocks are passed in.

The first camera of the rig whose frames come sets the beat: each of its frames is a moment, of which every other camera gives the frame
that was seen nearest in time. A moment is ready when no camera can have a nearer one to come, or when its patience is over.
"""

import math
from collections import deque
from statistics import median
from typing import NamedTuple

from vemlight.runtime import wire
from vemlight.runtime.channels import FRAMES

# A camera is left out when nothing came from it for so long, and for as many of its frames as a service may miss: until then its last map
# is held, for a lost frame shall not flicker. A killed capture is back after 2 s. 0.2 to 1 s would do
SILENT_S = 0.5
SILENT_FRAMES = FRAMES["capture"].max_missed + 1
LATE_FRAMES = 1.75  # after which the next camera sets the beat: a frame that is late by three quarters is lost. 1.3 to 2 would do
PATIENCE_FRAMES = 2.0  # for which a moment waits for the cameras whose frames are on their way: 1 to 3 would do
LAST_FRAMES = 8  # of a camera: four times what the patience leaves waiting
BEATS = 16  # whose median interval is the period


class Seen(NamedTuple):
    """A camera's frame: when its light was seen, and when it came here, on this host's monotonic clock."""

    at_ns: int
    came_ns: int
    message: wire.Message


class Moment(NamedTuple):
    """What is fused. frames: of each camera; None where it is silent. spread_ns: between the earliest and the latest of them."""

    at_ns: int
    stamp: wire.Stamp
    frames: tuple[wire.Message | None, ...]
    spread_ns: int


class Moments:
    """Takes frames, gives moments, each later than the one before."""

    def __init__(self, cameras: int, fps: float) -> None:
        """`fps`: until frames have shown their own rate."""
        self.skipped = 0  # moments passed over for a newer one
        self._frames: list[deque[Seen]] = [deque(maxlen=LAST_FRAMES) for _ in range(cameras)]
        self._intervals_ns: deque[int] = deque([round(1e9 / fps)], maxlen=BEATS)
        self._last_ns: int | None = None
        self._beat = 0  # the camera that set the last one
        self._to_catch_up = 0  # moments that waited when another camera began to set the beat: none of them is passed over

    @property
    def period_ns(self) -> float:
        return median(self._intervals_ns)

    def take(self, camera: int, message: wire.Message, at_ns: int, now_ns: int) -> None:
        """A frame of a camera whose light was seen `at_ns`; in the future nothing was seen."""
        frames, at_ns = self._frames[camera], min(at_ns, now_ns)
        if frames and at_ns <= frames[-1].at_ns:  # a camera that was restarted, or whose clock was set back
            frames.clear()
        elif frames and camera == self._beat:
            self._intervals_ns.append(at_ns - frames[-1].at_ns)
        frames.append(Seen(at_ns, now_ns, message))

    def silent(self, now_ns: int) -> tuple[bool, ...]:
        """Whether each camera is left out."""
        limit_ns = max(SILENT_S * 1e9, SILENT_FRAMES * self.period_ns)
        return tuple(not frames or now_ns - frames[-1].came_ns > limit_ns for frames in self._frames)

    def next(self, now_ns: int) -> Moment | None:
        """The newest moment that is ready."""
        silent = self.silent(now_ns)
        if all(silent):
            return None
        self._set_beat(silent, now_ns)
        waiting = self._waiting()
        ready = [k for k, seen in enumerate(waiting) if self._is_ready(seen, silent, now_ns)]
        if not ready:
            return None
        taken = ready[0] if self._to_catch_up else ready[-1]
        self._to_catch_up = max(0, self._to_catch_up - 1)
        self.skipped += taken
        seen = waiting[taken]
        chosen = [None if left_out else _nearest(frames, seen.at_ns) for frames, left_out in zip(self._frames, silent, strict=True)]
        times = [each.at_ns for each in chosen if each]
        self._last_ns = seen.at_ns
        header = seen.message[0]
        assert isinstance(header, wire.FrameHeader)
        return Moment(seen.at_ns, header.stamp, tuple(each and each.message for each in chosen), max(times) - min(times))

    def wait_ns(self, now_ns: int) -> float:
        """How long until a moment may be ready though no frame comes."""
        came = [seen.came_ns for seen in self._waiting()]
        return max(0.0, min(came) + PATIENCE_FRAMES * self.period_ns - now_ns) if came else math.inf

    def _set_beat(self, silent: tuple[bool, ...], now_ns: int) -> None:
        """Chooses the first camera that is not late, or else the first that is not silent."""
        late_ns = now_ns - LATE_FRAMES * self.period_ns
        on_time = [k for k, frames in enumerate(self._frames) if frames and frames[-1].came_ns >= late_ns]
        beat = on_time[0] if on_time else silent.index(False)
        if beat != self._beat:
            self._beat = beat
            self._intervals_ns = deque([round(self.period_ns)], maxlen=BEATS)
            self._to_catch_up = len(self._waiting())

    def _waiting(self) -> list[Seen]:
        """The frames of the camera that sets the beat which are later than the last moment, oldest first."""
        after_ns = -math.inf if self._last_ns is None else self._last_ns + self.period_ns / 2
        return [seen for seen in self._frames[self._beat] if seen.at_ns > after_ns]

    def _is_ready(self, seen: Seen, silent: tuple[bool, ...], now_ns: int) -> bool:
        if now_ns - seen.came_ns >= PATIENCE_FRAMES * self.period_ns:
            return True
        settled_ns = seen.at_ns - self.period_ns / 2
        return all(left_out or frames[-1].at_ns >= settled_ns for frames, left_out in zip(self._frames, silent, strict=True))


def _nearest(frames: deque[Seen], at_ns: int) -> Seen:
    return min(frames, key=lambda seen: abs(seen.at_ns - at_ns))


def seen_at_ns(stamp: wire.Stamp, boot_id: str, monotonic_ns: int, realtime_ns: int) -> int:
    """When the light of a stamp was seen, on the monotonic clock of this host. Of another host: by its realtime clock.

    boot_id, monotonic_ns, realtime_ns: this host's, now.
    """
    if stamp.boot_id and stamp.boot_id == boot_id:
        return stamp.monotonic_ns
    return monotonic_ns - (realtime_ns - stamp.captured_ns)
