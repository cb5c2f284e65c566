"""Live: which frames of several cameras show one moment, as they come. A value of its own; clocks are passed in.

The fastest camera sets the beat, of several alike the first of the rig: each of its frames is a moment, of which every other camera gives
the frame that was seen nearest in time. A moment is ready when no camera can have a nearer one to come, or when its patience is over.
"""

import math
from collections import deque
from statistics import median
from typing import NamedTuple

from vemlight.runtime import stamps, wire
from vemlight.runtime.channels import FRAMES

# A camera is left out when nothing came from it for so long, and for as many of its frames as a service may miss: until then its last map
# is held, for a lost frame shall not flicker. A killed capture is back after 2 s. 0.2 to 1 s would do
SILENT_S = 0.5
SILENT_FRAMES = FRAMES["capture"].max_missed + 1
LATE_FRAMES = 1.75  # after which the next camera sets the beat: a frame that is late by three quarters is lost. 1.3 to 2 would do
PATIENCE_FRAMES = 2.0  # for which a moment waits for the cameras whose frames are on their way: 1 to 3 would do
LAST_FRAMES = 8  # of a camera: four times what the patience leaves waiting
BEATS = 16  # whose median interval is a camera's period
ALIKE = 1.5  # ratio of the periods of cameras that are equally fast: between 24 and 30 a second and 15 and 30. 1.3 to 1.9 would do
SLOWEST_NS = 2_000_000_000  # a longer interval is none between two frames but a pause. 1 to 4 s would do
EARLY = 0.25  # of the beat's period, by which a frame may be seen before it is due. 0.1 to 0.4 would do


class SeenFrame(NamedTuple):
    """A camera's frame: when its light was seen, and when it came here, on this host's monotonic clock."""

    at_ns: int
    came_ns: int
    message: wire.Message


class Moment(NamedTuple):
    """What is fused. frames: of each camera; None where it is silent. spread_ns: between the earliest and the latest of them."""

    at_ns: int
    stamp: stamps.Stamp
    frames: tuple[wire.Message | None, ...]
    spread_ns: int


class Moments:
    """Takes frames, gives moments, each later than the one before."""

    def __init__(self, cameras: int, fps: float) -> None:
        """`fps`: until frames have shown their own rate."""
        self.skipped = 0  # moments passed over for a newer one
        self._frames: list[deque[SeenFrame]] = [deque(maxlen=LAST_FRAMES) for _ in range(cameras)]
        self._intervals_ns: list[deque[int]] = [deque(maxlen=BEATS) for _ in range(cameras)]
        self._first_ns = 1e9 / fps
        self._last_ns: int | None = None
        self._beat = 0  # the camera that set the last one
        self._to_catch_up = 0  # moments that waited when another camera began to set the beat: none of them is passed over

    @property
    def period_ns(self) -> float:
        """Of the camera that sets the beat."""
        return self._period_ns(self._beat)

    def _period_ns(self, camera: int) -> float:
        """A camera's own; of one whose rate is not known that of the others."""
        own = self._intervals_ns[camera]
        known = [median(intervals) for intervals in ([own] if own else self._intervals_ns) if intervals]
        return median(known) if known else self._first_ns

    def _silent_ns(self, camera: int) -> float:
        """After so long without a frame a camera is left out."""
        return max(SILENT_S * 1e9, SILENT_FRAMES * self._period_ns(camera))

    def take(self, camera: int, message: wire.Message, at_ns: int, now_ns: int) -> None:
        """A frame of a camera whose light was seen `at_ns`; in the future nothing was seen."""
        frames, intervals, at_ns = self._frames[camera], self._intervals_ns[camera], min(at_ns, now_ns)
        if frames and at_ns <= frames[-1].at_ns:  # a camera that was restarted, or whose clock was set back
            frames.clear()
            intervals.clear()
        elif frames and intervals and now_ns - frames[-1].came_ns > self._silent_ns(camera):  # it may be back at another rate
            intervals.clear()
        elif frames and at_ns - frames[-1].at_ns <= SLOWEST_NS:
            intervals.append(at_ns - frames[-1].at_ns)
        frames.append(SeenFrame(at_ns, now_ns, message))

    def silent(self, now_ns: int) -> tuple[bool, ...]:
        """Whether each camera is left out."""
        return tuple(not frames or now_ns - frames[-1].came_ns > self._silent_ns(k) for k, frames in enumerate(self._frames))

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
        """Chooses the first of the fastest that are not late, or else the first that is not silent."""
        periods_ns = [self._period_ns(k) for k in range(len(self._frames))]
        on_time = [k for k, frames in enumerate(self._frames) if frames and now_ns - frames[-1].came_ns <= LATE_FRAMES * periods_ns[k]]
        slowest_ns = ALIKE * min((periods_ns[k] for k in on_time), default=0.0)
        beat = next((k for k in on_time if periods_ns[k] <= slowest_ns), silent.index(False))
        if beat != self._beat:
            self._beat = beat
            self._to_catch_up = len(self._waiting())

    def _waiting(self) -> list[SeenFrame]:
        """The frames of the camera that sets the beat which are later than the last moment, oldest first."""
        after_ns = -math.inf if self._last_ns is None else self._last_ns + self.period_ns / 2
        return [seen for seen in self._frames[self._beat] if seen.at_ns > after_ns]

    def _is_ready(self, seen: SeenFrame, silent: tuple[bool, ...], now_ns: int) -> bool:
        if now_ns - seen.came_ns >= PATIENCE_FRAMES * self.period_ns:
            return True
        half_ns, early_ns = self.period_ns / 2, EARLY * self.period_ns
        return all(
            silent[k]
            or frames[-1].at_ns >= seen.at_ns - half_ns
            or frames[-1].at_ns + self._period_ns(k) - early_ns > seen.at_ns + half_ns  # its next one is not due yet
            for k, frames in enumerate(self._frames)
        )


def _nearest(frames: deque[SeenFrame], at_ns: int) -> SeenFrame:
    return min(frames, key=lambda seen: abs(seen.at_ns - at_ns))


def seen_at_ns(stamp: stamps.Stamp, boot_id: str, monotonic_ns: int, realtime_ns: int) -> int:
    """When the light of a stamp was seen, on the monotonic clock of this host. Of another host: by its realtime clock.

    boot_id, monotonic_ns, realtime_ns: this host's, now.
    """
    if stamp.boot_id and stamp.boot_id == boot_id:
        return stamp.monotonic_ns
    return monotonic_ns - (realtime_ns - stamp.captured_ns)
