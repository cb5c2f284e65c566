"""Tone mapping and subsampling of the picture on the GPU: only what a screen and the eye's adaptation need is read back."""

from typing import TYPE_CHECKING

import moderngl
import numpy as np

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.output.tonemap import ToneCurve, subsample_grid

if TYPE_CHECKING:
    from vemlight.renderer.passes.edges.edges import Edges

ON_EDGE, OFF_EDGE = 0.5, 0.25  # depths of pixels that have parts of their neighbours' colours, and of others


class Present:
    """For pictures of `size` pixels (width, height); of edges, if there are, with smooth ones."""

    def __init__(self, context: moderngl.Context, programs: Programs, size: tuple[int, int], edges: "Edges | None" = None) -> None:
        self._context, self._size, self._edges = context, size, edges
        self._first, self._stride = subsample_grid((size[1], size[0]))
        subsampled = tuple(len(range(self._first, side, self._stride)) for side in size)
        self._tone_mapped = self._target(size, "f1", edges and edges.depth)
        self._tone_mapped.depth_mask = False
        self._subsampled = self._target(subsampled, "f4")
        self._subsample = programs.program("screen.vert", "subsampled.frag")
        self._tone_maps = [programs.program("screen.vert", "tonemap.frag", EDGES=k) for k in ((0, 1) if edges else (0,))]
        self._arrays = [context.vertex_array(program, []) for program in (self._subsample, *self._tone_maps)]

    def _target(self, size: tuple[int, ...], dtype: str, depth: moderngl.Texture | None = None) -> moderngl.Framebuffer:
        return self._context.framebuffer([self._context.renderbuffer((size[0], size[1]), 4, dtype=dtype)], depth)

    def tone_map(self, picture: moderngl.Texture, curve: ToneCurve, smooth: bool) -> None:
        """Tone-maps a picture, as `tonemap.tone_mapped` does. smooth: with smooth edges, if there are."""
        edges = self._edges if smooth else None
        for k, program in enumerate(self._tone_maps if edges else self._tone_maps[:1]):
            program["scale"], program["white"], program["exponential"] = curve.scale, curve.white or 1.0, curve.white is None
            program["depth"] = ON_EDGE if k else OFF_EDGE
            if edges and k:
                edges.bind(program, 1)
            self._draw(1 + k, picture, self._tone_mapped, moderngl.DEPTH_TEST if edges else moderngl.NOTHING)

    def read(self) -> np.ndarray:
        """The picture tone-mapped last, (height, width, 4) uint8."""
        return self._read(self._tone_mapped, np.uint8, "f1")

    def subsampled(self, picture: moderngl.Texture) -> np.ndarray:
        """The pixels of `tonemap.subsampled`, (h, w, 4) float32."""
        self._subsample["stride"] = self._stride
        self._draw(0, picture, self._subsampled)
        return self._read(self._subsampled, np.float32, "f4")

    def _draw(self, which: int, picture: moderngl.Texture, target: moderngl.Framebuffer, tests: int = moderngl.NOTHING) -> None:
        picture.use(0)
        self._arrays[which].program["picture"] = 0
        target.use()
        self._context.enable_only(tests)
        self._context.depth_func = "=="
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
