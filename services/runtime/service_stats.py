"""What a service counts and times of its own frames, and says as its status."""

import time
from collections import deque
from statistics import median

from vemlight.runtime import wire
from vemlight.runtime.channels import STATUS_PERIOD_S, Service

RATE_WINDOW_S = 2.0


class Losses:
    """Frames of one producer that it published and that never came here.

    Its status and its frames come through one socket in order, so between two statuses the frames it counts and those that came
    must agree; what is missing was dropped on the way. Gaps in the frames' numbers would also count what it never made.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._before = 0  # dropped before the producer last began to count
        self._first: int | None = None  # its count when this began
        self._came = 0

    def frame(self) -> None:
        self._came += 1

    def status(self, frames: int) -> None:
        if self._first is None or frames < self._first + self._came:  # the first status, or it was started again
            self._first, self._came, self._before = frames, 0, self.dropped
        self.dropped = self._before + frames - self._first - self._came


class ServiceStats:
    """What a service says of itself: counts, rates and times of the frames it has done."""

    def __init__(self, service: Service, restarts: int) -> None:
        self.service, self.restarts = service, restarts
        self.frames = self.skipped = self.dropped = self.refused = 0
        self._newest: wire.Stamp | None = None
        self._age_ms = 0.0
        self._done_s: deque[float] = deque(maxlen=256)
        self._step_ms: deque[float] = deque(maxlen=32)
        self._report: wire.MapReport | wire.LightsReport | wire.ImageReport | None = None
        self._due_s = 0.0

    def finished(self, message: wire.Message, took_s: float) -> None:
        header = message[0]
        assert isinstance(header, wire.FRAME)
        self.frames += 1
        self._newest, self._age_ms = header.stamp, wire.age_ms(header.stamp)
        self._done_s.append(time.monotonic())
        self._step_ms.append(took_s * 1e3)
        self._report = None if isinstance(header, wire.PlateMessage) else header.report

    def due(self) -> wire.StatusMessage | None:
        """The status, when it is time to say it again."""
        now = time.monotonic()
        if now < self._due_s:
            return None
        self._due_s = now + STATUS_PERIOD_S
        recent = [t for t in self._done_s if t > now - RATE_WINDOW_S]
        if len(recent) < 2:  # slower than the window: the last two frames tell
            recent = list(self._done_s)[-2:]
        rate_hz = (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 and recent[-1] > recent[0] else 0.0
        return wire.StatusMessage(
            service=self.service,
            sequence=self._newest.sequence if self._newest else None,
            rate_hz=rate_hz,
            age_ms=self._age_ms if self._newest else None,
            step_ms=median(self._step_ms) if self._step_ms else None,
            frames=self.frames,
            skipped=self.skipped,
            dropped=self.dropped,
            refused=self.refused,
            restarts=self.restarts,
            report=self._report,
        )
