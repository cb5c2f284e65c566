"""The light around as background: the map that lights the scene, seen by the rays through the pixels."""

import moderngl
import numpy as np

from services.renderer.backdrop import Backdrop
from services.renderer.programs import Programs
from services.renderer.scene import Camera
from services.renderer.view import ray_from_pixel
from services.sphere import SPAN, Coverage


class Background:
    """A polar map of radiance behind a picture of `size` pixels (width, height)."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int]) -> None:
        self._context, self._size = context, size
        self._backdrop = Backdrop(context, programs, "background.frag")
        self._texture: moderngl.Texture | None = None
        self._coverage: Coverage = "hemisphere"

    def show(self, radiance: np.ndarray, coverage: Coverage) -> None:
        """Takes a polar map (rows, cols, 3) float32, laid out as in sphere.py. nan and negative values become 0."""
        size = radiance.shape[1], radiance.shape[0]
        if self._texture is None or self._texture.size != size:
            self._free()
            self._texture = self._context.texture(size, 3, dtype="f4")
            self._texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
            self._texture.repeat_x, self._texture.repeat_y = True, False
        clean = np.nan_to_num(radiance, nan=0.0, posinf=1e30).clip(0, 1e30)  # inf times a share of 0 would be nan
        self._texture.write(np.ascontiguousarray(clean, np.float32), alignment=1)
        self._coverage = coverage

    def draw(self, frame: moderngl.Framebuffer, cover: moderngl.Texture | None, camera: Camera) -> None:
        """Fills what the picture in `frame` leaves open, seen from `camera`, and makes alpha 1 there; nothing below a hemisphere's horizon.

        Does nothing before the first `show`.
        """
        if self._texture:
            matrix = ray_from_pixel(camera, self._size)
            uniforms = {"span": SPAN[self._coverage], "ray_from_pixel": tuple(matrix.T.reshape(-1))}
            self._backdrop.draw(frame, cover, self._texture, uniforms)

    def _free(self) -> None:
        if self._texture:
            self._texture.release()

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        self._backdrop.release()
        self._free()
