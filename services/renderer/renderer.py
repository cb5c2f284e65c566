"""Lit pictures: surfaces first, then for each visible pixel the sum over all lights with their shadow maps."""

import time
from collections.abc import Callable, Iterable
from functools import partial

import numpy as np

from vemlight import settings
from vemlight.errors import UserError
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage
from vemlight.renderer.accumulation import MapLights, spread_points
from vemlight.renderer.frame_budget import (
    CostModel,
    Spent,
    affordable_lights,
    affordable_maps,
    first_lights,
    halvings,
    learnt,
    least_ms,
    map_work,
    waited,
    with_weak,
)
from vemlight.renderer.gl.programs import Programs, check_context, context_info, headless_context
from vemlight.renderer.gl.timers import Timers
from vemlight.renderer.output.tonemap import Adaptation, tone_curve
from vemlight.renderer.passes.background.background import Background
from vemlight.renderer.passes.background.plate import Plate
from vemlight.renderer.passes.emission.emission import Emission
from vemlight.renderer.passes.gbuffer.gbuffer import Surfaces
from vemlight.renderer.passes.gloss.gloss import NO_CONE, Gloss
from vemlight.renderer.passes.lights.light_regions import EVERY_SIDE, light_regions
from vemlight.renderer.passes.lights.shading import Shading
from vemlight.renderer.passes.lights.visibility_cache import Kept
from vemlight.renderer.passes.luminaires.illumination import Illumination
from vemlight.renderer.passes.present.present import Screen
from vemlight.renderer.passes.shadow_maps.casters import scene_casters
from vemlight.renderer.passes.shadow_maps.shadow_map_resolution import COARSER, Sizing, sizing
from vemlight.renderer.passes.shadow_maps.shadow_maps import Batch, ShadowAtlas
from vemlight.renderer.scene.materials import GLOSSY_KINDS, Colour, ShadowCatcher, emits, material_kind
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose, scene_pose
from vemlight.renderer.scene.view import PixelSample, pixel_samples
from vemlight.runtime import wire
from vemlight.settings import Tone

NO_LIGHT = 1e-30  # irradiance in place of 0 where it divides
PASS_MAP = 256  # texels of each map of a pass, if by power: four and a half for a degree, a map's cell, which many of its lights may share
WARM_UP = 2  # frames: GL drivers compile on the first and tune on the second


