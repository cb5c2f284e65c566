"""What shadow rays pass through: the holes of alpha-tested meshes, and surfaces that alpha covers in part.

Embree asks for each hit of such a mesh whether it counts, by a function that is compiled here for it. A mask's texel decides as in the
shadow maps; partial coverage takes its fraction of the light, which is the mean of what hashed alpha does there.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic

from vemlight.kernels import callback, subroutine
from vemlight.renderer.gl.constants import HASHED_ALPHA
from vemlight.renderer.rays.packets import NUMBER, PASSED
from vemlight.renderer.scene.alpha_vertices import WHITE, alpha_vertices
from vemlight.renderer.scene.materials import AlphaTest, alpha_test_of
from vemlight.renderer.scene.meshes import Geometry
from vemlight.renderer.scene.scene import Scene

NEAREST = 0x2600  # OpenGL's GL_NEAREST
OPAQUE = 1 / 512  # of the light: what is left is darker than half a code of 8 bits
# The lines of an RTCHitN behind its normal, N numbers each.
HIT_U, HIT_V, HIT_PRIMITIVE = 3, 4, 5


class HoleData(NamedTuple):
    """What the filter of a mesh reads. table: (8,) int64, the addresses of the other arrays and the texture's size and how it repeats.

    uvs: (n, 2), alphas: (n,) float32 a vertex. triangles: (m, 3) uint32. texels: (h, w) float32, alpha. cutoff: (1,) float32.
    """

    table: np.ndarray
    uvs: np.ndarray
    alphas: np.ndarray
    triangles: np.ndarray
    texels: np.ndarray
    cutoff: np.ndarray


def scene_holes(scene: Scene) -> dict[int, HoleData]:
    """Of each alpha-tested mesh of a scene, by its number."""
    tests = ((k, mesh.geometry, alpha_test_of(mesh.material)) for k, mesh in enumerate(scene.meshes))
    return {k: hole_data(geometry, alpha_test) for k, geometry, alpha_test in tests if alpha_test}


def hole_data(geometry: Geometry, alpha_test: AlphaTest) -> HoleData:
    """What the filter of a mesh reads; Embree holds its table's address, so it must be kept as long as the mesh."""
    image = alpha_test.image or WHITE
    vertices = alpha_vertices(geometry, alpha_test)
    texels = np.ascontiguousarray(image.texels[..., 3], np.float32)
    cutoff = np.array([HASHED_ALPHA if alpha_test.cutoff is None else alpha_test.cutoff], np.float32)
    arrays = np.ascontiguousarray(vertices.uvs), np.ascontiguousarray(vertices.alphas), np.ascontiguousarray(geometry.triangles, np.uint32)
    smooth = image.filters[1] != NEAREST
    flags = int(image.repeats[0]) + 2 * int(image.repeats[1]) + 4 * int(smooth)
    table = np.array([*(array.ctypes.data for array in (*arrays, texels, cutoff)), *texels.shape, flags], np.int64)
    return HoleData(table, *arrays, texels, cutoff)


@intrinsic
def _floats_at(_context, address):
    """The float32 numbers from an address on."""
    return _pointer(types.CPointer(types.float32), address)


@intrinsic
def _words_at(_context, address):
    """The 32-bit words from an address on."""
    return _pointer(types.CPointer(types.int32), address)


@intrinsic
def _longs_at(_context, address):
    """The 64-bit words from an address on."""
    return _pointer(types.CPointer(types.int64), address)


def _pointer(kind: Any, address: Any) -> Any:
    def compiled(context, builder, _signature, arguments):
        return builder.inttoptr(arguments[0], context.get_value_type(kind))

    return kind(address), compiled


@subroutine
def _texel(texels, height, width, flags, x, y):
    """Alpha of a texel, in a texture that repeats or is clamped."""
    x = x % width if flags & 1 else min(max(x, 0), width - 1)
    y = y % height if flags & 2 else min(max(y, 0), height - 1)
    return texels[y * width + x]


@subroutine
def _texture_alpha(texels, height, width, flags, u, v):
    """Alpha at (u, v) of the largest level of a texture: of the nearest texel, or between four."""
    if not (abs(u) < 1e9 and abs(v) < 1e9):
        return texels[0]
    x, y = u * width, v * height
    if not flags & 4:
        return _texel(texels, height, width, flags, int(np.floor(x)), int(np.floor(y)))
    x, y = x - 0.5, y - 0.5
    left, low = int(np.floor(x)), int(np.floor(y))
    along, up = x - left, y - low
    below = (1 - along) * _texel(texels, height, width, flags, left, low) + along * _texel(texels, height, width, flags, left + 1, low)
    above = (1 - along) * _texel(texels, height, width, flags, left, low + 1)
    above += along * _texel(texels, height, width, flags, left + 1, low + 1)
    return (1 - up) * below + up * above


@callback("void(uintp)")
def let_through(arguments):
    """Embree's RTCFilterFunctionN: clears the wanted rays of a hit that pass through it."""
    given = _longs_at(arguments)  # pyright: ignore[reportCallIssue]  # numba passes the context
    wanted, table, count = _words_at(given[0]), _longs_at(given[1]), _words_at(arguments + 40)[0]
    context, rays, hits, hit_words = _floats_at(given[2]), _words_at(given[3]), _floats_at(given[4]), _words_at(given[4])
    uvs, alphas, triangles = _floats_at(table[0]), _floats_at(table[1]), _words_at(table[2])
    texels, cutoff = _floats_at(table[3]), _floats_at(table[4])[0]
    for k in range(count):
        if wanted[k] == 0:
            continue
        u, v, triangle = hits[HIT_U * count + k], hits[HIT_V * count + k], hit_words[HIT_PRIMITIVE * count + k]
        a, b, c = triangles[3 * triangle], triangles[3 * triangle + 1], triangles[3 * triangle + 2]
        first = 1 - u - v
        s = first * uvs[2 * a] + u * uvs[2 * b] + v * uvs[2 * c]
        t = first * uvs[2 * a + 1] + u * uvs[2 * b + 1] + v * uvs[2 * c + 1]
        alpha = first * alphas[a] + u * alphas[b] + v * alphas[c]
        alpha *= _texture_alpha(texels, table[5], table[6], table[7], s, t)
        if cutoff != HASHED_ALPHA:
            if alpha < cutoff:
                wanted[k] = 0
            continue
        ray = PASSED + rays[NUMBER * count + k]
        context[ray] *= 1 - min(max(alpha, 0.0), 1.0)
        if context[ray] > OPAQUE:
            wanted[k] = 0
