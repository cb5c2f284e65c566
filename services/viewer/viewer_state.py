"""All that the page shows: the newest frames ready to be sent, how each service is doing, and what the person has chosen."""

import time
from typing import Any

import msgspec
import numpy as np

from vemlight.errors import UserError
from vemlight.light.as_directional import as_directional
from vemlight.light.bright_cells import BrightCells
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import ErrorOfLights, LightSet, NearLights, lights_json, lights_row
from vemlight.light.lights_binary import binary_from_lights, placed_binary
from vemlight.runtime import stamps, wire
from vemlight.runtime.channels import FRAMES, LAST, UPSTREAM, Instance, service_of
from vemlight.runtime.instances import instance_of, instances, upstream
from vemlight.runtime.near_frames import NearFrames
from vemlight.runtime.poses import Pose
from vemlight.runtime.service_stats import LossCounter, ServiceStats
from vemlight.runtime.token import is_loopback
from vemlight.settings import Settings
from vemlight.viewer.ages import Ages
from vemlight.viewer.environment_feed import EnvironmentFeed
from vemlight.viewer.feeds import Condition, Feed
from vemlight.viewer.levels_json import levels_json
from vemlight.viewer.liveness import HEALTHY, Judgement, LastReceived, Liveness
from vemlight.viewer.measuring import Measuring
from vemlight.viewer.meter import Meter
from vemlight.viewer.pictures import Sky, picture_jpeg
from vemlight.viewer.report_fields import report_fields
from vemlight.viewer.saved_settings import saved_settings
from vemlight.viewer.scene_files import NO_SCENE, scene_files
from vemlight.viewer.sky_values import sky_values
from vemlight.viewer.timeline import Timeline
from vemlight.viewer.uploads import Uploads

NO_CONTROLS = "in lossless mode every frame is made with the settings as they are, and controls have no effect; use live mode"
OF_ONE_CAMERA = ("masks", "source", "record", "speed", "in_s", "out_s", "seek_number")  # of a control: what no camera of a rig obeys
NO_ARMING = (
    "whoever reaches this page could arm the fixtures, because it has no token: take [viewer] insecure out of the settings, or arm them "
    "there by [fixtures] arm"
)
PICTURE_STATE = "vemlight.picture/1"
EXAMPLE = '{"count": 72, "exposure": 0.5, "filtered": true, "paused": false, "poses": [{"name": "box", "position": [0, 0, 1]}]}'


