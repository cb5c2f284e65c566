"""The renderer as a stage of the pipeline: lights in, pictures out, and the pictures' files."""

import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from vemlight import settings
from vemlight.errors import of_setting
from vemlight.files import notice
from vemlight.light.bright_cells import BrightCells
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.extent import POINTS
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.accumulation import PASSES, Accumulation, MapLights
from vemlight.renderer.frame import AccumulationPass, FrameInput, FrameState, PlatePicture, ToneRequest
from vemlight.renderer.frame_budget import (
    LATE,
    MIN_LIGHTS,
    Budget,
    CostModel,
    FrameTimings,
    FrameWork,
    affordable_lights,
    least_ms,
    updated_costs,
)
from vemlight.renderer.frame_plan import budget_of, initial_state, plan, plan_upload
from vemlight.renderer.gl.constants import MAX_HALF, MAX_RADIANCE
from vemlight.renderer.output.image_sequence import ImageSequenceWriter
from vemlight.renderer.output.tonemap import Adaptation, tone_curve
from vemlight.renderer.output.video import check_video_settings
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.measured_lamps import lit_by_lamps, recognised, with_measured_lamps
from vemlight.renderer.scene.scene import Scene, ViewCamera, load_scene
from vemlight.renderer.scene.scene_pose import scene_pose
from vemlight.runtime import wire
from vemlight.runtime.channels import Service
from vemlight.runtime.poses import MAX_POSES, Pose, View
from vemlight.runtime.reports import ImageReport

FILE_SAMPLES = 4  # a pixel of a file is the average over its area
BLENDED_SAMPLES = 16  # where surfaces are there in part: each sample sees one, or what lies behind it
LIVE_SAMPLES = 1
LIVE_FRAME_MS = 100.0  # ten pictures a second: below that, motion is a series of pictures
NO_MAP_YET = EnvironmentMap(np.zeros((1, 1, 3), np.float32), "hemisphere")  # polished things are dark before the first, and show no dots


def file_samples(scene: Scene) -> int:
    """How many samples a pixel of a scene's picture has in a file."""
    return BLENDED_SAMPLES if scene.blended else FILE_SAMPLES


class PausedPicture(NamedTuple):
    """A picture that gets better while nothing changes: the light, the poses and the view it shows, its passes so far, its pixels as last
    shown, its near lights."""

    light: MapLights
    poses: tuple[Pose, ...]
    view: View | None
    accumulation: Accumulation
    exposure: float
    pixels: np.ndarray
    near: NearLightSet


class Measured(NamedTuple):
    """What a frame did and how long that took. Of a step's result only this and the message's `render_ms` depend on a clock."""

    work: FrameWork
    timings: FrameTimings


class RendererState(NamedTuple):
    """What one picture leaves to the next.

    exposure: stops. picture: (height, width, 4) float32, linear; None where nobody wants it. paused_s: how long the scene's animations
    have stood still. environment: the map behind the lights. plate: what the second camera sees, (h, w, 3) uint8 sRGB. paused_picture: in
    a pause. view: from where the person looks; None: as the scene file says. costs: measured up to the picture before. late: whether the
    target time cannot be met. notices: lines for the person at the terminal. no_bounce: whether there is no time for light from surface to
    surface. near: the newest near lights. rig_centre: where they were measured. drawn_near: how many of them the newest picture has.
    """

    exposure: float
    adaptation: Adaptation | None
    time_s: float
    frame: FrameState
    picture: np.ndarray | None = None
    poses: tuple[Pose, ...] = ()
    view: View | None = None
    paused: bool = False
    paused_s: float = 0.0
    environment: EnvironmentMap | None = None
    plate: np.ndarray | None = None
    paused_picture: PausedPicture | None = None
    costs: CostModel = CostModel()
    measured: Measured | None = None
    late: bool = False
    no_bounce: bool = False
    notices: tuple[str, ...] = ()
    near: NearLightSet = NearLightSet.empty()
    rig_centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drawn_near: int = 0


class SceneChosen(Exception):
    """Another scene is wanted: the upload of that number, or the settings' one. The stage is of no more use."""

    def __init__(self, number: str | None) -> None:
        super().__init__()
        self.number = number


