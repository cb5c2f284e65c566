"""The environment map as browsers draw it, behind the scene and in what is polished, in one block of bytes.

Numbers are little-endian. HEAD, and deflated (RFC 1950) what follows: a row of SOURCE for each light that glossy lobes reflect as a light
(reflected_light.py); the map's cells as words of RGB9E5, row after row; the number of each cell that loses light to those; and those cells'
words without it. A word times `unit` is radiance; `scale` (RGB) is that of the map in lobes.
"""

import struct
import zlib

import numpy as np

from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.extent import points_of_extents
from vemlight.light.light_set import LightSet
from vemlight.light.reflected_light import reflected_light
from vemlight.light.sphere import Coverage
from vemlight.light.virtual_lamp import is_virtual
from vemlight.viewer.fewer_cells import fewer_cells

KIND, LAYOUT = 5, 1  # the first two bytes: what the message is among the page's, and the version of what follows
# All of a hemisphere's cells of a degree: 75 kB of the bundled sky, whose pictures are 0.4 % off the server's, and with half as many 1.8 %.
MAX_CELLS = 32_768
HEAD = struct.Struct("<4B2H2I4f")  # kind, layout, coverage (0 hemisphere, 1 sphere), 0, rows, cols, sources, changed cells, unit, scale
# id of the light, or of the point of a soft one; direct, spread and least_width of it as ReflectedLight has them, direction
SOURCE = np.dtype([("id", "<f8"), ("direct", "<f4"), ("spread", "<f4"), ("least_width", "<f4"), ("direction", "<f4", 3)])
FAST = 1  # of zlib's levels: 2 ms for 60 % of the bytes, where the best takes 20 ms for 55 %
COVERAGES: tuple[Coverage, ...] = ("hemisphere", "sphere")
MANTISSA, BIAS, LARGEST_EXPONENT = 9, 15, 31  # bits, and of the shared exponent: EXT_texture_shared_exponent


def environment_binary(environment: EnvironmentMap, lights: LightSet) -> bytes:
    """The map and what of it `lights` are, of about the same moment."""
    points = points_of_extents(lights)
    reflected = reflected_light(points, environment)
    whole = fewer_cells(np.where(np.isfinite(environment.radiance), environment.radiance, 0).clip(0), environment.coverage, MAX_CELLS)
    rest, scale = whole, np.zeros(3)  # without a light lobes reflect nothing
    if reflected.radiance is not None:
        rest, scale = fewer_cells(reflected.radiance, environment.coverage, MAX_CELLS), reflected.scale
    unit = 2.0 ** max(np.ceil(np.log2(max(whole.max(initial=0), 1e-30))) - BIAS, -100)
    words, words_of_rest = rgb9e5(whole / unit).ravel(), rgb9e5(rest / unit).ravel()
    changed = np.flatnonzero(words != words_of_rest)
    own = np.flatnonzero((reflected.direct > 0) & ~is_virtual(points))
    sources = np.zeros(len(own), SOURCE)
    sources["id"], sources["direction"] = points.ids[own], points.directions[own]
    for name in ("direct", "spread", "least_width"):
        sources[name] = getattr(reflected, name)[own]
    kinds = KIND, LAYOUT, COVERAGES.index(environment.coverage), 0
    head = HEAD.pack(*kinds, *whole.shape[:2], len(own), len(changed), unit, *scale.tolist())
    rest_of_it = (sources, words, changed.astype("<u4"), words_of_rest[changed])
    return head + zlib.compress(b"".join(array.tobytes() for array in rest_of_it), FAST)


def rgb9e5(rgb: np.ndarray) -> np.ndarray:
    """Colours (..., 3) from 0 to 65408 as words of GL_UNSIGNED_INT_5_9_9_9_REV, (...) uint32."""
    largest = rgb.max(axis=-1)
    exponent = np.maximum(np.frexp(largest)[1], -BIAS)  # largest < 2 ** exponent
    exponent = np.minimum(exponent, LARGEST_EXPONENT - BIAS)
    mantissas = np.rint(np.ldexp(rgb, (MANTISSA - exponent)[..., None])).clip(0, 2**MANTISSA - 1).astype("<u4")
    red, green, blue = np.moveaxis(mantissas, -1, 0)
    return red | green << 9 | blue << 18 | (exponent + BIAS).astype("<u4") << 27
