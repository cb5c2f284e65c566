"""What surfaces emit, added to a picture of what they reflect."""

import moderngl

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.gbuffer.gbuffer import GBuffer


class Emission:
    """Adds the radiance of surfaces that emit. It lights nothing else: a lamp in the scene is a luminaire."""

    def __init__(self, context: moderngl.Context, programs: Programs) -> None:
        self._context = context
        self._program = programs.program("screen.vert", "emission.frag")
        self._array = context.vertex_array(self._program, [])

    def add(self, g_buffer: GBuffer, frame: moderngl.Framebuffer, weight: float) -> None:
        """Adds `weight` times what the surfaces drawn last emit to the picture in `frame`."""
        g_buffer.bind(self._program)
        self._program["weight"] = weight
        frame.use()
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        self._array.release()
