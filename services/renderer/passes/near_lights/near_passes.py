"""The passes of near lights; what they need on the GPU is made when the first near light comes."""

from typing import TYPE_CHECKING

import moderngl

from vemlight.renderer.gl.constants import MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.lights.shading import Shading
from vemlight.renderer.passes.luminaires.occluders import SceneOccluders
from vemlight.renderer.passes.near_lights.near_light_maps import NearLightMaps
from vemlight.renderer.passes.near_lights.near_light_plan import NearBatch, NearLayers, restoring_near_batches
from vemlight.renderer.passes.near_lights.near_lights import NearLights
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import ShadowSetup
from vemlight.renderer.scene.materials import Colour
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose

if TYPE_CHECKING:
    from vemlight.renderer.passes.lights.coarse_pictures import CoarsePictures
    from vemlight.renderer.passes.lights.traced_visibility import TracedVisibility


class NearPasses:
    """For a scene, its `kinds` of material, and pictures of `size` pixels (width, height). rays: that trace shadows; None: maps of them."""

    def __init__(
        self,
        context: moderngl.Context,
        programs: Programs,
        scene: Scene,
        kinds: frozenset[MaterialKind],
        size: tuple[int, int],
        shadows: ShadowSetup,
        shading: Shading,
        occluders: SceneOccluders,
        rays: "TracedVisibility | None",
        coarse: "CoarsePictures | None",
    ) -> None:
        self._context, self._programs, self._scene, self._kinds, self._size = context, programs, scene, kinds, size
        self._shadows, self._shading, self._occluders, self._rays, self._coarse = shadows, shading, occluders, rays, coarse
        self._lights: NearLights | None = None
        self._maps: NearLightMaps | None = None

    @property
    def made(self) -> bool:
        """Whether there is anything of them on the GPU."""
        return self._lights is not None

    def trace(self, batch: NearBatch, sample: int, samples: int, whole: bool) -> None:
        """Has rays find what arrives of the lights of a batch, as NearLights.trace has it."""
        assert self._rays
        self._near().trace(self._rays, batch, sample, samples, whole, self._coarse)

    def draw_maps(self, batch: NearBatch, pose: ScenePose) -> None:
        """Draws the maps of the lights of a batch, of a scene that stands so."""
        self._near()
        assert self._maps
        self._maps.draw(batch, pose)

    def restore(self, layers: NearLayers, pose: ScenePose | None) -> None:
        """Traces, or draws, again what a state describes as cached."""
        for batch in restoring_near_batches(layers):
            if self._rays:
                self.trace(batch, 0, 1, whole=False)
            elif pose:
                self.draw_maps(batch, pose)

    def add(self, g_buffer: GBuffer, batch: NearBatch, weight: float, first: bool, clear: bool) -> None:
        """Adds a batch, times `weight`, to the picture. first: whether it is the first of its sample. clear: and of the picture."""
        near = self._near()
        if near.matte and clear:
            near.matte.clear()
        near.add(g_buffer, batch, weight, first)

    def add_matte(self, unshadowed: Colour) -> None:
        """Brings what near lights give to catchers into the matte; as NearMatte.apply has it."""
        matte = self._near().matte
        assert matte
        matte.apply(unshadowed)

    def _near(self) -> NearLights:
        if self._lights is None:
            if not self._rays:
                resolutions = self._shadows.resolutions
                fixed = None if resolutions.by_power else resolutions.largest
                self._maps = NearLightMaps(self._context, self._programs, self._scene, self._occluders, fixed)
            regions = len(self._shadows.regions.centres)
            self._lights = NearLights(self._context, self._programs, set(self._kinds), self._size, regions, self._shading, self._maps)
        return self._lights

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for part in (self._lights, self._maps):
            if part is not None:
                part.release()
