"""The fraction of each light that arrives at each pixel: layers of 8 bits, which shaders read by a light's `map`."""

import moderngl


class VisibilityLayers:
    """Layers for pictures of `size` pixels (width, height). texture: None before there is room."""

    def __init__(self, context: moderngl.Context, size: tuple[int, int]) -> None:
        self._context, self._size = context, size
        self.texture: moderngl.TextureArray | None = None

    def make_room(self, layers: int) -> moderngl.TextureArray:
        """At least so many layers; where there were fewer, the lights were laid out anew and nothing in them is read again."""
        if self.texture is None or self.texture.layers < layers:
            self.release()
            self.texture = self._context.texture_array((*self._size, layers), 1, dtype="f1")
            self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return self.texture

    def bind(self, program: moderngl.Program, unit: int) -> None:
        """Gives a program the layers on a texture unit."""
        assert self.texture is not None
        self.texture.use(unit)
        program["cached_visibility"] = unit

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        if self.texture is not None:
            self.texture.release()
        self.texture = None
