"""What glossy lobes reflect of the environment map, prefiltered, times the visibility of the lights in the lobe.

The visibility is the mean over the frame's lights, each weighted by what the lobe, widened by the light's spread, would reflect of it: the
pass over the lights sums both.
"""

import moderngl

from vemlight.light.reflected_light import ReflectedLight
from vemlight.renderer.gl.constants import GLOSSY_KINDS, MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.coarse_surfaces import STEP, CoarseSurfaces
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.gloss.lobe_albedo import SIZE, ggx_albedo
from vemlight.renderer.passes.gloss.prefiltered_map import PrefilteredMap

# Of gloss.frag and gloss_classes.frag: for which pixels a program is, and the depths of the classes.
PIXELS = {"ALL": 0, "COARSE": 1, "WITH_COARSE": 2}
NARROW, WIDE = 0.25, 0.5


class Gloss:
    """Adds the reflected map to surfaces of the `kinds` of material in a picture. coarse: wide lobes are looked up there alone."""

    def __init__(
        self,
        context: moderngl.Context,
        programs: Programs,
        kinds: set[MaterialKind],
        picture: moderngl.Texture,
        coarse: CoarseSurfaces | None = None,
    ) -> None:
        self._context, self._coarse = context, coarse
        constants: dict[str, int | str] = {f"HAS_{kind.name}": int(kind in kinds) for kind in GLOSSY_KINDS}
        constants |= {**PIXELS, "ALBEDO_SIZE": SIZE, "STEP": STEP, "GLOSS_NARROW": str(NARROW), "GLOSS_WIDE": str(WIDE)}

        def array(name: str, pixels: str) -> moderngl.VertexArray:
            return context.vertex_array(programs.program("screen.vert", name, PIXELS=PIXELS[pixels], **constants), [])

        self._all = array("gloss.frag", "ALL")
        self._classes = [array("gloss_classes.frag", "WITH_COARSE" if coarse else "ALL")]
        self._depths = [context.depth_texture(picture.size)]
        self._frames = [context.framebuffer([picture], self._depths[0])]
        self._coarse_gloss: moderngl.Texture | None = None
        if coarse:
            self._of_coarse, self._with_coarse = array("gloss.frag", "COARSE"), array("gloss.frag", "WITH_COARSE")
            self._classes.append(array("gloss_classes.frag", "COARSE"))
            self._coarse_gloss = context.texture(coarse.size, 4, dtype="f4")
            self._coarse_gloss.filter = moderngl.NEAREST, moderngl.NEAREST
            self._depths.append(context.depth_texture(coarse.size))
            self._frames.append(context.framebuffer([self._coarse_gloss], self._depths[1]))
        self._class_frames = [context.framebuffer([], depth) for depth in self._depths]
        for frame in self._frames:
            frame.depth_mask = False
        self._map, self._scale = PrefilteredMap(context, programs), (1.0, 1.0, 1.0)
        self._albedo: moderngl.Texture | None = None
        if MaterialKind.GGX in kinds:
            self._albedo = context.texture((SIZE, SIZE), 2, ggx_albedo().tobytes(), dtype="f4")
            self._albedo.filter = (moderngl.LINEAR, moderngl.LINEAR)

    def classify(self, g_buffer: GBuffer) -> None:
        """Finds which pixels reflect the map, and how; coarse surfaces were taken of the same."""
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "1"
        sources = (g_buffer, self._coarse) if self._coarse else (g_buffer,)
        for source, array, frame in zip(sources, self._classes, self._class_frames, strict=True):
            unit = source.bind(array.program)
            if self._coarse:
                self._coarse.bind_beside(array.program, unit)
            frame.use()
            array.render(moderngl.TRIANGLES, vertices=3)

    def prefilter(self, light: ReflectedLight) -> None:
        """Takes the map that lobes reflect; there must be one."""
        assert light.radiance is not None
        self._map.prefilter(light.radiance, light.coverage)
        self._scale = tuple(light.scale.tolist())

    def add_coarse(self) -> None:
        """Looks up what wide lobes on coarse pixels reflect."""
        assert self._coarse
        self._frames[1].clear()
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._draw(self._of_coarse, self._coarse.bind(self._of_coarse.program), 1, WIDE)

    def add(
        self,
        g_buffer: GBuffer,
        lobe_visibility: moderngl.Texture,
        weight: float,
        with_coarse: bool,
        mirrored_scene: moderngl.Texture | None = None,
    ) -> None:
        """Adds what the surfaces reflect of the map times `weight` to the picture. lobe_visibility: as in shading.py.

        with_coarse: wide lobes have what `add_coarse` looked up. mirrored_scene: of mirrors.py, which then says what of the map is seen.
        """
        self._context.enable_only(moderngl.DEPTH_TEST | moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        for array, which in ((self._all, NARROW), (self._with_coarse if with_coarse else self._all, WIDE)):
            program = array.program
            unit = g_buffer.bind(program)
            if with_coarse and self._coarse:
                unit = self._coarse.bind_beside(program, unit)
            lobe_visibility.use(unit)
            program["lobe_visibility"], program["weight"], program["scale"] = unit, weight, self._scale
            program["mirrors"], program["mirrored_scene"] = mirrored_scene is not None, unit + 1
            (mirrored_scene or lobe_visibility).use(unit + 1)
            self._draw(array, unit + 2, 0, which)

    def _draw(self, array: moderngl.VertexArray, unit: int, frame: int, which: float) -> None:
        """Draws the pixels of a class."""
        program = array.program
        textures = {"prefiltered": self._map.texture, "albedo": self._albedo, "coarse_gloss": self._coarse_gloss}
        for number, (name, texture) in enumerate(textures.items(), unit):
            if texture and name in program:
                texture.use(number)
                program[name] = number
        if "base_variance" in program:
            program["base_variance"] = self._map.base_variance
        program["depth"] = which
        self._context.depth_func = "=="
        self._frames[frame].use()
        array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        arrays = (self._all, *self._classes, *((self._of_coarse, self._with_coarse) if self._coarse else ()))
        textures = (self._map, self._albedo, self._coarse_gloss, *self._depths)
        for resource in (*arrays, *self._frames, *self._class_frames, *textures):
            if resource:
                resource.release()
