"""The shadow maps of many lights in one depth texture, each at its own resolution, drawn by instancing: a call for each resolution."""

import moderngl
import numpy as np

from vemlight.renderer.gl.buffers import CASTER_VERTEX
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.shadow_maps.alpha_test import AlphaTestedMeshes
from vemlight.renderer.passes.shadow_maps.casters import Casters, PlacedCasters
from vemlight.renderer.passes.shadow_maps.light_frames import LightFrames
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import Batch
from vemlight.renderer.passes.shadow_maps.shadow_map_resolution import Packing
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.vertex_buffers import DrawRange

CLIPPING = (0x864F, *range(0x3000, 0x3004))  # GL_DEPTH_CLAMP, GL_CLIP_DISTANCE0 to 3, for which moderngl has no name


class ShadowAtlas:
    """One depth texture with a tile for each map of a batch, of its resolution."""

    def __init__(self, context: moderngl.Context, programs: Programs, scene: Scene, casters: Casters, frames: LightFrames) -> None:
        self._context, self._light_frames = context, frames
        # The receiver plane has a program of its own: it reaches beyond the box, and so beyond the tile and nearer to a light from below.
        self._programs = [programs.program("shadow.vert", "shadow.frag", ALPHA_TEST=0, RECEIVER_PLANE=own) for own in (0, 1)]
        self._alpha_tested = AlphaTestedMeshes(context, programs, scene, "shadow.vert", RECEIVER_PLANE=0)
        self._buffers = (context.buffer(casters.positions.tobytes()), context.buffer(casters.indices.tobytes() or bytes(4)))
        self._arrays = [
            context.vertex_array(program, [CASTER_VERTEX.content(self._buffers[0], program)], self._buffers[1], index_element_size=4)
            for program in self._programs
        ]
        self._packing = Packing(np.zeros((0, 2), np.int64), 0, 0)
        self.texture: moderngl.Texture | None = None
        self._frame: moderngl.Framebuffer | None = None

    def draw(self, batch: Batch, placed: PlacedCasters) -> None:
        """Makes the batch's light frames and draws the maps that it redraws, of casters that stand so."""
        self._fit(batch.packing)
        assert self._frame is not None
        self._light_frames.make(batch, placed)
        self._frame.use()
        self._clear(batch)
        if batch.redrawn.count == 0:
            return
        self._light_frames.bind_row(batch.redrawn)
        self._context.depth_func = "<"
        for draw in batch.draws:
            level = placed.levels[draw.level]
            self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
            self._instances(0, level.closed, draw.first, draw.count)
            self._context.disable(moderngl.CULL_FACE)
            self._instances(0, level.open, draw.first, draw.count)
            self._draw_alpha_tested(draw.first, draw.count, placed)
            for flag in CLIPPING:
                self._context.enable_direct(flag)
            self._instances(1, placed.receiver_plane, draw.first + draw.count - draw.from_below, draw.from_below)
            for flag in CLIPPING:
                self._context.disable_direct(flag)

    def _clear(self, batch: Batch) -> None:
        """Empties the tiles whose maps are redrawn."""
        assert self._frame is not None
        if batch.clears_atlas:
            self._frame.clear(depth=1.0)
            return
        redrawn = batch.of(batch.redrawn)
        for (x, y), size in zip(redrawn["corner"].astype(int).tolist(), redrawn["resolution"].astype(int).tolist(), strict=True):
            self._frame.clear(depth=1.0, viewport=(x, y, size, size))

    def bind(self, program: moderngl.Program, unit: int) -> None:
        """Gives a program the atlas on a texture unit and the uniforms of lights.glsl."""
        assert self.texture is not None
        self.texture.use(unit)
        program["atlas"] = unit
        self._set_texel(program)

    def _instances(self, program_number: int, draw_ranges: tuple[DrawRange, ...], first_light: int, count: int) -> None:
        program = self._programs[program_number]
        self._set_texel(program)
        for draw_range in draw_ranges if count else ():
            program["first_light"] = first_light
            program["world_from_rest"] = tuple(draw_range.world_from_rest.T.reshape(-1))
            if draw_range.indices.count:
                self._arrays[program_number].render(vertices=draw_range.indices.count, first=draw_range.indices.first, instances=count)

    def _draw_alpha_tested(self, first_light: int, count: int, placed: PlacedCasters) -> None:
        if self._alpha_tested.program:
            self._set_texel(self._alpha_tested.program)
            self._alpha_tested.program["first_light"] = first_light
            self._alpha_tested.draw("world_from_rest", np.eye(4), placed.matrices, count)

    def _set_texel(self, program: moderngl.Program) -> None:
        program["atlas_texel"] = (1 / self._packing.width, 1 / self._packing.height)

    def _fit(self, packing: Packing) -> None:
        """Makes the texture as large as the packing says: where maps lie, and so how they round, follows from the lights alone."""
        before, self._packing = self._packing, packing
        if self.texture is not None and (before.width, before.height) == (packing.width, packing.height):
            return
        self._free()
        self.texture = self._context.depth_texture((packing.width, packing.height))
        self.texture.compare_func = ""  # the shader compares: each of the four texels against its own depth
        self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.texture.repeat_x = self.texture.repeat_y = False
        self._frame = self._context.framebuffer(depth_attachment=self.texture)

    def _free(self) -> None:
        for resource in (self._frame, self.texture):
            if resource is not None:
                resource.release()
        self.texture = self._frame = None

    def release(self) -> None:
        """Frees what the atlas holds on the GPU."""
        self._free()
        for resource in (*self._arrays, *self._buffers, self._alpha_tested):
            resource.release()
