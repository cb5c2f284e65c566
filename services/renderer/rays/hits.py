"""Where rays over the hemispheres of surfaces end, and what they find there."""

from typing import NamedTuple

import numpy as np
from numba import types

from vemlight.kernels import kernel, subroutine
from vemlight.renderer.rays.packets import ALL_FEATURES, DIRECTION, FAR, MASK, NEAR, NUMBER, ORIGIN, PASSED, aligned
from vemlight.renderer.rays.reflecting import texel_number
from vemlight.renderer.rays.soft_pattern import GOLDEN
from vemlight.renderer.rays.surfaces import LIFT_OF_DISTANCE

PATTERN = 2  # blocks on a side have different directions, so that a filter of 3 x 3 blocks mixes PATTERN^2 sets
PACKET = 16
NO_HIT = 0xFFFFFFFF
OF_GROUND = -1.0  # in place of the albedo of a catcher, which depends on the light
# The lines of an RTCRayHit16 behind the ray's, 16 numbers each.
HIT_NORMAL, HIT_U, HIT_V, HIT_TRIANGLE, HIT_MESH, HIT_LINES = 12, 15, 16, 17, 18, 22

INTERSECT = "rtcIntersect16"  # by this name Embree finds what numba calls
intersect = types.ExternalFunction(INTERSECT, types.void(types.uintp, types.uintp, types.uintp, types.uintp))


class Hits(NamedTuple):
    """Where the rays of all blocks end, (rows, columns, rays, 3) float32: places lifted off the surface, flat normals on the ray's side,
    zeros where a ray meets nothing; the fraction of light that the surface reflects, OF_GROUND of a catcher; the radiance that it emits."""

    places: np.ndarray
    normals: np.ndarray
    albedo: np.ndarray
    emission: np.ndarray


class Query(NamedTuple):
    """The memory in which a thread talks to Embree: which rays are wanted, the rays with room for hits, the arguments and the context."""

    wanted: np.ndarray
    rays: np.ndarray
    words: np.ndarray
    arguments: np.ndarray
    context: np.ndarray


def hemisphere_pattern(rays: int) -> np.ndarray:
    """Directions (PATTERN^2, rays, 3) float32 about +Z in proportion to their cosine: all sets together, and each, are evenly spread."""
    sets = PATTERN * PATTERN
    number, which = np.arange(rays), np.arange(sets)[:, None]
    inverse = sum(((number >> bit) & 1) * 0.5 ** (bit + 1) for bit in range(16))  # van der Corput's, base 2
    u = (number + (which + 0.5) / sets) / rays
    turn = 2 * np.pi * (inverse + GOLDEN * which)
    radius = np.sqrt(u)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1 - u)], axis=-1).astype(np.float32)


def query() -> Query:
    rays, words, context = aligned(HIT_LINES * PACKET), aligned(16), aligned(PASSED + PACKET)
    arguments = words.view(np.uint32)
    arguments[1] = ALL_FEATURES  # and no flag: the rays of a packet go everywhere
    arguments[2:4] = np.array([context.ctypes.data], np.uint64).view(np.uint32)
    words[8] = 1.0
    context.view(np.uint32)[:PASSED] = 0xFFFFFFFF
    rays = rays.reshape(HIT_LINES, PACKET)
    return Query(aligned(PACKET).view(np.int32), rays, rays.view(np.uint32), arguments, context)


@subroutine
def across(x, y, z):
    """Two axes (ax, ay, az, bx, by, bz) across a unit vector (Duff et al. 2017)."""
    sign = np.float32(1.0) if z >= 0 else np.float32(-1.0)
    a = np.float32(-1.0) / (sign + z)
    b = x * y * a
    return np.float32(1.0) + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y


@subroutine
def set_ray(query, k, place, dx, dy, dz):
    for axis in range(3):
        query.rays[ORIGIN + axis, k] = place[axis]
    query.rays[DIRECTION, k], query.rays[DIRECTION + 1, k], query.rays[DIRECTION + 2, k] = dx, dy, dz
    query.rays[NEAR, k], query.rays[FAR, k] = 0.0, np.inf
    query.words[MASK, k], query.words[NUMBER, k], query.words[HIT_MESH, k] = 0xFFFFFFFF, k, NO_HIT
    query.context[PASSED + k] = 1.0
    query.wanted[k] = -1


