"""The light around as background: the map that lights the scene, seen by the rays through the pixels."""

import moderngl
import numpy as np

from vemlight.light.sphere import SPAN, Coverage
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.background.compositing import Backdrop
from vemlight.renderer.scene.scene import ViewCamera
from vemlight.renderer.scene.view import ray_from_pixel


class Background(Backdrop):
    """A polar map of radiance behind a picture of `size` pixels (width, height)."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int]) -> None:
        super().__init__(context, programs, size, "background.frag")
        self._shown: np.ndarray | None = None

    def show(self, radiance: np.ndarray, coverage: Coverage) -> None:
        """Takes a polar map (rows, cols, 3) float32, laid out as in sphere.py. nan and negative values become 0."""
        self._program["span"] = SPAN[coverage]
        if radiance is self._shown:
            return
        self._shown = radiance
        texture = self._held((radiance.shape[1], radiance.shape[0]), "f4")
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        texture.repeat_x, texture.repeat_y = True, False
        clean = np.nan_to_num(radiance, nan=0.0, posinf=1e30).clip(0, 1e30)  # inf times a share of 0 would be nan
        texture.write(np.ascontiguousarray(clean, np.float32), alignment=1)

    def draw(self, frame: moderngl.Framebuffer, cover: moderngl.Texture | None, camera: ViewCamera) -> None:
        """Fills what the picture in `frame` leaves open, seen from `camera`, and makes alpha 1 there; nothing below a hemisphere's horizon.

        cover: what catchers take. Does nothing before the first `show`.
        """
        if self._texture:
            self._program["ray_from_pixel"] = tuple(ray_from_pixel(camera, self._size).T.reshape(-1))
            self._fill(frame, cover, self._texture)
