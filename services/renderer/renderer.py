"""Draws frames on the GPU, headless, as their plans describe them. It owns only GPU resources: frame_plan.py decides what a frame is."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vemlight import settings
from vemlight.errors import UserError
from vemlight.light.extent import points_of_extents
from vemlight.light.light_set import LightSet
from vemlight.renderer import pass_table
from vemlight.renderer.accumulation import PASSES
from vemlight.renderer.frame import AccumulationPass, FramePlan, FrameState, PassRun, PlatePicture
from vemlight.renderer.frame_budget import FrameTimings
from vemlight.renderer.frame_plan import frame_setup
from vemlight.renderer.gl.programs import Programs, check_context, context_info, draws_on_processor, headless_context
from vemlight.renderer.gl.timers import Timers
from vemlight.renderer.interreflection import Interreflection
from vemlight.renderer.output.tonemap import Adaptation, adapt, tone_curve
from vemlight.renderer.passes.background.background import Background
from vemlight.renderer.passes.background.plate import Plate
from vemlight.renderer.passes.emission.emission import Emission
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.gloss.gloss import Gloss
from vemlight.renderer.passes.lights.coarse_pictures import CoarsePictures
from vemlight.renderer.passes.lights.shading import Shading
from vemlight.renderer.passes.lights.traced_lights import restoring_batches as retracing_batches
from vemlight.renderer.passes.lights.visibility_cache import VisibilityCache
from vemlight.renderer.passes.lights.visibility_layers import VisibilityLayers
from vemlight.renderer.passes.luminaires.illumination import Illumination
from vemlight.renderer.passes.near_lights.near_passes import NearPasses
from vemlight.renderer.passes.present.present import Present
from vemlight.renderer.passes.shadow_maps.light_frames import LightFrames
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import restoring_batches
from vemlight.renderer.passes.shadow_maps.shadow_maps import ShadowAtlas
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose, same_places
from vemlight.renderer.scene.view import PixelSample
from vemlight.renderer.shadows import chosen_shadows

if TYPE_CHECKING:
    from vemlight.renderer.passes.lights.traced_visibility import TracedVisibility


class DrawnFrame(NamedTuple):
    """A frame as its plan asked for it.

    picture: (height, width, 4) float32, linear, row 0 on top: RGB is radiance times alpha (the average over the pixel's area), alpha the
    fraction of the area where rays meet a surface; a catcher is black, with the fraction of light that shadows take from it as alpha. A
    plate or a background lies behind all, and alpha is 1 there. pixels: the same for a screen, (height, width, 4) uint8, as
    `tonemap.tone_mapped` gives it. adaptation: of an eye that has seen it.
    """

    picture: np.ndarray | None
    pixels: np.ndarray | None
    adaptation: Adaptation | None
    timings: FrameTimings


class Renderer:
    """The GPU resources of one scene.

    setup: what `frame_plan.plan` needs to know of it. samples: places in each pixel at which it is drawn; the pixel is their mean, so 4 or
    more give the average over its area. timed: measures each pass even without a target frame time; this takes some time itself.
    Raises UserError when there is no GL 4.3 or the picture is larger than it allows.
    """

    def __init__(self, scene: Scene, settings: settings.Renderer, samples: int = 1, timed: bool = False) -> None:
        self._context = context = headless_context()
        self.info = context_info(context)
        self.shadows = chosen_shadows(settings.shadows, settings.shadow_map, draws_on_processor(context))
        limit = context.info["GL_MAX_TEXTURE_SIZE"]
        if max(settings.width, settings.height) > limit:
            size = f"{settings.width} x {settings.height}"
            raise UserError(f"[renderer] width, height: {size} is beyond the {limit} pixels of this GL; make them smaller")
        traced = self.shadows == "rays"
        self.setup = setup = frame_setup(scene, settings, samples, limit, traced)
        self._timers = Timers(context, on=timed or setup.target_ms > 0)
        self._programs = programs = Programs(context)
        kinds, size = set(setup.kinds), setup.size
        self._frames = LightFrames(context, programs)
        self._layers = VisibilityLayers(context, size)
        self._rays = _traced_visibility(scene, size, self._layers) if traced else None
        self._atlas = None if traced else ShadowAtlas(context, programs, scene, setup.shadows.casters, self._frames)
        self._g_buffer = GBuffer(context, programs, scene, size)
        self._shading = Shading(context, programs, setup.shadows.regions, kinds, size)
        self._interreflection = Interreflection(context, programs, setup, self._rays, self._g_buffer, self._shading)
        self._coarse = CoarsePictures(context, programs, scene, size, kinds, self._rays) if setup.coarse and self._rays else None
        depth = self._shading.class_depth
        self._visibility_cache = VisibilityCache(context, programs, self._layers, depth) if setup.caches_visibility else None
        self._gloss = None
        if setup.glossy:
            self._gloss = Gloss(context, programs, kinds, self._shading.picture, self._coarse and self._coarse.surfaces)
        self._illumination = Illumination(context, programs, scene, size)
        self._emission = Emission(context, programs) if setup.emissive else None
        self._plate = Plate(context, programs, size)
        self._background = Background(context, programs, size)
        self._edges = self._rays.edges(context, programs) if self._rays and setup.edge_samples else None
        self._present = Present(context, programs, size, self._edges)
        occluders, rays = self._illumination.occluders, self._rays
        self._near = NearPasses(context, programs, scene, setup.kinds, size, setup.shadows, self._shading, occluders, rays, self._coarse)
        self._contents: FrameState | None = None  # the state that describes what is cached on the GPU
        self._pose = setup.rest
        self._run_pass = self._runners()
        check_context(context)

    def _runners(self) -> dict[pass_table.Pass, Callable[[FramePlan, PassRun], None]]:
        """What runs each pass of a plan."""
        return {
            pass_table.LUMINAIRE_MAPS: self._draw_luminaire_maps,
            pass_table.SHADOW_MAPS: self._draw_shadow_maps,
            pass_table.PREFILTER: self._prefilter,
            pass_table.G_BUFFER: self._draw_g_buffer,
            pass_table.CLASSES: self._classify,
            pass_table.EDGES: self._add_edge_sample,
            pass_table.EMISSION: self._add_emission,
            pass_table.LUMINAIRES: self._add_luminaires,
            pass_table.VISIBILITY_CACHE: self._look_up,
            pass_table.RAYS: self._trace,
            pass_table.LIGHTS: self._add_lights,
            pass_table.NEAR_RAYS: self._trace_near,
            pass_table.NEAR_MAPS: self._draw_near_maps,
            pass_table.NEAR_LIGHTS: self._add_near,
            pass_table.NEAR_MATTE: self._add_near_matte,
            pass_table.COARSE_SURFACES: self._take_coarse,
            pass_table.WEAK_RAYS: self._trace_weak,
            pass_table.WEAK_LIGHTS: self._sum_weak,
            pass_table.WEAK_BOUNCE: self._add_weak_bounce,
            pass_table.WEAK_GLOSS: self._look_up_wide_lobes,
            pass_table.MIRRORS: self._interreflection.add_mirrors,
            pass_table.GLOSS: self._add_gloss,
            pass_table.BOUNCE: self._interreflection.add_bounce,
            pass_table.COMPOSITING: self._composite,
            pass_table.UPLOAD: self._upload,
        }

    def warm(self, near: bool = False) -> None:
        """Compiles, or loads, what rays need, so that no first picture waits for it; before the first frame. near: for near lights, too."""
        if self._rays:
            self._rays.warm(near, len(self.setup.samples))
        self._interreflection.warm()

    def drawable(self, lights: LightSet) -> LightSet:
        """The lights as this renderer draws them: those with extent as they are by rays, as several points each by maps."""
        return lights if self.setup.traced else points_of_extents(lights)

    def draw(self, plan: FramePlan) -> DrawnFrame:
        """Draws a frame and returns what its plan asked for, and how long that took. `plan.after` describes what is then cached on the GPU.

        Raises UserError when the GPU runs out of memory, FatalError when its driver fails.
        """
        began_s = time.perf_counter()
        with self._context:  # another renderer of this process may have made its own the current one
            self._timers.begin()
            if self._contents is not plan.before:
                self._restore(plan.before)
            self._contents = None  # until the frame is drawn
            self._place(plan.shown.pose)
            self._shading.clear()
            for run in plan.passes:
                with self._timers.measured(run.row.timer):
                    self._run_pass[run.row](plan, run)
            check_context(self._context)
            self._contents = plan.after
            return self._outputs(plan, began_s)

    def _outputs(self, plan: FramePlan, began_s: float) -> DrawnFrame:
        """Brings the picture to where the plan wants it."""
        picture = pixels = None
        tone = plan.shown.tone
        adaptation = tone.adaptation if tone else None
        for row in plan.outputs:
            with self._timers.measured(row.timer):
                if row is pass_table.READ_BACK:
                    data = self._shading.frame.read(components=4, dtype="f4", alignment=1)
                    picture = np.frombuffer(data, np.float32).reshape(self.setup.size[1], self.setup.size[0], 4)
                    picture = self._edges.smoothed(picture) if self._edges else picture
                elif row is pass_table.ADAPTATION and tone:
                    adaptation = adapt(adaptation, self._present.subsampled(self._shading.picture), tone.dt_s or 0.0)
                elif row is pass_table.TONE_MAPPING and tone:
                    curve = tone_curve(adaptation or Adaptation(), tone.exposure_stops, self.setup.tone)
                    self._present.tone_map(self._shading.picture, curve, smooth=plan.uploaded is None)
        if tone:
            with self._timers.measured(pass_table.READ_BACK.timer):
                pixels = self._present.read()
        timers_ms = self._timers.read_ms()
        return DrawnFrame(picture, pixels, adaptation, FrameTimings((time.perf_counter() - began_s) * 1e3, timers_ms))

    def _restore(self, state: FrameState) -> None:
        """Draws again what a state describes as cached, since the last frame left another state."""
        if state.g_buffer:
            self._place(state.g_buffer.pose)
            self._see(state.g_buffer.sample)
            if self._coarse:
                self._coarse.take(self._g_buffer)
            self._find_classes()
            for _ in range(state.edge_samples):
                assert self._edges
                self._edges.add(self._g_buffer)
        for number, pose in enumerate(state.luminaire_maps):
            if pose:
                self._illumination.place(pose)
                self._illumination.draw_maps(number)
        for placed, batch in restoring_batches(self.setup.shadows, state.maps) if state.maps else ():
            assert self._atlas
            self._atlas.draw(batch, placed)
            if self._visibility_cache and batch.unknown.count:
                self._visibility_cache.look_up(self._g_buffer, self._atlas, self._frames, batch)
        for batch in retracing_batches(self.setup.shadows, state.layers) if state.layers else ():
            assert self._rays
            self._rays.trace(batch, 0, 1, whole=False)
        for batch in retracing_batches(self.setup.shadows, state.coarse_layers) if state.coarse_layers else ():
            assert self._coarse
            self._coarse.rays.trace(batch, 0, 1, whole=False)
        if state.near_layers:
            self._near.restore(state.near_layers, state.lookup_pose)

    def _place(self, pose: ScenePose) -> None:
        """Moves the surfaces and the luminaires there."""
        if not same_places(self._pose, pose):
            self._g_buffer.place(pose)
            if self._rays and not np.array_equal(self._pose.matrices, pose.matrices):
                self._rays.place(pose.matrices)
        self._illumination.place(pose)
        self._pose = pose

    def _draw_luminaire_maps(self, plan: FramePlan, _run: PassRun) -> None:
        for number, (before, after) in enumerate(zip(plan.before.luminaire_maps, plan.after.luminaire_maps, strict=True)):
            if after is not before:
                self._illumination.draw_maps(number)

    def _draw_shadow_maps(self, plan: FramePlan, run: PassRun) -> None:
        assert self._atlas
        self._atlas.draw(plan.batches[run.batch], plan.after.placed)

    def _prefilter(self, plan: FramePlan, _run: PassRun) -> None:
        assert self._gloss
        assert plan.reflected
        self._gloss.prefilter(plan.reflected)

    def _draw_g_buffer(self, plan: FramePlan, run: PassRun) -> None:
        self._see(plan.samples[run.sample])

    def _see(self, sample: PixelSample) -> None:
        """Draws the surfaces at a sample of each pixel, and lets the rays begin there."""
        self._g_buffer.draw(sample)
        if self._rays:
            self._rays.see(self._g_buffer)
        if self._edges:
            self._edges.forget()

    def _add_edge_sample(self, _plan: FramePlan, _run: PassRun) -> None:
        assert self._edges
        self._edges.add(self._g_buffer)

    def _classify(self, _plan: FramePlan, _run: PassRun) -> None:
        self._find_classes()

    def _find_classes(self) -> None:
        self._shading.classify(self._g_buffer)
        if self._gloss:
            self._gloss.classify(self._g_buffer)

    def _add_emission(self, plan: FramePlan, _run: PassRun) -> None:
        assert self._emission
        self._emission.add(self._g_buffer, self._shading.frame, 1 / len(plan.samples))

    def _add_luminaires(self, plan: FramePlan, _run: PassRun) -> None:
        weight = 1 / len(plan.samples)
        self._illumination.add(self._g_buffer, self._shading.frame, (weight, weight, weight))
        if self._shading.matte_frame:
            self._illumination.add(self._g_buffer, self._shading.matte_frame, plan.on_catchers, catchers=True)

    def _look_up(self, plan: FramePlan, run: PassRun) -> None:
        assert self._visibility_cache
        assert self._atlas
        self._visibility_cache.look_up(self._g_buffer, self._atlas, self._frames, plan.batches[run.batch])

    def _trace(self, plan: FramePlan, run: PassRun) -> None:
        assert self._rays
        self._frames.make(plan.batches[run.batch], plan.after.placed)
        self._rays.trace(plan.batches[run.batch], run.sample, len(plan.samples), whole=plan.after.layers is None)

    def _take_coarse(self, _plan: FramePlan, _run: PassRun) -> None:
        assert self._coarse
        self._coarse.take(self._g_buffer)

    def _trace_weak(self, plan: FramePlan, run: PassRun) -> None:
        assert self._coarse
        self._frames.make(plan.batches[run.batch], plan.after.placed)
        self._coarse.rays.trace(plan.batches[run.batch], 0, 1, whole=False)

    def _sum_weak(self, plan: FramePlan, run: PassRun) -> None:
        assert self._coarse
        self._coarse.lights.add(self._frames, self._coarse.layers, plan.batches[run.batch])

    def _add_weak_bounce(self, plan: FramePlan, _run: PassRun) -> None:
        assert self._coarse
        self._interreflection.add_weak_bounce(plan, self._coarse.lights)

    def _look_up_wide_lobes(self, _plan: FramePlan, _run: PassRun) -> None:
        assert self._gloss
        self._gloss.add_coarse()

    def _arriving(self, plan: FramePlan) -> "VisibilityLayers | ShadowAtlas":
        """What says how much of each light arrives at each pixel."""
        if self._atlas and not plan.runs(pass_table.VISIBILITY_CACHE):
            return self._atlas
        return self._layers

    def _add_lights(self, plan: FramePlan, run: PassRun) -> None:
        """Sums the lights of a batch on the surfaces; with the first batch also the pixels' alpha."""
        weight = 1 / len(plan.samples)
        self._shading.add(
            self._g_buffer,
            self._frames,
            self._arriving(plan),
            plan.batches[run.batch],
            weight,
            weight if run.batch == 0 else 0.0,
            plan.unshadowed,
            self._coarse.lights if self._coarse and plan.runs(pass_table.WEAK_LIGHTS) else None,
        )

    def _draw_near_maps(self, plan: FramePlan, run: PassRun) -> None:
        self._near.draw_maps(plan.near[run.batch], plan.shown.pose)

    def _trace_near(self, plan: FramePlan, run: PassRun) -> None:
        lights = plan.shown.lights
        sample, samples = (lights.number, PASSES) if isinstance(lights, AccumulationPass) else (run.sample, len(plan.samples))
        self._near.trace(plan.near[run.batch], sample, samples, whole=plan.after.near_layers is None)

    def _add_near(self, plan: FramePlan, run: PassRun) -> None:
        first = run.batch == 0
        self._near.add(self._g_buffer, plan.near[run.batch], 1 / len(plan.samples), first, clear=first and run.sample == 0)

    def _add_near_matte(self, plan: FramePlan, _run: PassRun) -> None:
        self._near.add_matte(plan.unshadowed)

    def _add_gloss(self, plan: FramePlan, _run: PassRun) -> None:
        assert self._gloss
        assert self._shading.lobe_visibility
        mirrored = self._interreflection.mirrored(plan)
        weight, with_coarse = 1 / len(plan.samples), plan.runs(pass_table.WEAK_GLOSS)
        self._gloss.add(self._g_buffer, self._shading.lobe_visibility, weight, with_coarse, mirrored)

    def _composite(self, plan: FramePlan, _run: PassRun) -> None:
        scene_plate = self.setup.scene.plate
        plate = plan.shown.plate or (PlatePicture(scene_plate) if scene_plate is not None else None)
        if plate:
            self._plate.show(plate.pixels, plate.stops)
            self._plate.draw(self._shading.frame, self._shading.matte)
        if plan.shown.background:
            self._background.show(plan.shown.background.radiance, plan.shown.background.coverage)
            self._background.draw(self._shading.frame, self._shading.matte, plan.shown.pose.camera, len(plan.samples) == 1)

    def _upload(self, plan: FramePlan, _run: PassRun) -> None:
        self._shading.picture.write(np.ascontiguousarray(plan.uploaded, np.float32).tobytes(), alignment=1)

    def release(self) -> None:
        """Frees everything on the GPU and the context."""
        with self._context:
            visibility = (
                self._frames,
                self._layers,
                self._interreflection,
                self._coarse,
                self._edges,
                self._rays,
                self._atlas,
                self._visibility_cache,
                self._near,
            )
            drawing = (*visibility, self._g_buffer, self._shading, self._gloss, self._illumination, self._emission)
            for part in (*drawing, self._plate, self._background, self._present, self._programs):
                if part is not None:
                    part.release()
        self._context.release()


def _traced_visibility(scene: Scene, size: tuple[int, int], layers: VisibilityLayers) -> "TracedVisibility":
    from vemlight.renderer.passes.lights.traced_visibility import TracedVisibility  # here, since it loads numba, which maps do without

    return TracedVisibility(scene, size, layers)
