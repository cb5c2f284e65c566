"""Mixed reality: the picture of a real place behind the scene, on which catchers leave the scene's shadows.

Differential rendering (Debevec 1998) in its form for a ground whose colour is unknown: where virtual objects take a share of the light from
a catcher, the plate is darkened by that share, in each channel.
"""

import moderngl
import numpy as np

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.background.compositing import Backdrop

SRGB8 = 0x8C41  # OpenGL's name of 8-bit texels that are taken to linear light before they are filtered


class Plate(Backdrop):
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
        texture = self._held(size, "f1" if coded else "f2", SRGB8 if coded else None)
        texture.repeat_x = texture.repeat_y = False
        texture.write(np.ascontiguousarray(pixels), alignment=1)
        if size[0] > self._size[0] or size[1] > self._size[1]:  # only then several of its pixels fall into one
            texture.build_mipmaps()
            texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
        else:
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)

    def draw(self, frame: moderngl.Framebuffer, cover: moderngl.Texture | None) -> None:
        """Fills what the picture in `frame` leaves open; its alpha becomes 1. cover: what catchers take. Nothing before `show`."""
        if self._texture:
            self._fill(frame, cover, self._texture)
