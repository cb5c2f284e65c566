"""Weak lights live: summed on coarse pixels with what surfaces send to each other, and brought from there to all pixels.

Strong lights, whose shadows have edges, are summed on all pixels. Of weak ones a coarse pixel has irradiance, what lobes reflect, and how
much of that is visible; a quarter of the pixels takes a quarter of the time, whatever the number of lights.
"""

from typing import TYPE_CHECKING

import moderngl
import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.renderer.gl.constants import GLOSSY_KINDS, MaterialKind
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.coarse_surfaces import STEP, CoarseSurfaces
from vemlight.renderer.passes.lights.visibility_layers import VisibilityLayers
from vemlight.renderer.passes.shadow_maps.light_frames import LightFrames
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import Batch

if TYPE_CHECKING:
    from vemlight.renderer.passes.bounce.bounce import BounceLight

LEAST_BY_NORMAL = 0.25  # of the mean over all normals: where the harmonics say nothing or less there is light from somewhere
# Of each harmonic, by Ramamoorthi and Hanrahan (2001): the clamped cosine's part of its order times its own constant squared.
HARMONICS = np.array([3.141593 * 0.282095**2, *(2.094395 * 0.488603**2,) * 3, *(0.785398 * 1.092548**2,) * 2, 0.785398 * 0.315392**2,
                      0.785398 * 1.092548**2, 0.785398 * 0.546274**2])  # fmt: skip


def light_by_normal(directions: np.ndarray, irradiance: np.ndarray) -> np.ndarray:
    """The coefficients (9,) float64 of unshadowed_by_normal in weak_lights.glsl: of lights' directions (n, 3) and irradiance (n, 3)."""
    x, y, z = directions.T.astype(np.float64)
    terms = np.stack([np.ones_like(x), y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y])
    return HARMONICS * (terms @ luminance_from_rgb(irradiance.astype(np.float64)))


class WeakLights:
    """Sums weak lights for pictures of a scene with these `kinds` of material, on coarse pixels of `surfaces`."""

    def __init__(self, context: moderngl.Context, programs: Programs, kinds: set[MaterialKind], surfaces: CoarseSurfaces) -> None:
        self._context, self._surfaces, self._kinds = context, surfaces, sorted(kinds)
        self._glossy = bool(kinds & GLOSSY_KINDS)
        constants = {"CACHED_VISIBILITY": 1, "COARSE": 1, "WEAK": 0, "STEP": STEP}
        of_kinds = (programs.program("screen.vert", "shade.frag", KIND=int(kind), **constants) for kind in self._kinds)
        self._arrays = [context.vertex_array(program, []) for program in of_kinds]
        self._textures = {"coarse_light": context.texture(surfaces.size, 4, dtype="f4")}
        if self._glossy:
            self._textures["coarse_lobes"] = context.texture(surfaces.size, 4, dtype="f4")
            self._textures["coarse_unshadowed"] = context.texture(surfaces.size, 1, dtype="f4")
        for texture in self._textures.values():
            texture.filter = moderngl.NEAREST, moderngl.NEAREST
        self._frame = context.framebuffer(list(self._textures.values()))
        self._light_frame = context.framebuffer([self._textures["coarse_light"]])
        received = [self._textures[name] for name in ("coarse_light", "coarse_lobes") if name in self._textures]
        self._bounce_frame = context.framebuffer(received)
        self._coefficients = np.zeros(9)

    def add(self, frames: LightFrames, layers: VisibilityLayers, batch: Batch) -> None:
        """Sums a batch of lights whose layers are traced."""
        lights = batch.of(batch.every)
        self._coefficients = light_by_normal(lights["direction"], lights["irradiance"] * lights["concentration"][:, None])
        self._frame.use()
        self._frame.clear()
        self._context.enable_only(moderngl.NOTHING)
        for kind, array in zip(self._kinds, self._arrays, strict=True):
            program = array.program
            layers.bind(program, self._surfaces.bind(program))
            frames.bind_row(batch.every)
            program["light_count"] = batch.every.count
            self._set_by_normal(program)
            (self._frame if kind in GLOSSY_KINDS else self._light_frame).use()
            array.render(moderngl.TRIANGLES, vertices=3)

    def _set_by_normal(self, program: moderngl.Program) -> None:
        program["by_normal"] = tuple(self._coefficients.tolist())
        program["least_by_normal"] = max(LEAST_BY_NORMAL * float(self._coefficients[0]), 1e-6)

    def add_bounce(self, bounce: "BounceLight") -> None:
        """Adds what surfaces send to each other, as gathered last, but to shadow catchers."""
        self._set_by_normal(bounce.coarse_program)
        bounce.add_coarse(self._surfaces, self._bounce_frame, STEP)

    def bind(self, program: moderngl.Program, unit: int) -> None:
        """Gives a program that draws all pixels what coarse pixels have received, on texture units from one on."""
        self._set_by_normal(program)
        for k, (name, texture) in enumerate({"coarse_weights": self._surfaces.weights, **self._textures}.items(), unit):
            if name in program:
                texture.use(k)
                program[name] = k

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        frames = (self._frame, self._light_frame, self._bounce_frame)
        for resource in (*self._arrays, *frames, *self._textures.values()):
            resource.release()