@kernel(nogil=True)
def find_hits(scene, query, surfaces, pattern, meshes, lift_m, first_row, hits):
    """Fills the hits of rows of blocks, of which the first is number first_row of the picture."""
    rows, columns, count, _ = hits.places.shape
    for row in range(rows):
        for column in range(columns):
            nx, ny, nz = surfaces.normals[row, column]
            if nx == 0 and ny == 0 and nz == 0:
                continue
            ax, ay, az, bx, by, bz = across(nx, ny, nz)
            own = pattern[PATTERN * ((first_row + row) % PATTERN) + column % PATTERN]
            for first in range(0, count, PACKET):
                for k in range(PACKET):
                    x, y, z = own[first + k]
                    dx, dy, dz = x * ax + y * bx + z * nx, x * ay + y * by + z * ny, x * az + y * bz + z * nz
                    set_ray(query, k, surfaces.places[row, column], dx, dy, dz)
                intersect(query.wanted.ctypes.data, scene, query.rays.ctypes.data, query.arguments.ctypes.data)
                for k in range(PACKET):
                    if query.words[HIT_MESH, k] != NO_HIT:
                        take_hit(query, k, meshes, lift_m, hits, row, column, first + k)


@subroutine
def take_hit(query, k, meshes, lift_m, hits, row, column, ray):
    """Takes ray k of a query that has met a surface as a hit."""
    rays = query.rays
    far = rays[FAR, k]
    x, y, z = rays[HIT_NORMAL, k], rays[HIT_NORMAL + 1, k], rays[HIT_NORMAL + 2, k]
    length = np.sqrt(x * x + y * y + z * z)
    if not length > 0:
        return
    facing = x * rays[DIRECTION, k] + y * rays[DIRECTION + 1, k] + z * rays[DIRECTION + 2, k]
    length = -length if facing > 0 else length
    lift = lift_m + LIFT_OF_DISTANCE * far
    for axis in range(3):
        normal = rays[HIT_NORMAL + axis, k] / length
        hits.normals[row, column, ray, axis] = normal
        hits.places[row, column, ray, axis] = rays[ORIGIN + axis, k] + far * rays[DIRECTION + axis, k] + lift * normal
    mesh, u, v = query.words[HIT_MESH, k], rays[HIT_U, k], rays[HIT_V, k]
    a, b, c = meshes.triangles[meshes.first_triangle[mesh] + query.words[HIT_TRIANGLE, k]]
    first, metallic = np.float32(1.0) - u - v, meshes.metallic[mesh]
    s, t = 0.0, 0.0
    es, et = 0.0, 0.0
    for vertex, weight in ((a, first), (b, u), (c, v)):
        s += weight * meshes.colour_uvs[vertex, 0]
        t += weight * meshes.colour_uvs[vertex, 1]
        es += weight * meshes.emission_uvs[vertex, 0]
        et += weight * meshes.emission_uvs[vertex, 1]
    texel, glow = texel_number(meshes, meshes.colour_texture[mesh], s, t), texel_number(meshes, meshes.emission_texture[mesh], es, et)
    for axis in range(3):
        own = first * meshes.vertex_colours[a, axis] + u * meshes.vertex_colours[b, axis] + v * meshes.vertex_colours[c, axis]
        colour = meshes.colour[mesh, axis] * own * (meshes.texels[texel, axis] if texel >= 0 else 1.0)
        reflectance = meshes.reflectance[mesh, axis] * (1 - metallic) + metallic * colour
        reflected = min(reflectance + (1 - reflectance) * (1 - metallic) * colour, 1.0)
        hits.albedo[row, column, ray, axis] = OF_GROUND if meshes.catcher[mesh] else reflected
        emission = meshes.emission[mesh, axis] * (meshes.texels[glow, axis] if glow >= 0 else 1.0)
        hits.emission[row, column, ray, axis] = emission * own if meshes.unlit[mesh] else emission
