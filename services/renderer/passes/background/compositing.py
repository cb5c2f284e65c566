"""What lies behind a picture: it shows where surfaces leave the picture open, less what the matte of shadow catchers takes from it."""

import moderngl

from vemlight.renderer.gl.programs import Programs

NO_SURFACE = 1.0  # the depth of classify.frag there


class BackgroundLayer:
    """A texture behind pictures of `size` pixels (width, height), drawn by a fragment shader that includes compositing.glsl."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int], fragment: str) -> None:
        self._context, self._size = context, size
        self._program = programs.program("screen.vert", fragment)
        self._array = context.vertex_array(self._program, [])
        self._texture: moderngl.Texture | None = None

    def _texture_of(self, size: tuple[int, int], dtype: str, internal_format: int | None = None) -> moderngl.Texture:
        """The texture for the next image, of three numbers a texel; replaced when another size or format is wanted."""
        if self._texture is None or (self._texture.size, self._texture.dtype) != (size, dtype):
            if self._texture:
                self._texture.release()
            self._texture = self._context.texture(size, 3, alignment=1, dtype=dtype, internal_format=internal_format)
        return self._texture

    def _composite(self, frame: moderngl.Framebuffer, matte: moderngl.Texture | None, texture: moderngl.Texture, single: bool) -> None:
        """Adds the texture where the picture in `frame` is open and makes its alpha 1 there. matte: as in shading.py.

        single: whether a pixel without a matte is open only where `frame` has no class of surface.
        """
        texture.use(0)
        frame.use()
        self._context.enable_only(moderngl.BLEND | moderngl.DEPTH_TEST if single and not matte else moderngl.BLEND)
        self._context.depth_func = "=="
        self._program["depth"] = NO_SURFACE
        if matte:
            matte.use(1)
            self._program["matte"] = 1
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
