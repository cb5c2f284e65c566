"""The fraction of each light that reaches each pixel, cached while the surfaces stand still and the light reads the same shadow map.

A lookup in a shadow map takes twice the time of all else that a light does to a pixel, and most lights move less than a texel a frame. So
what was looked up in a map is stored, one layer of 8 bits a pixel, until the map is drawn anew. The steps of 1/255 show only within
shadow edges: 6e-6 of the radiance under 72 lights. Whether that pays in a frame, and which lookups a frame lacks, its plan says.
"""

import moderngl

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import Batch
from vemlight.renderer.passes.shadow_maps.shadow_maps import ShadowAtlas


class VisibilityCache:
    """Layers of lookups for pictures of `size` pixels (width, height) whose surfaces are where `depth` is below 1."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int], depth: moderngl.Texture) -> None:
        self._context, self._size = context, size
        self._program = programs.program("screen.vert", "visibility_cache.frag")
        self._array = context.vertex_array(self._program, [])
        self._frame = context.framebuffer([], depth)
        self._layers: moderngl.TextureArray | None = None

    def look_up(self, g_buffer: GBuffer, atlas: ShadowAtlas, batch: Batch) -> None:
        """Looks up what is not cached yet of a batch whose maps are drawn."""
        self._make_room(max(batch.slots, 1))
        assert self._layers is not None
        if batch.unknown.count == 0:
            return
        unit = g_buffer.bind(self._program)
        atlas.bind(self._program, unit)
        atlas.bind_row(batch.unknown)
        self._layers.bind_to_image(0, read=False, write=True)
        self._program["cached_visibility"] = 0
        self._program["light_count"] = batch.unknown.count
        self._program["depth"] = 1.0
        self._frame.use()
        self._frame.depth_mask = False
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = ">"
        self._array.render(moderngl.TRIANGLES, vertices=3)
        self._context.memory_barrier()

    def bind(self, program: moderngl.Program, unit: int) -> None:
        """Gives a program the layers on a texture unit."""
        assert self._layers is not None
        self._layers.use(unit)
        program["cached_visibility"] = unit

    def _make_room(self, layers: int) -> None:
        """A layer for each slot; where there were fewer, the slots were replaced and nothing that was cached is read again."""
        if self._layers is not None and self._layers.layers >= layers:
            return
        if self._layers is not None:
            self._layers.release()
        self._layers = self._context.texture_array((*self._size, layers), 1, dtype="f1")
        self._layers.filter = (moderngl.NEAREST, moderngl.NEAREST)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for resource in (self._array, self._frame, self._layers):
            if resource is not None:
                resource.release()
