"""Smooth edges live: how much of its neighbours' colours each pixel has, found sample by sample while view and surfaces stand still.

One sample a pixel is shaded. The others only say where surfaces are, and that stays: light may change at the cost of pixels on edges alone.
"""

import moderngl
import numpy as np

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer
from vemlight.renderer.passes.present.present import OFF_EDGE, ON_EDGE
from vemlight.renderer.rays.edge_samples import NEIGHBOURS, add_sample, nearest_neighbours, smooth
from vemlight.renderer.rays.tracing import RayTracer
from vemlight.renderer.scene.view import PixelSample

# Places in a pixel, four to each side of both axes: no two in a row or column (a rotated grid twice).
SAMPLES = (
    PixelSample(0.3125, 0.0625, 1), PixelSample(0.6875, 0.9375, 2), PixelSample(0.9375, 0.3125, 3), PixelSample(0.0625, 0.6875, 4),
    PixelSample(0.5625, 0.1875, 5), PixelSample(0.4375, 0.8125, 6), PixelSample(0.8125, 0.5625, 7), PixelSample(0.1875, 0.4375, 8),
)  # fmt: skip


class Edges:
    """For pictures of `size` pixels (width, height) whose surfaces a tracer has seen. depth: ON_EDGE or OFF_EDGE of each pixel."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int], tracer: RayTracer) -> None:
        self._context, self._tracer = context, tracer
        self._counts, self._samples = np.zeros((size[1], size[0], len(NEIGHBOURS)), np.uint8), 0
        self._program = programs.program("screen.vert", "edges.frag", ON_EDGE=str(ON_EDGE), OFF_EDGE=str(OFF_EDGE))
        self._array = context.vertex_array(self._program, [])
        self._parts = {name: context.texture(size, 4, dtype="f1") for name in ("edges_before", "edges_after")}
        for texture in self._parts.values():
            texture.filter = moderngl.NEAREST, moderngl.NEAREST
        self.depth = context.depth_texture(size)
        self._frame = context.framebuffer([], self.depth)
        self.forget()

    def forget(self) -> None:
        """No pixel has parts of others, until samples are added: the surfaces have moved."""
        self._counts[:], self._samples = 0, 0
        self._frame.clear(depth=OFF_EDGE)

    def add(self, g_buffer: GBuffer) -> None:
        """Adds the next of SAMPLES."""
        sample = SAMPLES[self._samples]
        self._samples += 1
        seen = self._tracer.surfaces_of(*g_buffer.read_beside(sample))
        middles, order = self._tracer.surfaces, nearest_neighbours(sample.x, sample.y)
        self._tracer.in_rows(lambda rows: add_sample(middles, seen, order, rows.start, rows.stop, self._counts))
        parts = (255.0 / self._samples * self._counts + 0.5).astype(np.uint8)
        for k, texture in enumerate(self._parts.values()):
            texture.write(np.ascontiguousarray(parts[..., 4 * k : 4 * k + 4]).data, alignment=1)
        self.bind(self._program, 0)
        self._frame.use()
        self._context.enable_only(moderngl.DEPTH_TEST)
        self._context.depth_func = "1"
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def bind(self, program: moderngl.Program, unit: int) -> None:
        """Gives a program the parts that pixels have of their neighbours, on texture units from one on."""
        for k, (name, texture) in enumerate(self._parts.items(), unit):
            texture.use(k)
            program[name] = k

    def smoothed(self, picture: np.ndarray) -> np.ndarray:
        """A picture (height, width, 4) float32 with smooth edges."""
        if self._samples == 0:
            return picture
        smooth(picture, self._counts, self._samples, made := np.empty_like(picture))
        return made

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for resource in (self._array, self._frame, self.depth, *self._parts.values()):
            resource.release()
