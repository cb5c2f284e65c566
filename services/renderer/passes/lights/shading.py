"""The sum over the lights for each visible pixel, one class of pixels after the other.

A class is a light region and a kind of material. The classes are written as depths, and each is drawn with a depth test for that
value, so that all pixels of a draw call walk the same row of lights: no pixel waits for lights that only its neighbour sees.
"""

import itertools
from typing import TYPE_CHECKING

import moderngl
import numpy as np

from vemlight.renderer.gl.constants import CLASSES, GLOSSY_KINDS, MATERIAL_KINDS, MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.coarse_surfaces import STEP
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.lights.light_regions import CUBE_SIDE, Regions
from vemlight.renderer.passes.lights.visibility_layers import VisibilityLayers
from vemlight.renderer.passes.shadow_maps.light_frames import LightFrames
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import Batch
from vemlight.renderer.passes.shadow_maps.shadow_maps import ShadowAtlas
from vemlight.renderer.scene.materials import Colour

if TYPE_CHECKING:
    from vemlight.renderer.passes.lights.weak_lights import WeakLights


class Shading:
    """Sums lights into a picture of `size` pixels (width, height), linear RGBA, for surfaces of the `kinds` of material."""

    def __init__(
        self, context: moderngl.Context, programs: Programs, regions: Regions, kinds: set[MaterialKind], size: tuple[int, int]
    ) -> None:
        self._context, self._programs, self._kinds = context, programs, sorted(kinds)
        self._classify = programs.program("screen.vert", "classify.frag")
        self._classify_array = context.vertex_array(self._classify, [])
        self._arrays: dict[tuple[bool, bool], list[moderngl.VertexArray]] = {}  # with cached visibility, with weak lights; of each kind
        self._cube = context.texture_cube((CUBE_SIDE, CUBE_SIDE), 1, regions.cube.astype(np.float32).tobytes(), dtype="f4")
        self._cube.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.picture = context.texture(size, 4, dtype="f4")
        self.class_depth = context.depth_texture(size)
        self._classes = context.framebuffer([], self.class_depth)
        self.frame = context.framebuffer([self.picture], self.class_depth)
        self.matte: moderngl.Texture | None = None  # fraction of the light that shadows take from catchers, RGB, and alpha in luminance
        self.matte_frame: moderngl.Framebuffer | None = None
        self.catcher_frame: moderngl.Framebuffer | None = None
        self.lobe_visibility: moderngl.Texture | None = None  # what lobes reflect of the lights, with shadows and without
        self._lobe_frame: moderngl.Framebuffer | None = None
        self.glossy_frame: moderngl.Framebuffer | None = None
        if kinds & GLOSSY_KINDS:
            self.lobe_visibility = context.texture(size, 2, dtype="f4")
            self._lobe_frame = context.framebuffer([self.lobe_visibility])
            self.glossy_frame = context.framebuffer([self.picture, self.lobe_visibility], self.class_depth)
        if MaterialKind.SHADOW_CATCHER in kinds:
            self.matte = context.texture(size, 4, dtype="f4")
            self.matte_frame = context.framebuffer([self.matte])
            self.catcher_frame = context.framebuffer([self.picture, self.matte], self.class_depth)
        for frame in (self.frame, self.catcher_frame, self.glossy_frame):
            if frame:
                frame.depth_mask = False  # the classes stay while the surfaces do

    def classify(self, g_buffer: GBuffer) -> None:
        """Finds each pixel's class."""
        unit = g_buffer.bind(self._classify)
        self._cube.use(unit)
        self._classify["region_of_normal"] = unit
        self._classes.use()
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "1"
        self._classify_array.render(moderngl.TRIANGLES, vertices=3)

    def clear(self) -> None:
        """Empties the picture and the matte."""
        (self.catcher_frame or self.frame).clear()

    def add(
        self,
        g_buffer: GBuffer,
        frames: LightFrames,
        arriving: ShadowAtlas | VisibilityLayers,
        batch: Batch,
        weight: float,
        alpha: float,
        unshadowed: Colour,
        weak: "WeakLights | None" = None,
    ) -> None:
        """Adds a batch of lights times `weight`, and `alpha` to the pixels that `classify` found.

        arriving: what says how much of each light arrives, its map or a layer. unshadowed: the irradiance of a catcher without shadows, by
        all lights of all batches, above 0. weak: lights that coarse pixels have received already, which come with these.
        """
        if self._lobe_frame:
            self._lobe_frame.clear()
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        self._context.depth_func = "=="
        for kind, array in zip(self._kinds, self._programs_of(isinstance(arriving, VisibilityLayers), weak is not None), strict=True):
            program = array.program
            unit = g_buffer.bind(program)
            arriving.bind(program, unit)
            if weak:
                weak.bind(program, unit + 1)
            program["weight"] = weight
            self.frame.use()
            if kind == MaterialKind.SHADOW_CATCHER:
                program["unshadowed"], alpha = unshadowed, 0.0
                assert self.catcher_frame is not None
                self.catcher_frame.use()
            elif kind in GLOSSY_KINDS:
                assert self.glossy_frame is not None
                self.glossy_frame.use()
            if kind != MaterialKind.SHADOW_CATCHER:
                program["alpha"] = alpha
            for region, row in enumerate(batch.rows):
                if row.count or alpha > 0 or weak:
                    frames.bind_row(row)
                    program["light_count"] = row.count
                    program["depth"] = (MATERIAL_KINDS * region + kind + 0.5) / CLASSES
                    array.render(moderngl.TRIANGLES, vertices=3)

    def _programs_of(self, cached: bool, weak: bool) -> list[moderngl.VertexArray]:
        """The programs of all kinds of surface, compiled when they are first wanted."""
        if (cached, weak) not in self._arrays:
            fixed = {"CACHED_VISIBILITY": int(cached), "WEAK": int(weak), "COARSE": 0, "STEP": STEP}
            variants = ({"KIND": int(kind), **fixed} for kind in self._kinds)
            programs = [self._programs.program("screen.vert", "shade.frag", **variant) for variant in variants]
            self._arrays[cached, weak] = [self._context.vertex_array(program, []) for program in programs]
        return self._arrays[cached, weak]

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        pictures = (self._classes, self.frame, self.picture, self.class_depth, self.matte, self.matte_frame, self.catcher_frame)
        lobes = (self.lobe_visibility, self._lobe_frame, self.glossy_frame)
        for resource in (self._classify_array, *itertools.chain(*self._arrays.values()), self._cube, *pictures, *lobes):
            if resource is not None:
                resource.release()