def passes_of(state: RendererState) -> dict[str, Any]:
    """What an ImageReport says of a paused picture; nothing of any other."""
    if state.paused_picture is None:
        return {}
    done = state.paused_picture.accumulation
    return {"passes": done.passes, "max_passes": PASSES, "pass_error_ratio": done.error}


def half_floats(picture: np.ndarray) -> np.ndarray:
    """A picture as float16; what is brighter than the largest half float becomes that."""
    return np.clip(np.nan_to_num(picture), -MAX_HALF, MAX_HALF).astype(np.float16)


class RendererStage:
    """See `vemlight.runtime.loop.Stage`."""

    service: Service = "renderer"

    def __init__(self, settings: settings.Settings, scene_number: str | None = None) -> None:
        """`scene_number`: of the upload that was asked for last.

        Raises UserError for a scene that cannot be read, a machine without GL, a folder that cannot be written.
        """
        self._scene_number = scene_number
        check_video_settings(settings)
        with of_setting("[renderer] scene"):
            scene = load_scene(Path(settings.renderer.scene) if settings.renderer.scene else None)
        if view := settings.renderer.camera:
            scene = scene._replace(camera=ViewCamera(position=view.eye, at=view.at, fov_y=view.fov_y))
        self._lamps = settings.renderer.lamp
        scene = with_measured_lamps(scene, self._lamps) if self._lamps else scene
        self._plate = ("plate",) if settings.plate.source else ()
        self._points = ("points",) if settings.rig.file else ()
        self._shows_environment, self._stops = settings.renderer.background == "map", settings.plate.stops
        self._glossy = scene.glossy
        self._needs_environment = self._shows_environment or self._glossy
        self._exposure, self._poses = settings.renderer.exposure, settings.renderer.poses
        self._linear = settings.renderer.picture == "linear16"
        self._images = ImageSequenceWriter(settings) if settings.out else None
        self._video = Path(settings.renderer.video) if settings.renderer.video else None
        drawing = settings.renderer
        if settings.mode == "lossless":  # there is time, and a picture shall follow from its lights alone
            drawing = msgspec.structs.replace(drawing, frame_ms=0.0)
        elif drawing.frame_ms is None:
            drawing = msgspec.structs.replace(drawing, frame_ms=LIVE_FRAME_MS)
        if drawing.light_regions is None and settings.capture.map_coverage == "hemisphere" and not settings.rig.file:
            drawing = msgspec.structs.replace(drawing, light_regions=0)
        self._renderer = Renderer(scene, drawing, file_samples(scene) if self._images else LIVE_SAMPLES)
        self._renderer.warm(bool(settings.rig.file))  # here, since the sampler compiles its own meanwhile, and what plays waits for both
        self._frame_ms, self._drawing = drawing.frame_ms or 0.0, drawing
        if settings.sampler.gloss_lights:
            notice("[sampler] gloss_lights: the renderer reflects the map itself; leave the key out unless another program takes that set")

    def release(self) -> None:
        """Frees what is on the GPU."""
        self._renderer.release()

    def scene_message(self) -> wire.Message:
        """The scene for browsers."""
        from vemlight.renderer.browser.flatten import scene_message  # here, since a run without a page has no use for it

        return scene_message(self._renderer.setup.scene, self._drawing)

    def first_missing_frame(self) -> int:
        return self._images.count if self._images else 0

    def start_at(self, target: int) -> tuple[RendererState, int]:
        """Starts at the target itself: the manifest has the adaptation after the picture before it."""
        before = self._images.last if self._images and target else None
        frame = initial_state(self._renderer.setup)
        adaptation, time_s = (before.adaptation, before.time_s) if before else (None, 0.0)
        return RendererState(self._exposure, adaptation, time_s, frame, poses=self._poses), target

    def side_inputs(self, state: RendererState) -> tuple[str, ...]:
        """The map where it is seen or reflected, and in a pause, which is lit by it; near lights where there is a rig of cameras."""
        maps = ("map",) if self._needs_environment or state.paused else ()
        return (*maps, *self._points, *self._plate)

    def step(self, state: RendererState, message: wire.Message) -> tuple[RendererState, wire.Message]:
        header, arrays = message
        assert isinstance(header, wire.LightsMessage)
        began_s = time.monotonic()
        time_s = header.stamp.time_s
        dt_s = max(0.0, time_s - state.time_s)
        costs = updated_costs(state.costs, *state.measured) if state.measured else state.costs
        paused_s = state.paused_s + dt_s if state.paused else state.paused_s
        state = state._replace(time_s=time_s, paused_s=paused_s, costs=costs, measured=None, notices=())
        shown = FrameInput(
            lights=self._renderer.drawable(LightSet(*arrays[:-2])),
            pose=scene_pose(self._renderer.setup.scene, time_s - paused_s, state.poses, state.view),
            environment=(state.environment or NO_MAP_YET) if self._glossy else None,
            background=state.environment if self._shows_environment else None,
            plate=PlatePicture(state.plate, self._stops) if state.plate is not None else None,
            tone=ToneRequest(state.adaptation, state.exposure, dt_s),
            linear=self._linear or self._images is not None,
            near=state.near,
        )
        shown = self._with_lamps(shown, state)
        if state.paused and state.environment:
            light = MapLights(state.environment.radiance, state.environment.coverage, LightSet(*arrays[:-2]))
            state, pixels, count = self._accumulate(state, shown, light)
        else:
            state, pixels, count = self._draw(state, shown)
        height, width, _ = pixels.shape
        budget, near = budget_of(self._renderer.setup, state.frame, state.costs), state.drawn_near
        shining = int(np.count_nonzero(shown.near.intensity.any(axis=1)))
        drawn_for_each = POINTS if header.soft and not self._renderer.setup.traced else 1
        curve = tone_curve(state.adaptation or Adaptation(), state.exposure, self._renderer.setup.tone)
        made = wire.ImageMessage(
            stamp=header.stamp,
            width=width,
            height=height,
            linear=self._linear,
            objects=shown.pose.objects[: MAX_POSES],
            tone_scale=min(curve.scale, MAX_RADIANCE),
            tone_white=min(curve.white or 0.0, MAX_RADIANCE),
            report=ImageReport(
                drawn_lights=count if state.paused else -(-count // drawn_for_each),
                render_ms=(time.monotonic() - began_s) * 1e3,
                light_budget=0 if state.paused or not self._frame_ms else self._light_budget(budget, near) // drawn_for_each,
                near_lights=shining,
                left_out_near_lights=shining - near,
                bounces_left_out=int(state.no_bounce and not state.paused),
                map_halvings=0 if state.paused else state.frame.coarsening,
                **passes_of(state),
            ),
        )
        arrays = (pixels, half_floats(state.picture)) if self._linear and state.picture is not None else (pixels,)
        return state, (made, arrays)

    def _with_lamps(self, shown: FrameInput, state: RendererState) -> FrameInput:
        """What is shown, with measured lamps in place of those near lights that they are."""
        if not self._lamps:
            return shown
        scene = self._renderer.setup.scene
        own, reaches_m = scene.luminaires[-len(self._lamps) :], [lamp.within_m for lamp in self._lamps]
        found = recognised(own, reaches_m, shown.near, np.array(state.rig_centre))
        return shown._replace(near=found.near, pose=lit_by_lamps(shown.pose, scene, found.colours))

    @staticmethod
    def _light_budget(budget: Budget, near: int) -> int:
        """How many directional lights there is time for beside near ones; 0: not known yet."""
        affordable = affordable_lights(budget)
        return max(affordable - near, MIN_LIGHTS) if affordable else 0

    def _draw(self, state: RendererState, shown: FrameInput) -> tuple[RendererState, np.ndarray, int]:
        """The state after a picture, its pixels and how many lights it has."""
        frame_plan, frame = plan(self._renderer.setup, state.frame, shown, state.costs)
        drawn = self._renderer.draw(frame_plan)
        assert drawn.pixels is not None
        measured = Measured(frame_plan.work, drawn.timings) if frame_plan.work else None
        state = state._replace(frame=frame, picture=drawn.picture, adaptation=drawn.adaptation, measured=measured, paused_picture=None)
        state = state._replace(drawn_near=len(frame_plan.lit_by.near.ids))
        return self._with_notices(state), drawn.pixels, len(frame_plan.lights.ids)

    def _accumulate(self, state: RendererState, shown: FrameInput, light: MapLights) -> tuple[RendererState, np.ndarray, int]:
        """One pass more of a picture under the map itself and its lamps, its pixels and how many lights it has; no work once converged."""
        before = state.paused_picture
        same = (
            before
            and (before.poses, before.view) == (state.poses, state.view)
            and before.near is state.near
            and before.light.same_as(light)
        )
        accumulation = before.accumulation if before and same else Accumulation.empty()
        if before and accumulation.converged and before.exposure == state.exposure:
            return state, before.pixels, accumulation.lights
        tone = ToneRequest(state.adaptation, state.exposure, None)  # the eye has long adapted to a picture that has converged
        if not accumulation.converged:
            number = accumulation.passes
            wanted = shown._replace(lights=AccumulationPass(light, number), tone=None, linear=True)
            frame_plan, frame = plan(self._renderer.setup, state.frame, wanted, state.costs)
            drawn = self._renderer.draw(frame_plan)
            assert drawn.picture is not None
            accumulation = accumulation.with_pass(drawn.picture)
            state, tone = state._replace(frame=frame, picture=accumulation.picture, drawn_near=len(frame_plan.lit_by.near.ids)), shown.tone
        whole = plan_upload(state.frame, accumulation.picture, shown._replace(tone=tone, linear=False))
        drawn = self._renderer.draw(whole)
        assert drawn.pixels is not None
        paused_picture = PausedPicture(light, state.poses, state.view, accumulation, state.exposure, drawn.pixels, state.near)
        return state._replace(adaptation=drawn.adaptation, paused_picture=paused_picture), drawn.pixels, accumulation.lights

    def _with_notices(self, state: RendererState) -> RendererState:
        """Adds a notice when the target frame time can no longer be met, or not with a bounce, and one when it can again."""
        no_bounce = self._renderer.setup.bounces and not state.frame.bounce
        if no_bounce != state.no_bounce:
            missed = f"[renderer] frame_ms: {self._frame_ms:g} ms leave no time for light from surface to surface; it is left out"
            line = f"vemlight: renderer: {missed if no_bounce else 'light from surface to surface is drawn again'}"
            state = state._replace(no_bounce=no_bounce, notices=(*state.notices, line))
        needed_ms = least_ms(budget_of(self._renderer.setup, state.frame, state.costs))
        late = needed_ms > self._frame_ms * (1 if state.late else LATE)
        if late == state.late:
            return state
        found = f"a picture takes {needed_ms:.0f} ms even with {MIN_LIGHTS} lights"
        missed = f"[renderer] frame_ms: {found}, not {self._frame_ms:g}; make width and height smaller"
        line = f"vemlight: renderer: {missed if late else 'the target frame time is met again'}"
        return state._replace(late=late, notices=(*state.notices, line))

    def on_message(self, state: RendererState, message: wire.Message) -> RendererState:
        header, arrays = message
        if isinstance(header, wire.ControlMessage):
            if header.scene != self._scene_number:
                raise SceneChosen(header.scene)
            exposure = self._exposure if header.exposure is None else header.exposure
            environment = state.environment if header.paused or self._needs_environment else None
            chosen = tuple({pose.name: pose for pose in (*self._poses, *header.poses)}.values())
            return state._replace(exposure=exposure, poses=chosen, view=header.camera, paused=header.paused, environment=environment)
        if isinstance(header, wire.MapMessage):
            return state._replace(environment=EnvironmentMap(arrays[0], header.coverage, BrightCells(*arrays[1:])))
        if isinstance(header, wire.PlateMessage):
            return state._replace(plate=arrays[0])
        if isinstance(header, wire.PointsMessage):
            near = NearLightSet(*arrays)  # the same one as long as its lights are the same: a pause goes on
            same = all(np.array_equal(before, now) for before, now in zip(state.near.arrays(), near.arrays(), strict=True))
            return state._replace(near=state.near if same else near, rig_centre=header.at)
        return state

    def write(self, state: RendererState, message: wire.Message) -> None:
        for line in state.notices:
            print(line, file=sys.stderr, flush=True)
        header, (pixels, *_) = message
        if self._images and state.picture is not None and state.adaptation is not None and isinstance(header, wire.ImageMessage):
            self._images.add(state.picture, pixels, header.stamp, state.adaptation)

    def finish(self) -> None:
        if self._images:
            self._images.complete(self._video)
