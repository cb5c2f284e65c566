"""Which share of each light reaches each pixel, kept from frame to frame while the surfaces stand still and the light keeps its map.

A lookup in a shadow map takes twice the time of all else that a light does to a pixel, and most lights move less than a texel a frame. So
what was looked up in a map is stored, one layer of 8 bits a pixel, until the map is drawn anew. The steps of 1/255 show only within
shadow edges: 6e-6 of the radiance under 72 lights.
"""

import moderngl

from vemlight.renderer.frame_budget import WORTH
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import Surfaces
from vemlight.renderer.passes.shadow_maps.shadow_maps import MAX_LIGHTS, Batch, ShadowAtlas

MOST_BYTES = 2**29  # on the GPU: 256 maps at 1920 x 1080; beyond that lights are looked up in the sum itself


class Kept:
    """Layers of lookups for pictures of `size` pixels (width, height) whose surfaces are where `depth` is below 1."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int], depth: moderngl.Texture) -> None:
        self._context, self._size = context, size
        self._program = programs.program("screen.vert", "lookups.frag", MAX_LIGHTS=str(MAX_LIGHTS))
        self._array = context.vertex_array(self._program, [])
        self._frame = context.framebuffer([], depth)
        self._layers: moderngl.TextureArray | None = None

    def look(self, surfaces: Surfaces, atlas: ShadowAtlas, batch: Batch) -> bool:
        """Looks up what is not known yet of a batch whose maps are drawn; False, and nothing done, where that does not pay."""
        unknown, layers = batch.unknown.count, max(atlas.layers, 1)
        if batch.maps.count > WORTH * batch.every.count or layers * self._size[0] * self._size[1] > MOST_BYTES:
            return False
        if self._layers is None or self._layers.layers < layers:
            self._make(layers)
        assert self._layers is not None
        if unknown:
            unit = surfaces.bind(self._program)
            atlas.bind(self._program, unit)
            atlas.bind_row(batch.unknown)
            self._layers.bind_to_image(0, read=False, write=True)
            self._program["kept"] = 0
            self._program["light_count"] = unknown
            self._program["depth"] = 1.0
            self._frame.use()
            self._frame.depth_mask = False
            self._context.enable_only(moderngl.DEPTH_TEST)
            self._context.depth_func = ">"
            self._array.render(moderngl.TRIANGLES, vertices=3)
            self._context.memory_barrier()
            atlas.looked_up(batch)
        return True

    def bind(self, program: moderngl.Program, unit: int) -> None:
        """Gives a program the layers on a texture unit."""
        assert self._layers is not None
        self._layers.use(unit)
        program["kept"] = unit

    def _make(self, layers: int) -> None:
        if self._layers is not None:
            self._layers.release()
        self._layers = self._context.texture_array((*self._size, layers), 1, dtype="f1")
        self._layers.filter = (moderngl.NEAREST, moderngl.NEAREST)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for thing in (self._array, self._frame, self._layers):
            if thing is not None:
                thing.release()
