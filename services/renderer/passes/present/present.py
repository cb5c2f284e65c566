"""Tone mapping and subsampling of the picture on the GPU: only what a screen and the eye's adaptation need is read back."""

import moderngl
import numpy as np

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.output.tonemap import ToneCurve, subsample_grid


class Present:
    """For pictures of `size` pixels (width, height)."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int]) -> None:
        self._context, self._size = context, size
        self._first, self._stride = subsample_grid((size[1], size[0]))
        subsampled = tuple(len(range(self._first, side, self._stride)) for side in size)
        self._tone_mapped = self._target(size, "f1")
        self._subsampled = self._target(subsampled, "f4")
        self._tone_map, self._subsample = (programs.program("screen.vert", name) for name in ("tonemap.frag", "subsampled.frag"))
        self._arrays = [context.vertex_array(program, []) for program in (self._tone_map, self._subsample)]

    def _target(self, size: tuple[int, ...], dtype: str) -> moderngl.Framebuffer:
        return self._context.framebuffer([self._context.renderbuffer((size[0], size[1]), 4, dtype=dtype)])

    def tone_map(self, picture: moderngl.Texture, curve: ToneCurve) -> None:
        """Tone-maps a picture, as `tonemap.tone_mapped` does."""
        self._tone_map["scale"] = curve.scale
        self._tone_map["white"] = curve.white or 1.0
        self._tone_map["exponential"] = curve.white is None
        self._draw(0, picture, self._tone_mapped)

    def read(self) -> np.ndarray:
        """The picture tone-mapped last, (height, width, 4) uint8."""
        return self._read(self._tone_mapped, np.uint8, "f1")

    def subsampled(self, picture: moderngl.Texture) -> np.ndarray:
        """The pixels of `tonemap.subsampled`, (h, w, 4) float32."""
        self._subsample["stride"] = self._stride
        self._draw(1, picture, self._subsampled)
        return self._read(self._subsampled, np.float32, "f4")

    def _draw(self, which: int, picture: moderngl.Texture, target: moderngl.Framebuffer) -> None:
        picture.use(0)
        self._arrays[which].program["picture"] = 0
        target.use()
        self._context.enable_only(moderngl.NOTHING)
        self._arrays[which].render(moderngl.TRIANGLES, vertices=3)

    def _read(self, target: moderngl.Framebuffer, kind: type[np.generic], dtype: str) -> np.ndarray:
        return np.frombuffer(target.read(components=4, alignment=1, dtype=dtype), kind).reshape(target.height, target.width, 4)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for target in (self._tone_mapped, self._subsampled):
            for image in target.color_attachments:
                image.release()
            target.release()
        for array in self._arrays:
            array.release()
