"""Near lights, added to a picture after the directional ones: one sum over those of a batch for each surface."""

from typing import TYPE_CHECKING

import moderngl
import numpy as np

from vemlight.renderer.gl.buffers import NEAR_LIGHT
from vemlight.renderer.gl.constants import CLASSES, MATERIAL_KINDS, NEAR_BATCH, MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.coarse_surfaces import STEP
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.lights.shading import Shading
from vemlight.renderer.passes.lights.visibility_layers import VisibilityLayers
from vemlight.renderer.passes.near_lights.near_light_maps import NearLightMaps
from vemlight.renderer.passes.near_lights.near_light_plan import NearBatch, near_of
from vemlight.renderer.passes.near_lights.near_matte import NearMatte

if TYPE_CHECKING:
    from vemlight.renderer.passes.lights.coarse_pictures import CoarsePictures
    from vemlight.renderer.passes.lights.traced_visibility import TracedVisibility


class NearLights:
    """Sums near lights for pictures of `size` pixels (width, height) of surfaces of the `kinds` of material, in so many light regions."""

    def __init__(
        self,
        context: moderngl.Context,
        programs: Programs,
        kinds: set[MaterialKind],
        size: tuple[int, int],
        regions: int,
        shading: Shading,
        maps: NearLightMaps | None,
    ) -> None:
        """maps: of their shadows; None: those are traced."""
        self._context, self._regions, self._size = context, regions, size
        self._layers = VisibilityLayers(context, size)
        self._maps = maps
        self._buffer = context.buffer(reserve=NEAR_BATCH * NEAR_LIGHT.dtype.itemsize, dynamic=True)
        self._shading = shading
        self.matte = NearMatte(context, programs, shading, size) if MaterialKind.SHADOW_CATCHER in kinds else None
        self._arrays = {}
        for kind in sorted(kinds):
            program = programs.program("screen.vert", "near_lights.frag", KIND=int(kind), TRACED=int(maps is None))
            self._arrays[kind] = context.vertex_array(program, [])

    def trace(
        self, rays: "TracedVisibility", batch: NearBatch, sample: int, samples: int, whole: bool, coarse: "CoarsePictures | None" = None
    ) -> None:
        """Has rays find what arrives of those lights of a batch that are traced, from a sample of each pixel's `samples`. coarse: what
        traces those that are traced on coarse pixels."""
        texture = self._layers.make_room(max(batch.slots, 1))
        on_coarse, on_all = batch.traced[batch.coarse[batch.traced]], batch.traced[~batch.coarse[batch.traced]]
        for light, arriving in zip(on_all.tolist(), rays.near(near_of(batch.lights, on_all), sample, samples, whole), strict=True):
            self._write(texture, int(batch.layers[light]), arriving)
        if len(on_coarse):
            from vemlight.renderer.rays.near_tracing import spread  # here, since most pictures do without this kernel

            assert coarse
            weights = coarse.surfaces.read_weights()
            made = coarse.rays.near(near_of(batch.lights, on_coarse), sample, samples, whole)
            for light, arriving in zip(on_coarse.tolist(), made, strict=True):
                self._write(texture, int(batch.layers[light]), spread(arriving, weights, STEP))

    def _write(self, texture: moderngl.TextureArray, layer: int, arriving: np.ndarray) -> None:
        texture.write(arriving.data, viewport=(0, 0, layer, *self._size, 1), alignment=1)

    def add(self, g_buffer: GBuffer, batch: NearBatch, weight: float, first: bool) -> None:
        """Adds a batch's light, times `weight`, to the picture and to the sums of catchers. first: whether it is the first batch."""
        entries = np.zeros(NEAR_BATCH, NEAR_LIGHT.dtype)
        for name, values in (("at", batch.lights.at), ("intensity", batch.lights.intensity), ("radius", batch.lights.radius)):
            entries[name][: len(values)] = values
        entries["layer"][: len(batch.layers)] = batch.layers
        self._buffer.write(entries.tobytes())
        self._buffer.bind_to_uniform_block(0)
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        self._context.depth_func = "=="
        for kind, array in self._arrays.items():
            program = array.program
            (self.matte.frame if self.matte and kind == MaterialKind.SHADOW_CATCHER else self._shading.frame).use()
            (self._maps or self._layers).bind(program, g_buffer.bind(program))
            program["weight"], program["light_count"] = weight, len(batch.layers)
            if "part" in program:
                program["part"] = weight if first else 0.0
            for region in range(self._regions):
                program["depth"] = (MATERIAL_KINDS * region + kind + 0.5) / CLASSES
                array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for resource in (*self._arrays.values(), self._buffer, self._layers, self.matte):
            if resource is not None:
                resource.release()
