"""What the viewer has received of each service, and the judgement on it: who works, who waits, who is silent. The clock is passed in."""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, get_args

from vemlight.compiling import compiled_by
from vemlight.runtime import stamps, wire
from vemlight.runtime.channels import FRAMES, REPORT_PERIOD_S, STATUS, Instance, service_of
from vemlight.runtime.restarts import restart_of

# not seen: nothing yet. starting: a status but no frame yet, or started again after a death. live: frames come.
# waiting: no frames because the service before it has none. stalled: statuses come, and frames do not. silent: not even statuses.
# finished: its stream has ended.
State = Literal["not seen", "starting", "live", "waiting", "stalled", "silent", "finished"]
STATES: tuple[State, ...] = get_args(State)
HEALTHY: tuple[State, ...] = ("live", "finished")

MIN_STALL_S = 1.0  # `/healthz` shall be red within a second of a stalled stage, and not earlier: frames of fast sources come in bursts
OPENING_S = 90.0  # for a scene of the page: a few seconds, and ten times that on a loaded machine. Later the renderer is called silent
OPENING_FRAMES_S = 2.0  # in which a renderer that was asked for another scene still shows the one before: it hears within 0.5 s
SLOW_STEPS = 3  # a service that works on a frame publishes nothing: it may take three times what its frames took lately


class Judgement(NamedTuple):
    """A service's state, and the same in words for a person."""

    state: State
    text: str


class LastReceived:
    """The newest of what came from one service, and when: monotonic seconds."""

    def __init__(self, by_status: bool = False) -> None:
        """by_status: its frames do not come here, and its status says that there are new ones."""
        self.by_status = by_status
        self.made = False  # whether it has made a frame
        self.status: wire.StatusMessage | None = None
        self.status_s = 0.0
        self.stamp: stamps.Stamp | None = None
        self.frame_s = 0.0
        self.interval_s = 0.0  # between its last two frames
        self.ended = False

    def take(self, header: wire.Header, now_s: float) -> None:
        """Takes the header of a message that came `now_s`."""
        match header:
            case wire.StatusMessage():
                if self.by_status and header.sequence is not None and (self.status is None or header.frames != self.status.frames):
                    self.frame_s, self.made, self.ended = now_s, True, False
                self.made = self.made and header.sequence is not None  # a process that was started again begins anew
                self.status, self.status_s = header, now_s
            case wire.FrameHeader():
                self.interval_s = now_s - self.frame_s if self.stamp else 0.0
                self.stamp, self.frame_s, self.made, self.ended = header.stamp, now_s, True, False
            case wire.EndMessage():
                self.ended = True

    def age_ms(self) -> float | None:
        """How long ago the light of its newest frame was seen: it grows while the service stands still."""
        return None if self.stamp is None else stamps.age_ms(self.stamp)


class Liveness:
    """The judgement on the services that make frames."""

    def __init__(self, upstreams: Mapping[Instance, Sequence[Instance]], fps: float, lossless: bool = False) -> None:
        """`upstreams`: of each service, after them in order. `fps`: of the source. `lossless`: frames are made on request, and a service
        without a new one may just not be asked.

        Of several upstreams, the cameras of a rig, frames are not received, and one that is live is enough.
        """
        several = {name for before in upstreams.values() if len(before) > 1 for name in before}
        self.last_received: dict[Instance, LastReceived] = {name: LastReceived(by_status=name in several) for name in upstreams}
        self._upstreams = upstreams
        self._fps, self._lossless = fps, lossless
        self._scene_asked_s = float("-inf")

    def on_scene_asked(self, now_s: float) -> None:
        """Another scene was chosen: while the renderers open it, nothing comes from them."""
        self._scene_asked_s = now_s

    def judge(self, now_s: float) -> dict[Instance, Judgement]:
        """One judgement for each service, in the frames' order."""
        judged: dict[Instance, Judgement] = {}
        for name, before in self._upstreams.items():
            blocked_by = before[0] if before and all(judged[each].state != "live" for each in before) else None
            judged[name] = self._judge(name, now_s, blocked_by)
            if judged[name].state in ("silent", "stalled") and (kernel := compiled_by(name)):  # for what was just chosen
                judged[name] = Judgement("starting", f"compiling {kernel}")
            elif reason := restart_of(name):
                judged[name] = Judgement("starting", f"restarting: {reason}")
        return judged

    def _judge(self, service: Instance, now_s: float, blocked_by: Instance | None) -> Judgement:
        last = self.last_received[service]
        if last.ended:
            return Judgement("finished", "the stream has ended")
        if last.status is None and not last.made:
            kernel = compiled_by(service)
            return Judgement("not seen", f"compiling {kernel}, at the first start" if kernel else "nothing received yet")
        slow_s = SLOW_STEPS * max(last.interval_s, (last.status.step_ms or 0.0) / 1e3 if last.status else 0.0)
        silent_s, opening_s = now_s - max(last.status_s, last.frame_s), now_s - self._scene_asked_s
        opens = service_of(service) == "renderer" and opening_s < OPENING_S and last.frame_s < self._scene_asked_s + OPENING_FRAMES_S
        if opens and silent_s > MIN_STALL_S:
            return Judgement("starting", f"opens the scene, {_duration(opening_s)} so far")
        if silent_s > max(STATUS.timeout_s(self._fps), slow_s):  # a service publishes between two steps, never within one
            return Judgement("silent", f"silent for {_duration(silent_s)}")
        if not last.made:
            return Judgement("starting", f"waiting for {blocked_by}" if blocked_by else "no frame yet")

        least_s = MIN_STALL_S + REPORT_PERIOD_S * last.by_status
        stall_s = float("inf") if self._lossless else max(least_s, FRAMES[service_of(service)].timeout_s(self._fps))
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