class ViewerState:
    """One for the process. Messages go in by `take`, choices by `set_control`; pages read the feeds."""

    def __init__(self, settings: Settings, restarts: int) -> None:
        self.settings = settings
        self.started_s = time.time()
        self.control = wire.ControlMessage()
        self.control_changed, self.feeds_changed = Condition(), Condition()
        self.disc = Feed(Sky().disc_jpeg, self.feeds_changed)
        self.sky = Feed(sky_values, Condition())  # asked for by address, and by no socket that would wait for it
        self.lights = Feed(_lights_line, self.feeds_changed)
        self.lights_binary = Feed(_lights_binary, self.feeds_changed)
        self.placed_lights = Feed(_placed_lights, self.feeds_changed)
        self.levels = Feed(levels_json, self.feeds_changed)
        self.picture = Feed(self._encode_picture, self.feeds_changed)
        self.picture_state = Feed(_picture_state, self.feeds_changed)
        self.environment = EnvironmentFeed(self.feeds_changed)
        self.summaries = Feed(msgspec.json.encode, self.feeds_changed)
        self.feeds: dict[str, Feed] = {  # of sockets, by name
            "summary": self.summaries, "lights": self.lights, "levels": self.levels, "disc": self.disc, "picture": self.picture,
            "lights.bin": self.lights_binary, "placed-lights.bin": self.placed_lights, "picture-state": self.picture_state,
            "environment.bin": self.environment,
        }  # fmt: skip
        self.scene = NO_SCENE
        self.meter = Meter()
        self.name, self._last = instance_of(settings, "viewer"), instance_of(settings, LAST)
        self.stats = ServiceStats(self.name, restarts)
        self.status: wire.StatusMessage | None = None
        makers = {name: upstream(settings, service_of(name)) for name in instances(settings) if service_of(name) in UPSTREAM}
        self.liveness = Liveness(makers, settings.capture.fps, settings.mode == "lossless")
        self.pages = 0
        self._losses, self._light_count, self._encode_s = LossCounter(), 0, 0.0
        self._objects: tuple[Pose, ...] = ()
        self.timeline = Timeline()
        self.uploads = Uploads(settings.viewer.uploads_mb)
        self.measuring = Measuring()
        self._ages = Ages()
        self._near = NearFrames()

    def take(self, service: Instance, messages: list[wire.Message]) -> None:
        """Takes what came from one service, in order. Of its frames the newest is shown; the others count as skipped."""
        for header, arrays in messages:
            self.liveness.last_received[service].take(header, time.monotonic())
            if service == self._last and isinstance(header, wire.ImageMessage):
                self._losses.on_frame()
            elif service == self._last and isinstance(header, wire.StatusMessage):
                self._losses.on_status(header.frames)
            elif isinstance(header, wire.SourceMessage):
                self.timeline.take(header, arrays)
        for kind in {header.kind for header, _ in messages if isinstance(header, wire.FrameHeader)}:
            frames = [message for message in messages if message[0].kind == kind]
            self._show(*frames[-1], passed_over=len(frames) - 1)

    def _show(self, header: wire.Header, arrays: tuple[np.ndarray, ...], passed_over: int) -> None:
        match header:
            case wire.MapMessage():
                self.disc.put(header, arrays[0])
                self.sky.put(header, arrays[0])
                self.environment.newest_map = EnvironmentMap(arrays[0], header.coverage, BrightCells(*arrays[1:4]))
                self.meter.take_map(header, self.environment.newest_map)
            case wire.PointsMessage():
                self._near.take(header, arrays)
            case wire.LightsMessage():
                self._light_count = header.count
                self.meter.take_lights(arrays[0], arrays[2])
                self.environment.newest_lights = LightSet(*arrays[:-2])
                near = self._near.of(header.stamp)
                self.lights.put(header, near, *arrays[:-2])
                self.lights_binary.put(header, near, *arrays[:-2])
                self.placed_lights.put(header, near, *arrays[:-2])
            case wire.LevelsMessage():
                self.levels.put(header, *arrays)
            case wire.ImageMessage():
                self.picture.put(arrays[0])
                self.picture_state.put(header)
                self._objects = header.objects
                self._ages.take(stamps.age_ms(header.stamp))
                self.stats.skipped += passed_over
                self.stats.on_finished((header, arrays), self._encode_s)

    def take_scene(self, messages: list[wire.Message]) -> None:
        """Takes the scene that the renderer sent. One that cannot be is refused, and the page says so."""
        for header, arrays in messages:
            if isinstance(header, wire.SceneMessage):
                try:
                    self.scene = scene_files(header, *arrays)
                except ValueError as error:
                    self.stats.refused += 1
                    self.scene = NO_SCENE._replace(text=f"the renderer's scene cannot be: {error}")

    def _encode_picture(self, pixels: np.ndarray) -> bytes:
        started_s = time.monotonic()
        data = picture_jpeg(pixels)
        self._encode_s = time.monotonic() - started_s
        return data

    def status_if_due(self) -> wire.StatusMessage | None:
        """The viewer's own status, when it is time to publish it again."""
        self.stats.dropped = self._losses.dropped
        if status := self.stats.status_if_due():
            self.status = status
        return status

    def set_control(self, body: bytes) -> None:
        """Takes a JSON object with keys of wire.ControlMessage: those given replace the choices made before, null withdraws one.

        Raises UserError with one line for anything else.
        """
        if self.settings.mode == "lossless":
            raise UserError(NO_CONTROLS)
        try:
            change = msgspec.json.decode(body, type=dict[str, Any])
            whole = msgspec.to_builtins({**msgspec.structs.asdict(self.control), **change})
            control = msgspec.convert({key: value for key, value in whole.items() if value is not None}, wire.ControlMessage)
        except (ValueError, RecursionError) as error:
            raise UserError(f"control: {error}; send JSON like {EXAMPLE}") from error
        for key in OF_ONE_CAMERA if self.settings.rig.file else ():
            if getattr(control, key):
                raise UserError(f"{key}: is for one camera, and here those of a rig are fused; leave it out")
        if control.armed and self.why_not_arm:
            raise UserError(self.why_not_arm)
        if control.scene != self.control.scene:
            self.liveness.on_scene_asked(time.monotonic())
        self._take_control(control)

    def _take_control(self, control: wire.ControlMessage) -> None:
        self.control = control
        self.control_changed.notify()
        self.refresh()

    def measure(self) -> None:
        """Begins to look for settings that hold their rate here, from those in use; meanwhile what is seen stands still, to take no time.

        Raises UserError with one line where that cannot be.
        """
        if self.settings.mode == "lossless":
            raise UserError(NO_CONTROLS)
        task = self.measuring.start(saved_settings(self.settings, self.control, self.timeline.header))
        if not self.control.paused:
            self._pause(True)
            task.add_done_callback(lambda _: self._pause(False))
        self.refresh()

    def _pause(self, paused: bool) -> None:
        self._take_control(msgspec.structs.replace(self.control, paused=paused))

    @property
    def playing_uploads(self) -> set[str]:
        """The numbers of those that are chosen or play."""
        named = {self.control.source, *self.timeline.choices}
        numbers = {choice.partition(" ")[2] for choice in named if choice and choice.startswith("upload ")}
        return numbers | ({self.control.scene} if self.control.scene else set())

    @property
    def why_not_arm(self) -> str:
        """Why nobody may arm fixtures from this page; empty: who has opened it may."""
        viewer = self.settings.viewer
        if "fixtures" not in self.settings.services:
            return "there are no fixtures to arm; set [fixtures] rig"
        return "" if viewer.token or is_loopback(viewer.host) else NO_ARMING

    def refresh(self) -> None:
        """Puts a new summary into its feed, and the map for browsers' pictures where it is time and it is another one."""
        self.summaries.put(self.summary())
        self.environment.put_if_due(time.monotonic())

    @property
    def failures(self) -> dict[str, str]:
        """By name the feeds whose newest frame could not be encoded, and why."""
        return {name: feed.failure for name, feed in {**self.feeds, "sky.bin": self.sky}.items() if feed.failure}

    def summary(self) -> dict[str, Any]:
        """How everything stands, for the page, `/healthz` and `/metrics`."""
        judged = self.liveness.judge(time.monotonic())
        settings = self.settings
        rows = [service_row(service, judged[service], last) for service, last in self.liveness.last_received.items()]
        own = {"service": self.name, "kind": "viewer", **status_fields(self.status), "state": "live", "text": "live"}
        if judged[self._last].state not in HEALTHY:
            own |= {"state": "waiting", "text": f"waiting for {self._last}", "rate_hz": 0.0}
        chosen = msgspec.structs.asdict(self.control)
        del chosen["version"]
        return {
            "healthy": all(judgement.state in HEALTHY for judgement in judged.values()),
            "started_s": self.started_s,
            "mode": settings.mode,
            "why_no_controls": NO_CONTROLS if settings.mode == "lossless" else None,
            "control": chosen,
            "settings": {
                "count": self._light_count or settings.sampler.max_count if settings.sampler.error_limit else settings.sampler.max_count,
                "exposure": settings.renderer.exposure, "filtered": settings.sampler.filter != "none",
                "masks": settings.capture.masks, "lamps": settings.sampler.lamp, "poses": settings.renderer.poses,
            },
            "light_count": self._light_count,
            **self.uploads.summary(),
            "age": self._ages.percentiles(),
            "source": self.timeline.summary(),
            "objects": self._objects,
            "scene": {"hash": self.scene.hash, "text": self.scene.text},
            "fixtures": {"why_not_arm": self.why_not_arm} if "fixtures" in settings.services else None,
            "near_lights": _near_rows(self._near.newest),
            "measuring": self.measuring.summary(),
            "pages": self.pages,
            "failures": self.failures,
            "services": [*rows, own],
            "report_fields": {service: [field._asdict() for field in report_fields(service)] for service in judged},
        }  # fmt: skip


