"""Near lights, added to a picture after the directional ones: one sum over those of a batch for each surface."""

from typing import TYPE_CHECKING

import moderngl
import numpy as np

from vemlight.renderer.gl.buffers import NEAR_LIGHT
from vemlight.renderer.gl.constants import CLASSES, MATERIAL_KINDS, NEAR_BATCH, MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.lights.shading import Shading
from vemlight.renderer.passes.lights.visibility_layers import VisibilityLayers
from vemlight.renderer.passes.near_lights.near_light_plan import NearBatch, near_of

if TYPE_CHECKING:
    from vemlight.renderer.passes.lights.traced_visibility import TracedVisibility


class NearLights:
    """Sums near lights for pictures of `size` pixels (width, height) of surfaces of the `kinds` of material, in so many light regions."""

    def __init__(
        self, context: moderngl.Context, programs: Programs, kinds: set[MaterialKind], size: tuple[int, int], regions: int
    ) -> None:
        self._context, self._regions = context, regions
        self._layers = VisibilityLayers(context, size)
        self._buffer = context.buffer(reserve=NEAR_BATCH * NEAR_LIGHT.dtype.itemsize, dynamic=True)
        self._arrays = {}
        for kind in sorted(kinds):
            program = programs.program("screen.vert", "near_lights.frag", KIND=int(kind))
            self._arrays[kind] = context.vertex_array(program, [])

    def trace(self, rays: "TracedVisibility", batch: NearBatch, sample: int, samples: int, whole: bool) -> None:
        """Has rays find what arrives of those lights of a batch that are traced, from a sample of each pixel's `samples`."""
        texture = self._layers.make_room(max(batch.slots, 1))
        rays.trace_near(texture, near_of(batch.lights, batch.traced), batch.layers[batch.traced], sample, samples, whole)

    def add(self, g_buffer: GBuffer, shading: Shading, batch: NearBatch, weight: float) -> None:
        """Adds a batch's light, times `weight`, to the picture."""
        entries = np.zeros(NEAR_BATCH, NEAR_LIGHT.dtype)
        for name, values in (("at", batch.lights.at), ("intensity", batch.lights.intensity), ("radius", batch.lights.radius)):
            entries[name][: len(values)] = values
        entries["layer"][: len(batch.layers)] = batch.layers
        self._buffer.write(entries.tobytes())
        self._buffer.bind_to_uniform_block(0)
        shading.frame.use()
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        self._context.depth_func = "=="
        for kind, array in self._arrays.items():
            if kind == MaterialKind.SHADOW_CATCHER:
                continue
            program = array.program
            self._layers.bind(program, g_buffer.bind(program))
            program["weight"], program["light_count"] = weight, len(batch.layers)
            for region in range(self._regions):
                program["depth"] = (MATERIAL_KINDS * region + kind + 0.5) / CLASSES
                array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for resource in (*self._arrays.values(), self._buffer, self._layers):
            resource.release()
