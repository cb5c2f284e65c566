"""What the viewer has heard of each service, and its judgement: who works, who waits, who is silent. The clock is passed in."""

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

from vemlight.runtime import wire
from vemlight.runtime.channels import SILENT_S, UPSTREAM, Service

# not heard: nothing yet. starting: a status but no frame yet. live: frames come. waiting: no frames because the service before it has none.
# stalled: it speaks, and its frames stay away. silent: not even a status. finished: its stream has ended.
State = Literal["not heard", "starting", "live", "waiting", "stalled", "silent", "finished"]
STATES: tuple[State, ...] = get_args(State)
HEALTHY: tuple[State, ...] = ("live", "finished")

STALLED_S = 1.0  # `/healthz` shall be red within a second of a stalled stage
STALLED_FRAMES = 3  # and a source slower than 3 Hz has missed two frames by then


class Judgement(NamedTuple):
    """A service's state, and the same in words for a person."""

    state: State
    words: str


class LastReceived:
    """The newest of what one service said, and when: monotonic seconds."""

    def __init__(self) -> None:
        self.status: wire.StatusMessage | None = None
        self.status_s = 0.0
        self.stamp: wire.Stamp | None = None
        self.frame_s = 0.0
        self.pace_s = 0.0  # between its last two frames
        self.ended = False

    def take(self, header: wire.Header, now_s: float) -> None:
        match header:
            case wire.StatusMessage():
                self.status, self.status_s = header, now_s
            case wire.MapMessage() | wire.LightsMessage() | wire.ImageMessage() | wire.PlateMessage():
                self.pace_s = now_s - self.frame_s if self.stamp else 0.0
                self.stamp, self.frame_s, self.ended = header.stamp, now_s, False
            case wire.EndMessage():
                self.ended = True

    def age_ms(self) -> float | None:
        """How long ago the light of its newest frame was seen: it grows while the service stands still."""
        return None if self.stamp is None else wire.age_ms(self.stamp)


class Liveness:
    """The services that make frames."""

    def __init__(self, services: Sequence[Service], fps: float, lossless: bool = False) -> None:
        """`services`: each after its upstream. `fps`: of the source. `lossless`: frames are made on request, and who has no frame for long
        may just not be asked.
        """
        self.last_received: dict[Service, LastReceived] = {service: LastReceived() for service in services}
        self._patience_s = float("inf") if lossless else max(STALLED_S, STALLED_FRAMES / fps)

    def judge(self, now_s: float) -> dict[Service, Judgement]:
        """One judgement for each service, in the frames' order."""
        judged: dict[Service, Judgement] = {}
        for service in self.last_received:
            upstream = UPSTREAM[service]
            judged[service] = self._judge(service, now_s, upstream if upstream and judged[upstream].state != "live" else None)
        return judged

    def _judge(self, service: Service, now_s: float, blocked_by: Service | None) -> Judgement:
        heard = self.last_received[service]
        if heard.ended:
            return Judgement("finished", "the stream has ended")
        if heard.status is None and heard.stamp is None:
            return Judgement("not heard", "not heard yet")
        slow_s = STALLED_FRAMES * max(heard.pace_s, (heard.status.step_ms or 0.0) / 1e3 if heard.status else 0.0)
        silent_s = now_s - max(heard.status_s, heard.frame_s)
        if silent_s > max(SILENT_S, slow_s):  # it speaks between two steps, never within one
            return Judgement("silent", f"silent for {_duration(silent_s)}")
        if heard.stamp is None:
            return Judgement("starting", f"waits for {blocked_by}" if blocked_by else "no frame yet")

        late_s = now_s - heard.frame_s
        if late_s <= max(self._patience_s, slow_s):
            return Judgement("live", "live")
        if blocked_by:
            return Judgement("waiting", f"waits for {blocked_by}")
        return Judgement("stalled", f"no frame for {_duration(late_s)}")


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.0f} h"
