"""Weak lights on coarse pixels: their surfaces, rays and sums, live in large pictures."""

from typing import TYPE_CHECKING

import moderngl

from vemlight.renderer.gl.constants import MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.coarse_surfaces import CoarseSurfaces, coarse_size
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.lights.visibility_layers import VisibilityLayers
from vemlight.renderer.passes.lights.weak_lights import WeakLights
from vemlight.renderer.scene.scene import Scene

if TYPE_CHECKING:
    from vemlight.renderer.passes.lights.traced_visibility import TracedVisibility


class CoarsePictures:
    """What sums weak lights on coarse pixels, for pictures of `size` pixels. beside: what traces on all pixels."""

    def __init__(
        self,
        context: moderngl.Context,
        programs: Programs,
        scene: Scene,
        size: tuple[int, int],
        kinds: set[MaterialKind],
        beside: "TracedVisibility",
    ) -> None:
        self.surfaces = CoarseSurfaces(context, programs, size)
        self.layers = VisibilityLayers(context, coarse_size(size))
        self.rays = beside.coarse(scene, coarse_size(size), self.layers)
        self.lights = WeakLights(context, programs, kinds, self.surfaces)

    def take(self, g_buffer: GBuffer) -> None:
        """Takes the surfaces that were drawn last."""
        self.surfaces.take(g_buffer)
        self.rays.see(self.surfaces)

    def release(self) -> None:
        """Frees what this holds."""
        for part in (self.rays, self.layers, self.lights, self.surfaces):
            part.release()
