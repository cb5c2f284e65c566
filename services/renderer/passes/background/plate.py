"""Mixed reality: the picture of a real place behind the scene, on which shadow catchers leave the scene's shadows.

Differential rendering (Debevec 1998) in its form for a ground whose colour is unknown: where virtual objects take a fraction of the light
from a shadow catcher, the plate is darkened by that fraction, in each channel.
"""

import moderngl
import numpy as np

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.background.compositing import BackgroundLayer

SRGB8 = 0x8C41  # OpenGL's name of 8-bit texels that are made linear before they are filtered


class Plate(BackgroundLayer):
    """A picture behind a picture of `size` pixels (width, height), stretched over it."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int]) -> None:
        super().__init__(context, programs, size, "plate.frag")
        self._program["size"] = size
        self._shown: np.ndarray | None = None

    def show(self, pixels: np.ndarray, stops: float = 0.0) -> None:
        """Takes the plate's pixels (h, w, 3), row 0 on top: float16 radiance, or uint8 sRGB, `stops` brighter. Others are replaced."""
        self._program["gain"] = 2.0**stops
        if pixels is self._shown:
            return
        self._shown = pixels
        coded = pixels.dtype == np.uint8
        size = pixels.shape[1], pixels.shape[0]
        texture = self._texture_of(size, "f1" if coded else "f2", SRGB8 if coded else None)
        texture.repeat_x = texture.repeat_y = False
        texture.write(np.ascontiguousarray(pixels), alignment=1)
        if size[0] > self._size[0] or size[1] > self._size[1]:  # only then several of its pixels fall into one
            texture.build_mipmaps()
            texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        else:
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)

    def draw(self, frame: moderngl.Framebuffer, matte: moderngl.Texture | None) -> None:
        """Composites the plate behind the picture in `frame`. matte: as in shading.py. Does nothing before the first `show`."""
        if self._texture:
            self._composite(frame, matte, self._texture, single=False)
