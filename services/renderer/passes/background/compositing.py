"""What lies behind a picture: drawn where surfaces leave it open, dimmed where catchers take light from it."""

import moderngl

from vemlight.renderer.gl.programs import Programs


class Backdrop:
    """A texture behind pictures of `size` pixels (width, height), drawn by a fragment shader that includes behind.glsl."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int], fragment: str) -> None:
        self._context, self._size = context, size
        self._program = programs.program("screen.vert", fragment)
        self._array = context.vertex_array(self._program, [])
        self._texture: moderngl.Texture | None = None

    def _held(self, size: tuple[int, int], dtype: str, internal_format: int | None = None) -> moderngl.Texture:
        """The texture for what is shown next, of three numbers a texel; made anew when another size or format is wanted."""
        if self._texture is None or (self._texture.size, self._texture.dtype) != (size, dtype):
            if self._texture:
                self._texture.release()
            self._texture = self._context.texture(size, 3, alignment=1, dtype=dtype, internal_format=internal_format)
        return self._texture

    def _fill(self, frame: moderngl.Framebuffer, cover: moderngl.Texture | None, texture: moderngl.Texture) -> None:
        """Fills what the picture in `frame` leaves open and, where something is drawn, makes its alpha 1.

        cover: what catchers take, as in shading.py.
        """
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
        if self._texture:
            self._texture.release()
