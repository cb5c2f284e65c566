"""All that the page shows: the newest frames ready to be sent, how each service fares, and what the person wants."""

import time
from typing import Any

import msgspec
import numpy as np

from vemlight.errors import UserError
from vemlight.light.light_set import LightSet, lights_json, lights_row
from vemlight.runtime import wire
from vemlight.runtime.channels import LAST, UPSTREAM, Service
from vemlight.runtime.service_stats import Losses, ServiceStats
from vemlight.settings import Settings
from vemlight.viewer.feeds import Condition, Feed
from vemlight.viewer.liveness import HEALTHY, Judgement, LastReceived, Liveness
from vemlight.viewer.pictures import Sky, picture_jpeg

UNHEARD = "lossless mode makes every frame with the settings as they are and hears no controls; run in live mode to use them"
EXAMPLE = '{"count": 72, "exposure": 0.5, "filtered": true, "paused": false, "poses": [{"name": "box", "position": [0, 0, 1]}]}'
NO_LIGHTS = {"count": 0, **msgspec.structs.asdict(wire.LightsReport())}


class ViewerState:
    """One for the process. Messages go in by `take`, wishes by `wish_for`; pages read the feeds."""

    def __init__(self, settings: Settings, restarts: int) -> None:
        self.settings = settings
        self.started_s = time.time()
        self.wish = wire.ControlMessage()
        self.wished, self.news = Condition(), Condition()
        self.disc = Feed(Sky().disc_jpeg, self.news)
        self.lights = Feed(_lights_line, self.news)
        self.picture = Feed(self._picture, self.news)
        self.report = Feed(msgspec.json.encode, self.news)
        self.stats = ServiceStats("viewer", restarts)
        self.status: wire.StatusMessage | None = None
        makers: list[Service] = [service for service in settings.services if service in UPSTREAM]
        self.liveness = Liveness(makers, settings.capture.fps, settings.mode == "lossless")
        self.pages = 0
        self._losses, self._lights, self._encode_s = Losses(), NO_LIGHTS, 0.0
        self._objects: tuple[wire.Pose, ...] = ()

    def take(self, service: Service, messages: list[wire.Message]) -> None:
        """What one service has said since last time, in order. Of its frames the newest is shown; the rest is counted as skipped."""
        for header, _ in messages:
            self.liveness.last_received[service].take(header, time.monotonic())
            if service == LAST and isinstance(header, wire.ImageMessage):
                self._losses.frame()
            elif service == LAST and isinstance(header, wire.StatusMessage):
                self._losses.status(header.frames)
        frames = [message for message in messages if isinstance(message[0], wire.FRAME)]
        if frames:
            self._show(*frames[-1], passed_over=len(frames) - 1)

    def _show(self, header: wire.Header, arrays: tuple[np.ndarray, ...], passed_over: int) -> None:
        match header:
            case wire.MapMessage():
                self.disc.put(header, arrays[0])
            case wire.LightsMessage():
                self._lights = {"count": header.count, **msgspec.structs.asdict(header.report)}
                self.lights.put(header, *arrays[:3])
            case wire.ImageMessage():
                self.picture.put(arrays[0])
                self._objects = header.objects
                self.stats.skipped += passed_over
                self.stats.finished((header, arrays), self._encode_s)

    def _picture(self, pixels: np.ndarray) -> bytes:
        began_s = time.monotonic()
        data = picture_jpeg(pixels)
        self._encode_s = time.monotonic() - began_s
        return data

    def status_due(self) -> wire.StatusMessage | None:
        """The viewer's own status, when it is time to say it again."""
        self.stats.dropped = self._losses.dropped
        if status := self.stats.due():
            self.status = status
        return status

    def wish_for(self, body: bytes) -> None:
        """Takes a JSON object with keys of wire.ControlMessage: those given replace the wish's, null gives back to the settings.

        Raises UserError with one line for anything else.
        """
        if self.settings.mode == "lossless":
            raise UserError(UNHEARD)
        try:
            change = msgspec.json.decode(body, type=dict[str, int | float | bool | str | list[wire.Pose] | None])
            whole = msgspec.to_builtins({**msgspec.structs.asdict(self.wish), **change})
            self.wish = msgspec.convert({key: value for key, value in whole.items() if value is not None}, wire.ControlMessage)
        except ValueError as error:
            raise UserError(f"control: {error}; send JSON like {EXAMPLE}") from error
        self.wished.ring()
        self.refresh()

    def refresh(self) -> None:
        """Puts a new report into its feed."""
        self.report.put(self.summary())

    def summary(self) -> dict[str, Any]:
        """How everything stands, for the page, `/healthz` and `/metrics`."""
        judged = self.liveness.judge(time.monotonic())
        s = self.settings
        rows = [service_row(service, judged[service], heard) for service, heard in self.liveness.last_received.items()]
        own = {"service": "viewer", **status_fields(self.status), "state": "live", "words": "live"}
        if judged[LAST].state not in HEALTHY:
            own |= {"state": "waiting", "words": f"waits for {LAST}", "rate_hz": 0.0}
        return {
            "healthy": all(judgement.state in HEALTHY for judgement in judged.values()),
            "started_s": self.started_s,
            "mode": s.mode,
            "why_no_controls": UNHEARD if s.mode == "lossless" else None,
            "wish": {key: value for key, value in msgspec.structs.asdict(self.wish).items() if key != "version"},
            "settings": {"count": s.sampler.count, "exposure": s.renderer.exposure, "filtered": s.sampler.filter != "none"},
            "lights": self._lights,
            "objects": self._objects,
            "pages": self.pages,
            "services": [*rows, own],
        }


def status_fields(status: wire.StatusMessage | None) -> dict[str, Any]:
    """The status's own fields and those of its report, side by side; none where there is no status."""
    if status is None:
        return {}
    report = msgspec.structs.asdict(status.report) if status.report else {}
    return {**msgspec.structs.asdict(msgspec.structs.replace(status, report=None)), **report}


def service_row(service: Service, judgement: Judgement, heard: LastReceived) -> dict[str, Any]:
    """A service's newest status, with the judgement on it. `age_ms` is its newest frame's when it was done, or, when no more come, now."""
    status = status_fields(heard.status)
    if judgement.state not in HEALTHY:
        status |= {"age_ms": heard.age_ms()} | ({"rate_hz": 0.0} if heard.status else {})
    return {**status, "service": service, "state": judgement.state, "words": judgement.words}


def _lights_line(header: wire.LightsMessage, ids: np.ndarray, directions: np.ndarray, irradiance: np.ndarray, *_fine: np.ndarray) -> bytes:
    row = lights_row(LightSet(ids, directions, irradiance), header.stamp.sequence, header.stamp.time_s, header.coverage)
    return lights_json(row)
