"""The renderer as a stage of the pipeline: lights in, pictures out, and the pictures' files."""

import sys
import time
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from vemlight import settings
from vemlight.errors import UserError
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage
from vemlight.renderer.accumulation import MapLights, Refined
from vemlight.renderer.frame_budget import FEWEST, LATE
from vemlight.renderer.output.image_sequence import ImageSequenceWriter
from vemlight.renderer.output.tonemap import Adaptation, adapt, subsampled
from vemlight.renderer.output.video import check_video_path
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.runtime import wire
from vemlight.runtime.channels import Service

FILE_SAMPLES = 4  # a pixel of a file is the average over its area
BLENDED_SAMPLES = 16  # where surfaces are there in part: each sample sees one, or what lies behind it
LIVE_SAMPLES = 1
LIVE_FRAME_MS = 100.0  # ten pictures a second: below that, motion is a series of pictures


def file_samples(scene: Scene) -> int:
    """How many samples a pixel of a scene's picture has in a file."""
    return BLENDED_SAMPLES if scene.blended else FILE_SAMPLES


class Still(NamedTuple):
    """A picture that gets better while nothing changes: of what light, with what where, how far, and as it was last shown."""

    light: MapLights
    poses: tuple[wire.Pose, ...]
    refined: Refined
    exposure: float
    pixels: np.ndarray


class RendererState(NamedTuple):
    """What the tone mapping remembers, what the person at the viewer wants, and the picture just made."""

    exposure: float  # stops
    adaptation: Adaptation | None
    time_s: float
    picture: np.ndarray | None  # (height, width, 4) float32, linear; None where nobody wants it
    poses: tuple[wire.Pose, ...] = ()
    paused: bool = False
    paused_s: float = 0.0  # how long the scene's animations have stood still
    around: tuple[np.ndarray, Coverage] | None = None  # the map behind the lights
    plate: np.ndarray | None = None  # what the second camera sees, (h, w, 3) uint8 sRGB
    still: Still | None = None  # in a pause


def half_floats(picture: np.ndarray) -> np.ndarray:
    """A picture as float16; what is brighter than the largest half float, 65504, becomes that."""
    return np.clip(np.nan_to_num(picture), -65504, 65504).astype(np.float16)


