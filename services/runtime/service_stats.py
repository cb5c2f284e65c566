"""What a service counts and measures while it works, published as its status."""

import bisect
import sys
import time
from collections import deque
from statistics import median

from vemlight.files import one_line
from vemlight.runtime import stamps, wire
from vemlight.runtime.channels import REPORT_PERIOD_S, Instance
from vemlight.runtime.log_lines import LINE_PERIOD_S, LogLines
from vemlight.runtime.peers import Peer
from vemlight.runtime.reports import AnyReport

RATE_WINDOW_S = 2.0  # a quarter of it to four times as much serves: long enough that one late frame does not show, short enough to follow
STEP_WINDOW = 32  # frames in the median of step times: any value in 8..128 serves


class LossCounter:
    """Counts the frames that a producer published and that never came here.

    The producer's statuses and frames come through one socket in order, so between two statuses the frames that the producer counted and
    those that came must agree: what is missing was dropped on the way. Gaps in the frames' numbers would also count what was never made.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._dropped_before = 0  # until the producer last started to count
        self._first: int | None = None  # the producer's count when this one started
        self._received = 0

    def on_frame(self) -> None:
        self._received += 1

    def on_status(self, frames: int) -> None:
        """`frames`: the producer's own count."""
        if self._first is None or frames < self._first + self._received:  # the first status, or the producer was restarted
            self._first, self._received, self._dropped_before = frames, 0, self.dropped
        self.dropped = self._dropped_before + frames - self._first - self._received


class ServiceStats:
    """A service's counters and the times of its frames."""

    def __init__(self, service: Instance, restarts: int) -> None:
        self.service, self.restarts = service, restarts
        self.frames = self.skipped = self.dropped = self.refused = self.unwritten = 0
        self._newest: stamps.Stamp | None = None
        self._age_ms = 0.0
        self._finished_s: deque[float] = deque(maxlen=256)  # of 250 frames a second and more the rate is that of the last 256
        self._step_ms: deque[float] = deque(maxlen=STEP_WINDOW)
        self._step_counts = wire.STEP_BINS * [0]
        self._step_total_ms = 0.0
        self._report: AnyReport | None = None
        self._due_s = 0.0
        self._lines = LogLines()
        self._unwritten_before: int | None = None  # how many frames were unwritten when a line said that the disk refuses; None: it takes
        self._unwritten_line_s = float("-inf")

    def on_finished(self, message: wire.Message, step_s: float) -> None:
        """Counts a frame that this service has made in `step_s`."""
        header = message[0]
        assert isinstance(header, wire.FrameHeader)
        self.frames += 1
        self._newest, self._age_ms = header.stamp, stamps.age_ms(header.stamp)
        self._finished_s.append(time.monotonic())
        self._step_ms.append(step_s * 1e3)
        self._step_counts[bisect.bisect_left(wire.STEP_BOUNDS_MS, step_s * 1e3)] += 1
        self._step_total_ms += step_s * 1e3
        self._report = getattr(header, "report", None)  # a plate has none

    def on_report(self, report: AnyReport) -> None:
        """Replaces what the newest frame's header reports: of a service that goes on measuring between frames."""
        self._report = report

    def on_refused(self, error: ValueError, sender: Peer | None = None) -> None:
        """Counts a message that cannot be decoded, also against its sender; now and then a line says why."""
        self.refused += 1
        if sender:
            sender.on_refused()
        self._lines.say("refused", f"{self.service}: refused a message: {error}")

    def on_written(self, error: OSError | None) -> None:
        """Counts a frame that the disk has refused with `error`, if there is one.

        A line says when that begins and when it is over; a disk that takes some and refuses others shall not fill the log.
        """
        if error:
            if self._unwritten_before is None and time.monotonic() - self._unwritten_line_s > LINE_PERIOD_S:
                self._unwritten_before, self._unwritten_line_s = self.unwritten, time.monotonic()
                reason = error.strerror or one_line(error)
                text = f"nothing is written ({reason}); frames go on, and are written again when there is room"
                print(f"vemlight: {self.service}: {text}", file=sys.stderr, flush=True)
            self.unwritten += 1
        elif self._unwritten_before is not None:
            missing = self.unwritten - self._unwritten_before
            self._unwritten_before = None
            print(f"vemlight: {self.service}: writes again; {missing} frames were not written", file=sys.stderr, flush=True)

    def status_if_due(self) -> wire.StatusMessage | None:
        """The status, when it is time to publish it again."""
        now_s = time.monotonic()
        if now_s < self._due_s:
            return None
        self._due_s = now_s + REPORT_PERIOD_S
        return wire.StatusMessage(
            service=self.service,
            sequence=self._newest.sequence if self._newest else None,
            rate_hz=self._rate_hz(now_s),
            age_ms=self._age_ms if self._newest else None,
            step_ms=median(self._step_ms) if self._step_ms else None,
            step_counts=tuple(self._step_counts),
            step_total_ms=self._step_total_ms,
            frames=self.frames,
            skipped=self.skipped,
            dropped=self.dropped,
            refused=self.refused,
            restarts=self.restarts,
            unwritten=self.unwritten,
            report=self._report,
        )

    def _rate_hz(self, now_s: float) -> float:
        """Frames a second within RATE_WINDOW_S, or between the last two when they are further apart; 0 before the second."""
        recent = [t for t in self._finished_s if t > now_s - RATE_WINDOW_S]
        if len(recent) < 2:
            recent = list(self._finished_s)[-2:]
        return (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 and recent[-1] > recent[0] else 0.0
