"""Every second pixel each way of a G-buffer, on which weak lights are summed live, and how much of that each pixel takes.

A weak light's shadows are soft: what surfaces receive of it changes little from pixel to pixel, but at the surfaces' own edges.
"""

import moderngl
import numpy as np

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import TEXTURES, GBuffer, PixelRays, VisibleSurfaces, visible_surfaces

STEP = 2  # pixels from one to the next
MATERIALS = ("coarse_diffuse", "coarse_specular")
SHARED = ("surface_depth", "surface_normals")  # textures by which weights are found


def coarse_size(size: tuple[int, int]) -> tuple[int, int]:
    """How many coarse pixels there are across and down."""
    return -(-size[0] // STEP), -(-size[1] // STEP)


class CoarseSurfaces:
    """The textures of coarse pixels, and weights: (height, width) of the whole picture, four of 8 bits, of the coarse pixels about each."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int]) -> None:
        self._context = context
        self._take = programs.program("screen.vert", "coarse_surfaces.frag", STEP=STEP)
        self._weigh = programs.program("screen.vert", "coarse_weights.frag", STEP=STEP)
        self._arrays = [context.vertex_array(program, []) for program in (self._take, self._weigh)]
        self.size = coarse_size(size)
        self._targets = {name: context.texture(self.size, record.components, dtype=dtype) for name, (record, dtype) in TEXTURES.items()}
        self.weights = context.texture(size, 4, dtype="f1")
        for texture in (*self._targets.values(), self.weights):
            texture.filter = moderngl.NEAREST, moderngl.NEAREST
        self._frame = context.framebuffer(list(self._targets.values()))
        self._weights_frame = context.framebuffer([self.weights])
        self._rays = PixelRays(np.eye(3), np.zeros(3))

    def take(self, g_buffer: GBuffer) -> None:
        """Takes the surfaces that were drawn last."""
        whole = g_buffer.rays
        # The middle of coarse pixel x is that of pixel STEP x.
        middles = np.array([[STEP, 0, 0.5 - 0.5 * STEP], [0, STEP, 0.5 - 0.5 * STEP], [0, 0, 1]])
        self._rays = whole._replace(ray_from_pixel=whole.ray_from_pixel @ middles)
        self._context.enable_only(moderngl.NOTHING)
        g_buffer.bind(self._take)
        self._frame.use()
        self._arrays[0].render(moderngl.TRIANGLES, vertices=3)
        unit = g_buffer.bind(self._weigh)
        for k, name in enumerate(SHARED):
            self._targets[name].use(unit + k)
            self._weigh[name.replace("surface", "coarse")] = unit + k
        self._weights_frame.use()
        self._arrays[1].render(moderngl.TRIANGLES, vertices=3)

    def bind(self, program: moderngl.Program) -> int:
        """As GBuffer.bind."""
        if "eye" in program:
            program["eye"] = tuple(self._rays.eye.tolist())
        if "ray_from_pixel" in program:
            program["ray_from_pixel"] = tuple(self._rays.ray_from_pixel.T.reshape(-1))
        for unit, (name, target) in enumerate(self._targets.items()):
            if name in program:
                target.use(unit)
                program[name] = unit
        return len(self._targets)

    def bind_beside(self, program: moderngl.Program, unit: int) -> int:
        """Gives a program that draws all pixels weights and materials from a unit on; returns the first that is still free."""
        textures = {"coarse_weights": self.weights} | {name: self._targets[name.replace("coarse", "surface")] for name in MATERIALS}
        for k, (name, texture) in enumerate(textures.items(), unit):
            if name in program:
                texture.use(k)
                program[name] = k
        return unit + len(textures)

    def read_weights(self) -> np.ndarray:
        """Of each pixel (height, width, 4) uint8, of 255, those of the coarse pixels about it: at its right and above, as `bind_beside`."""
        width, height = self.weights.size
        return np.frombuffer(self.weights.read(alignment=1), np.uint8).reshape(height, width, 4)

    def read_surfaces(self) -> VisibleSurfaces:
        """As GBuffer.read_surfaces."""
        return visible_surfaces(self._targets["surface_depth"], self._targets["surface_normals"], self._rays)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for resource in (*self._arrays, self._frame, self._weights_frame, self.weights, *self._targets.values()):
            resource.release()