def status_fields(status: wire.StatusMessage | None) -> dict[str, Any]:
    """The status as plain values, its report as the dictionary `report`; nothing where there is no status."""
    if status is None:
        return {}
    return msgspec.structs.asdict(status) | {"report": msgspec.structs.asdict(status.report) if status.report else {}}


def service_row(service: Instance, judgement: Judgement, last: LastReceived) -> dict[str, Any]:
    """A service's newest status, with the judgement on it and what it publishes.

    `age_ms` is its newest frame's when it was done, or, when no more come, now.
    """
    status = status_fields(last.status)
    if judgement.state not in HEALTHY:
        status |= {"age_ms": last.age_ms()} | ({"rate_hz": 0.0} if last.status else {})
    own = {"service": service, "kind": service_of(service)}
    return {**status, **own, "publishes": FRAMES[service_of(service)].meaning, "state": judgement.state, "text": judgement.text}


def _near_rows(near: NearLights | None) -> list[dict[str, Any]]:
    """Where each near light is in the world, how far from where the directional ones are true, and its place's standard deviation, m."""
    if near is None:
        return []
    away = np.linalg.norm(near.points.at - np.array(near.at), axis=1).tolist()
    numbers = zip(near.points.ids.tolist(), near.points.at.tolist(), away, near.points.sigma.tolist(), strict=True)
    return [{"id": number, "at": at, "distance_m": distance, "sigma_m": sigma} for number, at, distance, sigma in numbers]


def _picture_state(header: wire.ImageMessage) -> bytes:
    """By what a picture was made besides its lights: how it was tone-mapped, and each object's position, rotation and scale."""
    places = [[round(number, 6) for number in (*pose.position, *pose.rotation, pose.scale or 1.0)] for pose in header.objects]
    tone = None if header.tone_scale is None else {"scale": header.tone_scale, "white": header.tone_white}
    return msgspec.json.encode({"schema": PICTURE_STATE, "sequence": header.stamp.sequence, "tone": tone, "objects": places})


def _lights_line(header: wire.LightsMessage, near: NearLights | None, *lights: np.ndarray) -> bytes:
    report = header.report
    error = ErrorOfLights(100 * report.error_ratio, 100 * report.error_limit_ratio) if report.error_limit_ratio else None
    row = lights_row(
        LightSet(*lights), header.stamp.sequence, header.stamp.time_s, header.coverage, error, header.clipped, near, header.estimated_lux
    )
    return lights_json(row)


def _lights_binary(header: wire.LightsMessage, near: NearLights | None, *lights: np.ndarray) -> bytes:
    return binary_from_lights(as_directional(LightSet(*lights), near), header.stamp.sequence, header.stamp.time_s, header.coverage)


def _placed_lights(header: wire.LightsMessage, near: NearLights | None, *lights: np.ndarray) -> bytes:
    return placed_binary(LightSet(*lights), near, header.stamp.sequence, header.stamp.time_s, header.coverage)