class RendererStage:
    """See `vemlight.runtime.loop.Stage`."""

    service: Service = "renderer"

    def __init__(self, settings: settings.Settings) -> None:
        """Raises UserError for a scene that cannot be read, a machine without GL, a folder that cannot be written."""
        scene = load_scene(Path(settings.renderer.scene) if settings.renderer.scene else None)
        self._plate: tuple[Service, ...] = ("plate",) if settings.plate.source else ()
        self._behind, self._stops = settings.renderer.background == "map", settings.plate.stops
        self._exposure = settings.renderer.exposure
        self._linear = settings.renderer.picture == "linear16"
        pixel_bytes = 8 if self._linear else 4
        if settings.renderer.width * settings.renderer.height * pixel_bytes > wire.MAX_PART:
            size = f"{settings.renderer.width} x {settings.renderer.height}"
            most = wire.MAX_PART // pixel_bytes
            raise UserError(f"[renderer] width, height: {size} is more than the {most} pixels that one message holds; make them smaller")
        self._album = ImageSequenceWriter(Path(settings.out)) if settings.out else None
        self._video = Path(settings.renderer.video) if settings.renderer.video else None
        if self._video:
            check_video_path(self._video)
            if not self._album:
                raise UserError("[renderer] video: is made of the pictures in the folder out, which is not set; set it, or use --out")
        drawing = settings.renderer
        if settings.mode == "lossless":  # there is time, and a picture shall follow from its lights alone
            drawing = msgspec.structs.replace(drawing, frame_ms=0.0)
        elif drawing.frame_ms is None:
            drawing = msgspec.structs.replace(drawing, frame_ms=LIVE_FRAME_MS)
        if drawing.light_regions is None and settings.capture.coverage == "hemisphere":
            drawing = msgspec.structs.replace(drawing, light_regions=0)
        self._renderer = Renderer(scene, drawing, file_samples(scene) if self._album else LIVE_SAMPLES)
        self._frame_ms, self._late = drawing.frame_ms or 0.0, False

    def first_missing_frame(self) -> int:
        return self._album.count if self._album else 0

    def start_at(self, target: int) -> tuple[RendererState, int]:
        """At the target itself: what the tone mapping remembered stands beside the picture before it."""
        before = self._album.last if self._album and target else None
        return RendererState(self._exposure, before and before.adaptation, before.time_s if before else 0.0, None), target

    def side_inputs(self, state: RendererState) -> tuple[Service, ...]:
        """The map where it is seen, and in a pause, which is lit by it."""
        around: tuple[Service, ...] = ("capture",) if self._behind or state.paused else ()
        return (*around, *self._plate)

    def step(self, state: RendererState, message: wire.Message) -> tuple[RendererState, wire.Message]:
        header, arrays = message
        assert isinstance(header, wire.LightsMessage)
        began_s = time.monotonic()
        time_s = header.stamp.time_s
        dt_s = max(0.0, time_s - state.time_s)
        state = state._replace(time_s=time_s, paused_s=state.paused_s + dt_s if state.paused else state.paused_s)
        objects = self._renderer.place(time_s - state.paused_s, state.poses)
        if self._behind and state.around:
            self._renderer.show_background(*state.around)
        if state.plate is not None:
            self._renderer.show_plate(state.plate, self._stops)
        if state.paused and state.around:
            state, pixels, count = self._refine(state, *state.around, dt_s)
        else:
            self._renderer.draw(LightSet(*arrays[:3]), LightSet.of(np.arange(header.gloss_count), *arrays[3:5]))
            picture = self._renderer.picture() if self._linear or self._album else None
            state = state._replace(picture=picture, adaptation=adapt(state.adaptation, self._renderer.selected(), dt_s), still=None)
            pixels, count = self._renderer.tone_mapped(state.adaptation or Adaptation(), state.exposure), self._renderer.drawn_lights
            self._say_when_late()
        height, width, _ = pixels.shape
        took_ms = (time.monotonic() - began_s) * 1e3
        made = wire.ImageMessage(
            stamp=header.stamp,
            width=width,
            height=height,
            linear=self._linear,
            objects=objects[: wire.MAX_POSES],
            report=wire.ImageReport(
                drawn_lights=count,
                render_ms=took_ms,
                light_budget=0 if state.paused else self._renderer.affordable_lights or 0,
            ),
        )
        arrays = (pixels, half_floats(state.picture)) if self._linear and state.picture is not None else (pixels,)
        return state, (made, arrays)

    def _refine(self, state: RendererState, radiance: np.ndarray, coverage: Coverage, dt_s: float) -> tuple[RendererState, np.ndarray, int]:
        """One pass more of a picture under the map itself, its pixels and how many lights it has; no work once it has converged."""
        before = state.still
        same = before and before.poses == state.poses and np.array_equal(before.light.radiance, radiance)
        light = before.light if before and same else MapLights(radiance, coverage)
        refined = before.refined if before and same else Refined.nothing()
        if before and refined.converged and before.exposure == state.exposure:
            return state, before.pixels, refined.lights
        if not refined.converged:
            refined = refined.with_pass(self._renderer.render_pass(light, refined.passes))
            self._renderer.show(refined.picture)
            state = state._replace(picture=refined.picture, adaptation=adapt(state.adaptation, subsampled(refined.picture), dt_s))
        pixels = self._renderer.tone_mapped(state.adaptation or Adaptation(), state.exposure)
        return state._replace(still=Still(light, state.poses, refined, state.exposure, pixels)), pixels, refined.lights

    def _say_when_late(self) -> None:
        """One line when the target frame time cannot be met, and one when it can again."""
        least_ms = self._renderer.least_ms
        late = least_ms > self._frame_ms * (1 if self._late else LATE)
        if late == self._late:
            return
        self._late = late
        missed = f"[renderer] frame_ms: {least_ms:.0f} ms a picture even with {FEWEST} lights, not {self._frame_ms:g}; ask for fewer pixels"
        print(f"vemlight: renderer: {missed if late else 'pictures are in time again'}", file=sys.stderr, flush=True)

    def on_message(self, state: RendererState, message: wire.Message) -> RendererState:
        header, arrays = message
        if isinstance(header, wire.ControlMessage):
            exposure = self._exposure if header.exposure is None else header.exposure
            around = state.around if header.paused else None
            return state._replace(exposure=exposure, poses=header.poses, paused=header.paused, around=around)
        if isinstance(header, wire.MapMessage):
            return state._replace(around=(arrays[0], header.coverage))
        if isinstance(header, wire.PlateMessage):
            return state._replace(plate=arrays[0])
        return state

    def write(self, state: RendererState, message: wire.Message) -> None:
        header, (pixels, *_) = message
        if self._album and state.picture is not None and state.adaptation is not None and isinstance(header, wire.ImageMessage):
            self._album.add(state.picture, pixels, header.stamp, state.adaptation)

    def finish(self) -> None:
        if self._album:
            self._album.write_contact_sheet()
            if self._video and self._album.count:
                self._album.write_video(self._video)
