"""The shadow maps of many lights in one depth texture, a grid of tiles, drawn by instancing: one draw call for a batch of lights."""

import math
from typing import NamedTuple

import moderngl
import numpy as np

from services.lights import Lights
from services.renderer.geometry import Drawable, Span
from services.renderer.programs import Programs

MAX_LIGHTS = 512  # of a batch: 48 kB of a uniform block; GL drivers in use allow 64 kB
FRAME_BYTES = 96  # LightFrame in light.glsl
MAX_ATLAS_SIDE = 8192  # texels; 256 MB of depth at 4 bytes, and no GL 4.3 driver refuses it
BOXES = ("box_centre", "box_half")


class Batch(NamedTuple):
    """Lights that fit the atlas together; rows: (n, 8) float32 as light.glsl reads them."""

    rows: np.ndarray

    @property
    def count(self) -> int:
        return len(self.rows)


class ShadowAtlas:
    """One depth texture with a tile of `tile_size` texels a side for each light of a batch."""

    def __init__(self, context: moderngl.Context, programs: Programs, drawable: Drawable, vertices: moderngl.Buffer,
                 indices: moderngl.Buffer, tile_size: int) -> None:
        self._context, self._drawable = context, drawable
        self.tile_size = tile_size
        side = min(MAX_ATLAS_SIDE, context.info["GL_MAX_TEXTURE_SIZE"])
        self._most_columns = max(side // tile_size, 1)
        self.capacity = min(self._most_columns**2, MAX_LIGHTS)
        self._program = programs.program("shadow.vert", "shadow.frag", MAX_LIGHTS=str(MAX_LIGHTS))
        self._frames_program = programs.compute("frames.comp")
        for name in BOXES:
            self._frames_program[name] = [tuple(row) for row in getattr(drawable, name).tolist()]
        self._vao = context.vertex_array(self._program, [(vertices, "3f 12x", "position")], indices, index_element_size=4)
        self._given = context.buffer(reserve=MAX_LIGHTS * 32, dynamic=True)
        self.buffer = context.buffer(reserve=MAX_LIGHTS * FRAME_BYTES)
        self.columns = 0
        self.texture: moderngl.Texture | None = None
        self._frame: moderngl.Framebuffer | None = None

    def batches(self, lights: Lights) -> list[Batch]:
        """The lights that carry power, cut into runs that fit the atlas; lights above the floor come first in each."""
        lit = np.flatnonzero(np.any(lights.irradiance != 0, axis=1))
        return [self._batch(lights, lit[first : first + self.capacity]) for first in range(0, len(lit), self.capacity)]

    def _batch(self, lights: Lights, chosen: np.ndarray) -> Batch:
        below = lights.directions[chosen] @ self._drawable.floor_normal < 0
        order = np.argsort(below, kind="stable")
        rows = np.zeros((len(chosen), 8), np.float32)
        rows[:, 0:3] = lights.directions[chosen[order]]
        rows[:, 3] = np.arange(len(chosen))
        rows[:, 4:7] = lights.irradiance[chosen[order]]
        rows[:, 7] = below[order]
        return Batch(rows)

    def draw(self, batch: Batch) -> None:
        """Uploads the batch and draws its maps."""
        self._fit(batch.count)
        assert self._frame is not None
        self._given.write(batch.rows.tobytes())
        self._given.bind_to_storage_buffer(1)
        self.buffer.bind_to_storage_buffer(2)
        self.describe(self._frames_program)
        self._frames_program["light_count"] = batch.count
        self._frames_program.run(group_x=(batch.count + 63) // 64)
        self._context.memory_barrier()
        self.buffer.bind_to_uniform_block(0)
        self.describe(self._program)
        self._frame.use()
        self._frame.clear(depth=1.0)
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        above = int(np.count_nonzero(batch.rows[:, 7] == 0))
        self._instances(self._drawable.closed, 0, batch.count)
        self._context.disable(moderngl.CULL_FACE)
        self._instances(self._drawable.open, 0, batch.count)
        self._instances(self._drawable.floor, above, batch.count - above)

    def _instances(self, span: Span, first_light: int, count: int) -> None:
        if span.count and count:
            self._program["first_light"] = first_light
            self._vao.render(vertices=span.count, first=span.first, instances=count)

    def describe(self, program: moderngl.Program | moderngl.ComputeShader) -> None:
        """Sets the uniforms of light.glsl in a program."""
        program["tile_size"] = float(self.tile_size)
        program["tile_columns"] = float(self.columns)

    def _fit(self, count: int) -> None:
        """Grows the texture to hold `count` tiles; it never shrinks."""
        if self.texture is not None and self.columns**2 >= count:
            return
        self._free()
        self.columns = min(math.ceil(math.sqrt(count)), self._most_columns)
        side = self.columns * self.tile_size
        self.texture = self._context.depth_texture((side, side))
        self.texture.compare_func = ""  # the shader compares: each of the four texels against its own depth
        self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.texture.repeat_x = self.texture.repeat_y = False
        self._frame = self._context.framebuffer(depth_attachment=self.texture)

    def _free(self) -> None:
        for thing in (self._frame, self.texture):
            if thing is not None:
                thing.release()

    def release(self) -> None:
        """Frees what the atlas holds on the GPU."""
        self._free()
        for thing in (self._vao, self._given, self.buffer):
            thing.release()
