"""The fraction of each light that reaches each pixel, cached while the surfaces stand still and the light reads the same shadow map.

A lookup in a shadow map takes twice the time of all else that a light does to a pixel, and most lights move less than a texel a frame. So
what was looked up in a map is stored, one layer of 8 bits a pixel, until the map is drawn anew. The steps of 1/255 show only within
shadow edges: 6e-6 of the radiance under 72 lights. Whether that pays in a frame, and which lookups a frame lacks, its plan says.
"""

import moderngl

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.lights.visibility_layers import VisibilityLayers
from vemlight.renderer.passes.shadow_maps.light_frames import LightFrames
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import Batch
from vemlight.renderer.passes.shadow_maps.shadow_maps import ShadowAtlas


class VisibilityCache:
    """Looks maps up into layers, for surfaces where `depth` is below 1."""

    def __init__(self, context: moderngl.Context, programs: Programs, layers: VisibilityLayers, depth: moderngl.Texture) -> None:
        self._context, self._layers = context, layers
        self._program = programs.program("screen.vert", "visibility_cache.frag")
        self._array = context.vertex_array(self._program, [])
        self._frame = context.framebuffer([], depth)

    def look_up(self, g_buffer: GBuffer, atlas: ShadowAtlas, frames: LightFrames, batch: Batch) -> None:
        """Looks up what is not cached yet of a batch whose maps are drawn."""
        texture = self._layers.make_room(max(batch.slots, 1))
        if batch.unknown.count == 0:
            return
        unit = g_buffer.bind(self._program)
        atlas.bind(self._program, unit)
        frames.bind_row(batch.unknown)
        texture.bind_to_image(0, read=False, write=True)
        self._program["cached_visibility"] = 0
        self._program["light_count"] = batch.unknown.count
        self._program["depth"] = 1.0
        self._frame.use()
        self._frame.depth_mask = False
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = ">"
        self._array.render(moderngl.TRIANGLES, vertices=3)
        self._context.memory_barrier()

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for resource in (self._array, self._frame):
            resource.release()
