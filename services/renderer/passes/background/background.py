"""The light map as background: what lights the scene, seen along the rays through the pixels."""

import moderngl
import numpy as np

from vemlight.light.sphere import SPAN, Coverage
from vemlight.renderer.gl.constants import MAX_RADIANCE
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.background.compositing import BackgroundLayer
from vemlight.renderer.scene.scene import ViewCamera
from vemlight.renderer.scene.view import ray_from_pixel


class Background(BackgroundLayer):
    """A polar map of radiance behind a picture of `size` pixels (width, height)."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int]) -> None:
        super().__init__(context, programs, size, "background.frag")
        self._program["gain"] = 1.0  # browsers have the map in another unit
        self._shown: np.ndarray | None = None

    def show(self, radiance: np.ndarray, coverage: Coverage) -> None:
        """Takes a polar map (rows, cols, 3) float32, laid out as in sphere.py. nan and negative values become 0."""
        self._program["span"] = SPAN[coverage]
        if radiance is self._shown:
            return
        self._shown = radiance
        texture = self._texture_of((radiance.shape[1], radiance.shape[0]), "f4")
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        texture.repeat_x, texture.repeat_y = True, False
        clean = np.nan_to_num(radiance, nan=0.0, posinf=MAX_RADIANCE).clip(0, MAX_RADIANCE)  # inf times 0 would be nan
        texture.write(np.ascontiguousarray(clean, np.float32), alignment=1)

    def draw(self, frame: moderngl.Framebuffer, matte: moderngl.Texture | None, camera: ViewCamera, single: bool) -> None:
        """Composites the map behind the picture in `frame`, seen from `camera`; below a hemisphere's horizon the picture stays open.

        matte: as in shading.py. single: whether pixels have one sample, so that none is open whose class is that of a surface. Does nothing
        before the first `show`.
        """
        if self._texture:
            self._program["ray_from_pixel"] = tuple(ray_from_pixel(camera, self._size).T.reshape(-1))
            self._composite(frame, matte, self._texture, single)