class Renderer:
    """Draws one scene under any directional lights, headless.

    samples: places in each pixel at which it is drawn; the pixel is their mean, so 4 or more give the average over its area.
    Raises UserError when there is no GL 4.3 or the picture is larger than it allows.
    """

    def __init__(self, scene: Scene, settings: settings.Renderer, samples: int = 1) -> None:
        self._size = (settings.width, settings.height)
        self._context = headless_context()
        self.info = context_info(self._context)
        limit = self._context.info["GL_MAX_TEXTURE_SIZE"]
        if max(self._size) > limit:
            size = f"{self._size[0]} x {self._size[1]}"
            raise UserError(f"[renderer] width, height: {size} is beyond the {limit} pixels of this GL; make them smaller")
        self._scene = scene
        self._offsets = pixel_samples(samples)
        self._frame_ms = settings.frame_ms or 0.0
        self._sized = settings.shadow_map is None
        self._halved = 0  # steps by which maps are smaller than they should be, for want of time
        self._tone: Tone = settings.tone
        self._pace = CostModel()
        self._drawn_frames = 0
        self.drawn_lights = 0  # of the last picture
        self.map_texels = np.zeros(0, int)  # a side, of the map that each of its lights read
        self._moved = True  # the surfaces, since the last picture
        self._looked = False  # whether the last picture's lookups were kept
        self._done: Batch | None = None  # what the last picture drew within its target time
        self._rendered_s = self._after_ms = 0.0  # when the last picture was done, and how long until it was tone-mapped
        self._has_catcher = any(isinstance(mesh.material, ShadowCatcher) for mesh in scene.meshes)
        self._scene_pose = scene_pose(scene, 0.0)
        self._programs = Programs(self._context)
        self._timers = Timers(self._context)
        self._timers.on = self._frame_ms > 0
        self._build(sizing(settings.shadow_map), EVERY_SIDE if settings.light_regions is None else settings.light_regions)
        check_context(self._context)

    def _build(self, sizing: Sizing, regions: int) -> None:
        context = self._context
        found = light_regions(regions)
        self._atlas = ShadowAtlas(context, self._programs, self._scene, scene_casters(self._scene, sizing.sizes), found, sizing)
        self._atlas.place(self._scene_pose.matrices)
        self._surfaces = Surfaces(context, self._programs, self._scene, self._size)
        kinds = {material_kind(mesh.material) for mesh in self._scene.meshes}
        self._shading = Shading(context, self._programs, found, kinds, self._size)
        # Lookups are kept for one place in each pixel, and where they bring frames nearer to a target time.
        once = self._frame_ms > 0 and len(self._offsets) == 1
        self._kept = Kept(context, self._programs, self._size, self._shading.class_depth) if once else None
        self._gloss = Gloss(context, self._programs, kinds) if kinds & GLOSSY_KINDS else None
        self._illumination = Illumination(context, self._programs, self._scene, self._size)
        self._emission = Emission(context, self._programs) if any(emits(mesh.material) for mesh in self._scene.meshes) else None
        self._plate = Plate(context, self._programs, self._size)
        if self._scene.plate is not None:
            self._plate.show(self._scene.plate)
        self._background = Background(context, self._programs, self._size)
        self._screen = Screen(context, self._programs, self._size)

    def place(self, time_s: float, poses: Iterable[wire.Pose] = ()) -> tuple[wire.Pose, ...]:
        """Moves the scene, before the next picture, to where animations have brought it at a time and what `poses` names where they say.

        Returns where its objects and lamps stand now; what is not named stands where the scene file puts it.
        """
        now = scene_pose(self._scene, time_s, poses)
        with self._context:
            self._place(now)
        return now.objects

    def _place(self, now: ScenePose) -> None:
        self._illumination.place(now)
        if not np.array_equal(now.matrices, self._scene_pose.matrices):
            self._atlas.place(now.matrices)
            self._surfaces.place(now)
            self._moved = True
        self._scene_pose = now

    def render(self, lights: LightSet, weak: LightSet | None = None) -> np.ndarray:
        """The picture under `lights`, (height, width, 4) float32, linear, row 0 on top.

        RGB is radiance times alpha (the average over the pixel's area), alpha the share of the area where rays meet a surface; a catcher
        is black with the share of light that shadows take from it as alpha. A plate or a background lies behind all, and alpha is 1 there.
        weak: a second, larger set that stands for the same light, for the lobes of glossy surfaces; none: `lights` do that too.
        With a target frame time, fewer shadow maps and then fewer lights are drawn where time is short; without, all of them.
        """
        self.draw(lights, weak)
        return self.picture()

    def draw(self, lights: LightSet, weak: LightSet | None = None) -> None:
        """As `render`, but the picture stays on the GPU, for `picture`, `selected` and `tone_mapped`."""
        self.drawn_lights = len(lights.ids)
        in_time = self._render_in_time if self._frame_ms else partial(self._render_all, offsets=self._offsets)
        self._whole(lambda: in_time(lights, weak or LightSet.none()))

    def render_pass(self, light: MapLights, number: int) -> np.ndarray:
        """As `render`, a pass of accumulation.py: at one place in each pixel, all lights and whole maps whatever the time."""
        (offset,) = [PixelSample(x, y, number) for x, y in spread_points(number, 1).tolist()]
        catcher = self._catcher_irradiance(light.cells()) if self._has_catcher else None  # of all passes together

        def draw() -> None:
            self._render_all(light.of_pass(number), LightSet.none(), [offset], catcher, PASS_MAP if self._sized else None)

        self._whole(draw)
        return self.picture()

    def _whole(self, draw: Callable[[], None]) -> None:
        """A picture: `draw` adds what lights there are."""
        began_s = time.perf_counter()
        with self._context:  # another renderer of this process may have made its own the current one
            self._timers.begin()
            self._done = None
            with self._timers.measured("luminaire maps"):
                self._illumination.draw_maps()
            self._shading.clear()
            draw()
            with self._timers.measured("backdrop"):
                self._plate.draw(self._shading.frame, self._shading.cover)
                self._background.draw(self._shading.frame, self._shading.cover, self._scene.camera)
            check_context(self._context)
            self._rendered_s = time.perf_counter()
            if self._done:
                self._learn(self._done, (self._rendered_s - began_s) * 1e3)

    def picture(self) -> np.ndarray:
        """The picture drawn last, as `render` gives it."""
        with self._context, self._timers.measured("read-back"):
            data = self._shading.frame.read(components=4, dtype="f4", alignment=1)
        return np.frombuffer(data, np.float32).reshape(self._size[1], self._size[0], 4)

    def selected(self) -> np.ndarray:
        """The pixels of the picture drawn last that `tonemap.subsampled` chooses, (h, w, 4) float32."""
        with self._context, self._timers.measured("read-back"):
            return self._screen.selected(self._shading.picture)

    def show(self, picture: np.ndarray) -> None:
        """Makes (height, width, 4) float32 the picture that `tone_mapped` sees."""
        with self._context:
            self._shading.picture.write(np.ascontiguousarray(picture, np.float32).tobytes(), alignment=1)

    def time_passes(self) -> None:
        """From the next picture on `timings_ms` tells what each pass costs; this takes some time itself."""
        self._timers.on = True

    @property
    def timings_ms(self) -> dict[str, float]:
        """What each pass of the last picture cost the GPU, by name; without a target frame time empty before `time_passes`."""
        with self._context:
            return self._timers.read_ms()

    @property
    def affordable_lights(self) -> int | None:
        """How many lights fit the target frame time; None without a target and until the first frames have told."""
        return affordable_lights(self._pace, self._frame_ms, self._moved) if self._frame_ms else None

    @property
    def least_ms(self) -> float:
        """What a picture with the fewest lights takes; 0 without a target frame time and until the first frames have told."""
        return least_ms(self._pace, self._moved)

    def _render_all(
        self, lights: LightSet, weak: LightSet, offsets: list[PixelSample], catcher: Colour | None = None, texels: int | None = None
    ) -> None:
        """Draws all maps and sums all lights, at `offsets` in each pixel; `catcher`: see Shading.add, None: as these lights give it.

        texels: as in ShadowAtlas.batches.
        """
        weight, unshadowed = 1 / len(offsets), catcher or self._catcher_irradiance(lights)
        for number, batch in enumerate(self._atlas.batches(lights, texels)):
            self._draw_maps(batch)
            if number == 0:
                self._gather(weak, batch)
            for offset in offsets:
                self._see(offset, weight if number == 0 else 0.0, unshadowed)
                self._add(batch, weight, unshadowed, first=number == 0)

    def _see(self, offset: PixelSample, alpha: float, unshadowed: Colour) -> None:
        """Draws the surfaces at `offset` in each pixel, and what the luminaires add to them times `alpha`."""
        with self._timers.measured("surfaces"):
            drawn = self._surfaces.draw(offset)
        if drawn:
            with self._timers.measured("classes"):
                self._shading.classify(self._surfaces)
        if alpha > 0:
            if self._emission:
                with self._timers.measured("emission"):
                    self._emission.add(self._surfaces, self._shading.frame, alpha)
            with self._timers.measured("luminaires"):
                self._illumination.add(self._surfaces, self._shading.frame, (alpha, alpha, alpha))
                if self._shading.cover_frame:  # a lamp brightens what lies behind by its share of the light there
                    red, green, blue = (-alpha / value if value > NO_LIGHT else 0.0 for value in unshadowed)
                    self._illumination.add(self._surfaces, self._shading.cover_frame, (red, green, blue), catchers=True)

    def _draw_maps(self, batch: Batch) -> None:
        self.map_texels = batch.texels
        with self._timers.measured("shadow maps"):
            self._atlas.draw(batch)

    def _gather(self, weak: LightSet, batch: Batch) -> None:
        if self._gloss:
            with self._timers.measured("weak lights"):
                self._gloss.gather(weak, batch)

    def _add(self, batch: Batch, weight: float, unshadowed: Colour, first: bool = True, kept: Kept | None = None) -> None:
        """Sums the lights of a batch, times `weight`, on what `_see` has drawn; with a picture's first batch alpha and the weak lights."""
        cone = self._gloss.cone if self._gloss else NO_CONE
        with self._timers.measured("lights"):
            self._shading.add(self._surfaces, self._atlas, batch, weight, weight if first else 0.0, unshadowed, cone, kept)
        if self._gloss and first:
            with self._timers.measured("weak lights"):
                self._gloss.add(self._surfaces, self._atlas, batch, self._shading.frame, weight)

    def _render_in_time(self, lights: LightSet, weak: LightSet) -> None:
        """Draws what fits the target frame time."""
        self._pace = with_weak(self._pace, self._frame_ms, self._moved)
        weak = weak if self._pace.weak else LightSet.none()
        chosen = first_lights(lights, self.affordable_lights or len(lights.ids))
        self.drawn_lights = len(chosen.ids)
        if (halved := halvings(self._pace, self._halved, COARSER)) != self._halved:
            self._halved, self._pace = halved, self._pace._replace(backlog=1.0)
        if self._moved:
            self._atlas.forget_lookups()
        affordable = partial(affordable_maps, self._pace, self._frame_ms, len(chosen.ids), self._moved)
        batch = self._atlas.cached_batch(chosen, self._halved, affordable)
        if batch is None:
            self._render_all(chosen, weak, self._offsets)
            return
        self._draw_maps(batch)
        self._gather(weak, batch)
        weight, unshadowed, self._looked = 1 / len(self._offsets), self._catcher_irradiance(chosen), False
        for offset in self._offsets:
            self._see(offset, weight, unshadowed)
            if self._kept and not self._moved:
                with self._timers.measured("lookups"):
                    self._looked = self._kept.look(self._surfaces, self._atlas, batch)
            self._add(batch, weight, unshadowed, kept=self._kept if self._looked else None)
        self._moved, self._done = False, batch

    def _learn(self, batch: Batch, frame_ms: float) -> None:
        """Learns what a frame costs from the last one."""
        self._drawn_frames += 1
        if self._drawn_frames <= WARM_UP:
            return
        spent = self._timers.read_ms()
        lookups = batch.unknown.count if self._looked else None
        lights_ms, maps_ms, lookups_ms = (spent.get(name, 0.0) for name in ("lights", "shadow maps", "lookups"))
        weak_ms = spent.get("weak lights", 0.0) if self._pace.weak else None
        done = Spent(frame_ms + self._after_ms, batch.work, maps_ms, lookups, lookups_ms, batch.every.count, lights_ms, weak_ms)
        self._pace = waited(learnt(self._pace, done), map_work(batch.texels), batch.off, batch.off_work, batch.work)

    def _catcher_irradiance(self, lights: LightSet) -> Colour:
        """The irradiance that the lights give to the scene's catcher where no shadow falls, above 0 in each channel."""
        normal = self._scene.shadow_catcher_normal(self._scene_pose.matrices)
        if normal is None:
            return (1.0, 1.0, 1.0)
        red, green, blue = np.maximum(np.maximum(lights.directions @ normal, 0) @ lights.irradiance, NO_LIGHT).tolist()
        return (red, green, blue)

    def show_plate(self, pixels: np.ndarray, stops: float = 0.0) -> None:
        """Puts a picture behind the pictures that follow, stretched over them: (h, w, 3) uint8, sRGB, row 0 on top, `stops` brighter."""
        with self._context:
            self._plate.show(pixels, stops)

    def show_background(self, radiance: np.ndarray, coverage: Coverage) -> None:
        """Puts a polar map (rows, cols, 3) float32, laid out as in sphere.py, behind the pictures that follow; a plate hides it.

        nan and negative values are black. Below a hemisphere's horizon the picture stays open.
        """
        with self._context:
            self._background.show(radiance, coverage)

    def tone_mapped(self, adaptation: Adaptation, exposure_stops: float) -> np.ndarray:
        """The picture that `render` made last, for a screen: (height, width, 4) uint8, as `tonemap.tone_mapped` gives it."""
        curve = tone_curve(adaptation, exposure_stops, self._tone)
        with self._context:
            with self._timers.measured("tone mapping"):
                self._screen.map(self._shading.picture, curve)
            with self._timers.measured("read-back"):
                pixels = self._screen.mapped()
        self._after_ms = min((time.perf_counter() - self._rendered_s) * 1e3, self._frame_ms)
        return pixels

    def release(self) -> None:
        """Frees everything on the GPU and the context."""
        with self._context:
            lit = (self._atlas, self._surfaces, self._shading, self._kept, self._gloss, self._illumination, self._emission)
            for part in (*lit, self._plate, self._background, self._screen, self._programs):
                if part is not None:
                    part.release()
        self._context.release()
