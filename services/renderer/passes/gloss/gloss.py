"""What glossy lobes reflect of the environment map, prefiltered, times the visibility of the lights in the lobe.

The visibility is the mean over the frame's lights, each weighted by what the lobe, widened by the light's spread, would reflect of it: the
pass over the lights sums both.
"""

import moderngl

from vemlight.renderer.gl.constants import GLOSSY_KINDS, MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.gloss.lobe_albedo import SIZE, ggx_albedo
from vemlight.renderer.passes.gloss.prefiltered_map import PrefilteredMap
from vemlight.renderer.passes.gloss.reflected_light import ReflectedLight


class Gloss:
    """Adds the reflected map to surfaces of the `kinds` of material."""

    def __init__(self, context: moderngl.Context, programs: Programs, kinds: set[MaterialKind]) -> None:
        self._context = context
        has = {f"HAS_{kind.name}": int(kind in kinds) for kind in GLOSSY_KINDS}
        self._program = programs.program("screen.vert", "gloss.frag", ALBEDO_SIZE=SIZE, **has)
        self._array = context.vertex_array(self._program, [])
        self._map = PrefilteredMap(context, programs)
        self._albedo: moderngl.Texture | None = None
        if MaterialKind.GGX in kinds:
            self._albedo = context.texture((SIZE, SIZE), 2, ggx_albedo().tobytes(), dtype="f4")
            self._albedo.filter = (moderngl.LINEAR, moderngl.LINEAR)

    def prefilter(self, light: ReflectedLight) -> None:
        """Takes the map that lobes reflect; there must be one."""
        assert light.radiance is not None
        self._map.prefilter(light.radiance, light.coverage)
        self._program["scale"] = tuple(light.scale.tolist())
        self._program["base_variance"] = self._map.base_variance

    def add(self, g_buffer: GBuffer, lobe_visibility: moderngl.Texture, frame: moderngl.Framebuffer, weight: float) -> None:
        """Adds what the surfaces reflect of the map times `weight` to the picture in `frame`. lobe_visibility: as in shading.py."""
        unit = g_buffer.bind(self._program)
        textures = {"prefiltered": self._map.texture, "lobe_visibility": lobe_visibility, "albedo": self._albedo}
        for number, (name, texture) in enumerate(textures.items(), unit):
            if texture and name in self._program:
                texture.use(number)
                self._program[name] = number
        self._program["weight"] = weight
        frame.use()
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for resource in (self._array, self._map, self._albedo):
            if resource:
                resource.release()
