"""The shadow maps of one luminaire: a depth texture with a tile for each of its views."""

import math

import moderngl
import numpy as np

from vemlight.renderer.gl.buffers import CASTER_VERTEX, SHADOW_VIEW
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.luminaire.shadow_views import ShadowViews
from vemlight.renderer.passes.luminaires.occluders import SceneOccluders
from vemlight.renderer.passes.shadow_maps.alpha_test import AlphaTestedMeshes
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.vertex_buffers import draw_ranges

MAX_ATLAS_SIDE = 8192  # texels; no GL 4.3 driver refuses it; any value in 4096..16384 does
GL_CLIP_DISTANCE0 = 0x3000
CLIP_PLANES = 4  # the sides of a tile


class LuminaireAtlas:
    """Shadow maps of `count` views with `resolution` texels on a side, drawn in one call."""

    def __init__(
        self, context: moderngl.Context, programs: Programs, occluders: SceneOccluders, scene: Scene, count: int, resolution: int
    ) -> None:
        self._context, self._count = context, count
        self._alpha_tested = AlphaTestedMeshes(context, programs, scene, "luminaire_map.vert", MAX_MAPS=count)
        side = min(MAX_ATLAS_SIDE, context.info["GL_MAX_TEXTURE_SIZE"])
        self._columns = math.ceil(math.sqrt(count))
        self._resolution = min(resolution, side // self._columns)
        self._program = programs.program("luminaire_map.vert", "shadow.frag", ALPHA_TEST=0, MAX_MAPS=count)
        layout = CASTER_VERTEX.content(occluders.positions, self._program)
        self._vao = context.vertex_array(self._program, [layout], occluders.indices, index_element_size=4)
        self._buffer = context.buffer(reserve=SHADOW_VIEW.dtype.itemsize * count, dynamic=True)
        self._texture = context.depth_texture((self._columns * self._resolution, self._columns * self._resolution))
        self._texture.compare_func = ""
        self._texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._framebuffer = context.framebuffer(depth_attachment=self._texture)
        self._inverse_depths = (0.0, 0.0)

    def draw(self, views: ShadowViews, local_from_world: np.ndarray, occluders: SceneOccluders) -> None:
        """Draws the maps of all views anew."""
        self._inverse_depths = (1 / views.near_m, 1 / views.far_m)
        self._buffer.write(views.views.tobytes())
        self._buffer.bind_to_uniform_block(0)
        self._set_uniforms(self._program)
        self._framebuffer.use()
        self._framebuffer.clear(depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "<"
        for plane in range(CLIP_PLANES):
            self._context.enable_direct(GL_CLIP_DISTANCE0 + plane)
        for draw_range in draw_ranges(occluders.mesh_ranges, occluders.pose.matrices):
            self._program["local_from_rest"] = tuple((local_from_world @ draw_range.world_from_rest).T.reshape(-1))
            if draw_range.indices.count:
                self._vao.render(vertices=draw_range.indices.count, first=draw_range.indices.first, instances=self._count)
        if self._alpha_tested.program:
            self._set_uniforms(self._alpha_tested.program)
            self._alpha_tested.draw("local_from_rest", local_from_world, occluders.pose.matrices, self._count)
        for plane in range(CLIP_PLANES):
            self._context.disable_direct(GL_CLIP_DISTANCE0 + plane)

    def bind(self, program: moderngl.Program, unit: int) -> None:
        """Gives a program the maps, in texture unit `unit`."""
        self._buffer.bind_to_uniform_block(0)
        self._texture.use(unit)
        program["shadow_maps"] = unit
        self._set_uniforms(program)

    def _set_uniforms(self, program: moderngl.Program) -> None:
        values = (("map_size", float(self._resolution)), ("map_columns", float(self._columns)), ("inverse_depths", self._inverse_depths))
        for name, value in values:
            if name in program:
                program[name] = value

    def release(self) -> None:
        """Frees what the maps hold on the GPU."""
        for resource in (self._vao, self._framebuffer, self._texture, self._buffer, self._alpha_tested):
            resource.release()
