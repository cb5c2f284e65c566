"""What lies behind a picture: drawn where surfaces leave it open, dimmed where catchers take light from it."""

from collections.abc import Mapping

import moderngl

from services.renderer.programs import Programs


class Backdrop:
    """Draws a fragment shader that includes behind.glsl behind pictures."""

    def __init__(self, context: moderngl.Context, programs: Programs, fragment: str) -> None:
        self._context = context
        self._program = programs.program("screen.vert", fragment)
        self._array = context.vertex_array(self._program, [])

    def draw(
        self, frame: moderngl.Framebuffer, cover: moderngl.Texture | None, texture: moderngl.Texture, uniforms: Mapping[str, object]
    ) -> None:
        """Fills what the picture in `frame` leaves open and, where something is drawn, makes its alpha 1.

        cover: what catchers take, as in shading.py. texture: in unit 0. uniforms: of the fragment shader, by name.
        """
        for name, value in uniforms.items():
            self._program[name] = value
        texture.use(0)
        frame.use()
        self._context.enable_only(moderngl.BLEND)
        if cover:
            cover.use(1)
            self._program["cover"] = 1
            self._program["difference"] = True
            self._context.blend_func = moderngl.ONE, moderngl.ONE
            self._array.render(moderngl.TRIANGLES, vertices=3)
        self._program["difference"] = False
        self._context.blend_func = moderngl.ONE_MINUS_DST_ALPHA, moderngl.ONE
        self._array.render(moderngl.TRIANGLES, vertices=3)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        self._array.release()
