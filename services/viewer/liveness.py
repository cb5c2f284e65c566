"""What the viewer has received of each service, and the judgement on it: who works, who waits, who is silent. The clock is passed in."""

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

from vemlight.compiling import compiled_by
from vemlight.runtime import wire
from vemlight.runtime.channels import FRAMES, STATUS, UPSTREAM, Service

# not seen: nothing yet. starting: a status but no frame yet. live: frames come. waiting: no frames because the service before it has none.
# stalled: statuses come, and frames do not. silent: not even statuses. finished: its stream has ended.
State = Literal["not seen", "starting", "live", "waiting", "stalled", "silent", "finished"]
STATES: tuple[State, ...] = get_args(State)
HEALTHY: tuple[State, ...] = ("live", "finished")

MIN_STALL_S = 1.0  # `/healthz` shall be red within a second of a stalled stage, and not earlier: frames of fast sources come in bursts
SLOW_STEPS = 3  # a service that works on a frame publishes nothing: it may take three times what its frames took lately


class Judgement(NamedTuple):
    """A service's state, and the same in words for a person."""

    state: State
    text: str


class LastReceived:
    """The newest of what came from one service, and when: monotonic seconds."""

    def __init__(self) -> None:
        self.status: wire.StatusMessage | None = None
        self.status_s = 0.0
        self.stamp: wire.Stamp | None = None
        self.frame_s = 0.0
        self.interval_s = 0.0  # between its last two frames
        self.ended = False

    def take(self, header: wire.Header, now_s: float) -> None:
        """Takes the header of a message that came `now_s`."""
        match header:
            case wire.StatusMessage():
                self.status, self.status_s = header, now_s
            case wire.FrameHeader():
                self.interval_s = now_s - self.frame_s if self.stamp else 0.0
                self.stamp, self.frame_s, self.ended = header.stamp, now_s, False
            case wire.EndMessage():
                self.ended = True

    def age_ms(self) -> float | None:
        """How long ago the light of its newest frame was seen: it grows while the service stands still."""
        return None if self.stamp is None else wire.age_ms(self.stamp)


class Liveness:
    """The judgement on the services that make frames."""

    def __init__(self, services: Sequence[Service], fps: float, lossless: bool = False) -> None:
        """`services`: each after its upstream. `fps`: of the source. `lossless`: frames are made on request, and a service without a new
        one may just not be asked.
        """
        self.last_received: dict[Service, LastReceived] = {service: LastReceived() for service in services}
        self._fps, self._lossless = fps, lossless

    def judge(self, now_s: float) -> dict[Service, Judgement]:
        """One judgement for each service, in the frames' order."""
        judged: dict[Service, Judgement] = {}
        for service in self.last_received:
            upstream = UPSTREAM[service]
            judged[service] = self._judge(service, now_s, upstream if upstream and judged[upstream].state != "live" else None)
        return judged

    def _judge(self, service: Service, now_s: float, blocked_by: Service | None) -> Judgement:
        last = self.last_received[service]
        if last.ended:
            return Judgement("finished", "the stream has ended")
        if last.status is None and last.stamp is None:
            kernel = compiled_by(service)
            return Judgement("not seen", f"compiling {kernel}, at the first start" if kernel else "nothing received yet")
        slow_s = SLOW_STEPS * max(last.interval_s, (last.status.step_ms or 0.0) / 1e3 if last.status else 0.0)
        silent_s = now_s - max(last.status_s, last.frame_s)
        if silent_s > max(STATUS.timeout_s(self._fps), slow_s):  # a service publishes between two steps, never within one
            return Judgement("silent", f"silent for {_duration(silent_s)}")
        if last.stamp is None:
            return Judgement("starting", f"waiting for {blocked_by}" if blocked_by else "no frame yet")

        stall_s = float("inf") if self._lossless else max(MIN_STALL_S, FRAMES[service].timeout_s(self._fps))
        late_s = now_s - last.frame_s
        if late_s <= max(stall_s, slow_s):
            return Judgement("live", "live")
        if blocked_by:
            return Judgement("waiting", f"waiting for {blocked_by}")
        return Judgement("stalled", f"no frame for {_duration(late_s)}")


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.0f} h"
