"""The environment map prefiltered for glossy lobes: levels of growing blur on an octahedron map, made on the GPU.

Level l is the map convolved with a round kernel of variance base_variance * 4^l along each axis of the tangent plane, in rad^2. Shaders
look up any variance between two levels; a map of one radiance stays that radiance, and power stays power, at every level.
"""

import math

import moderngl
import numpy as np

from vemlight.light.sphere import SPAN, Coverage
from vemlight.renderer.gl.constants import MAX_RADIANCE
from vemlight.renderer.gl.programs import Programs

LEVELS = 7  # from `SIDES` down to 8 texels, 30 degrees each; wider lobes are made of several lookups
SIDES = (256, 512, 1024)  # of level 0 with its border; three quarters of it are the sphere
REACH = 5.0  # standard deviations of a level, beyond which a hemisphere's light is not seen below its horizon; any value from 4 on does
GROUP = 8  # texels a side of what a work group makes; any power of two in 4 to 16 does
TEXELS_PER_CELL = 1.3  # of the polar map, at least: a bilinear map of cells is then the same map on texels within 2 %
# The variance along an axis of the taps of a level, a hexagon and its middle, over their spacing^2: six of seven are that far away. The
# level before is blurred by 1 / 2.2 of the spacing, and the hexagon does not show.
HEXAGON_VARIANCE = 6 / 7 / 2


class PrefilteredMap:
    """The prefiltered levels of an environment map, a mipmapped texture of four floats a texel."""

    def __init__(self, context: moderngl.Context, programs: Programs) -> None:
        self._context = context
        self._first, self._next = (programs.compute("prefilter.comp", LEVEL_0=k, PREFILTER_GROUP=GROUP) for k in (1, 0))
        self._polar: moderngl.Texture | None = None
        self.texture: moderngl.Texture | None = None
        self.base_variance = 1.0

    def prefilter(self, radiance: np.ndarray, coverage: Coverage) -> None:
        """Takes a polar map (rows, cols, 3) float32, laid out as in sphere.py. nan and negative values become 0."""
        rows, cols, _ = radiance.shape
        cell_rad = max(SPAN[coverage] / rows, 2 * math.pi / cols)
        sides = [side for side in SIDES if texel_rad(side) * TEXELS_PER_CELL <= cell_rad]
        self._fit((cols, rows), sides[0] if sides else SIDES[-1])
        assert self._polar is not None
        assert self.texture is not None
        side, texel = self.texture.width, texel_rad(self.texture.width)
        self._polar.write(even_at_pole(radiance, coverage, texel), alignment=1)
        self.base_variance = cell_rad**2 / 6 + texel**2 / 6  # of a tent over the cells, and of one over the texels of a lookup
        self._first["span"] = SPAN[coverage]
        for level in range(LEVELS):
            program, variance = self._next if level else self._first, self.base_variance * 4**level
            if level:
                program["before"] = float(level - 1)
                program["spacing"] = math.sqrt((variance * 3 / 4 - texel_rad(side) ** 2 / 6) / HEXAGON_VARIANCE)
            program["lowest"] = -REACH * math.sqrt(variance) if coverage == "hemisphere" else -1.0
            (self.texture if level else self._polar).use(0)
            program["source"] = 0
            self.texture.bind_to_image(0, read=False, write=True, level=level)
            groups = -(-side // GROUP)
            program.run(groups, groups)
            self._context.memory_barrier()
            side //= 2

    def _fit(self, polar_size: tuple[int, int], side: int) -> None:
        """Makes the textures as large as a map asks for."""
        if self._polar is None or self._polar.size != polar_size:
            if self._polar:
                self._polar.release()
            self._polar = self._context.texture(polar_size, 3, alignment=1, dtype="f4")
            self._polar.filter = (moderngl.LINEAR, moderngl.LINEAR)
            self._polar.repeat_x, self._polar.repeat_y = True, False
        if self.texture is None or self.texture.width != side:
            if self.texture:
                self.texture.release()
            self.texture = self._context.texture((side, side), 4, dtype="f4")
            self.texture.build_mipmaps(0, LEVELS - 1)
            self.texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            self.texture.repeat_x = self.texture.repeat_y = False

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for texture in (self._polar, self.texture):
            if texture:
                texture.release()


def even_at_pole(radiance: np.ndarray, coverage: Coverage, texel_rad: float) -> np.ndarray:
    """A polar map (rows, cols, 3) whose cells, near the poles narrower than a texel, are means over one: float32, finite, from 0 on."""
    clean = np.nan_to_num(radiance, nan=0.0, posinf=MAX_RADIANCE).clip(0, MAX_RADIANCE).astype(np.float32)
    rows, cols, _ = clean.shape
    sines = np.sin((np.arange(rows) + 0.5) * (SPAN[coverage] / rows))
    across = np.floor(texel_rad / sines * cols / (4 * np.pi))  # half of the cells in a mean, the middle one left out
    half = np.minimum(across, (cols - 1) // 2).astype(np.int64)
    narrow = np.flatnonzero(half)
    if len(narrow):
        sums = np.cumsum(np.pad(clean[narrow], ((0, 0), (cols, cols), (0, 0)), "wrap"), axis=1, dtype=np.float64)
        row, col, reach = np.arange(len(narrow))[:, None], np.arange(cols) + cols, half[narrow][:, None]
        clean[narrow] = (sums[row, col + reach] - sums[row, col - reach - 1]) / (2 * reach[..., None] + 1)
    return clean


def texel_rad(side: int) -> float:
    """The side of a texel of a level of `side` texels, in rad, on average over the sphere."""
    return math.sqrt(4 * math.pi) / (0.75 * side)
