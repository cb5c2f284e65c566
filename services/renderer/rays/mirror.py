"""What polished surfaces show of the scene: rays along the mirrored view, spread as the lobe is, from each pixel that has such a surface.

Rays follow a fixed pattern: with the same surfaces they are the same. A pixel takes in its neighbours as far as their mirrored views lie in
its own lobe.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from typing import NamedTuple

import llvmlite.binding
import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.rays.bounce import Light, disc_pattern, light_hits
from vemlight.renderer.rays.embree import function_address
from vemlight.renderer.rays.hits import HIT_MESH, INTERSECT, NO_HIT, PACKET, Hits, across, intersect, query, set_ray, take_hit
from vemlight.renderer.rays.packets import OCCLUDED
from vemlight.renderer.rays.reflecting import ReflectingMeshes
from vemlight.renderer.rays.soft_filter import REACH, SAME_PLANE
from vemlight.renderer.rays.soft_pattern import PLACES
from vemlight.renderer.rays.surfaces import LIFT_OF_REACH
from vemlight.renderer.rays.tracing import RayTracer

PIXELS_PER_TASK = 512  # a thread's: short against the whole, long against handing it out; any value in 64 .. 4096 does
# Of the lobe's light, that rays stand for: GGX' last 2 % lie beyond seven alphas, where there is no reflection of anything.
MOST = 0.98
# Steps of a sequence that fills the square evenly from its start on: powers of the inverse of the real root of x^3 = x + 1 (Roberts 2018).
STEPS = np.array([0.7548776662, 0.5698402910])
LEAST_WEIGHT = np.float32(1e-3)  # of a ray, in place of smaller ones: rays at the horizon count for nothing but are some
PI = np.pi


class Polished(NamedTuple):
    """The m polished pixels of a picture. numbers: (m,) int64, row by row. lobes: (m,) float32, GGX' alpha, or Phong's exponent below 0."""

    numbers: np.ndarray
    lobes: np.ndarray


class MirroredRays(NamedTuple):
    """Of each of m pixels' rays. weights: (m, rays) float32. views: (m, 3) float32, the mirrored view of each pixel."""

    weights: np.ndarray
    views: np.ndarray


def polished_of(lobes: np.ndarray) -> Polished:
    """The pixels of a picture (height, width) float32 in which there is a lobe; 0 where not."""
    numbers = np.flatnonzero(lobes)
    return Polished(numbers, lobes.ravel()[numbers].astype(np.float32))


def ray_pattern(first: int, rays: int) -> np.ndarray:
    """Points (16, rays, 2) float32 of the unit square for each pixel of 4 x 4, row by row, from number `first` of a sequence on.

    16 pixels together are evenly spread, and so is each with its rays.
    """
    place = PLACES.reshape(-1, 1)
    mirrored = np.sum([((place >> bit) & 1) / 2 ** (bit + 1) for bit in range(4)], axis=0)
    start = np.stack([(place + 0.5) / 16, mirrored], axis=-1)
    return ((start + np.arange(first, first + rays)[:, None] * STEPS) % 1.0).astype(np.float32)


class Mirror:
    """Follows `rays` of each polished pixel of the surfaces that a tracer saw last, and lights their ends by so many shadow rays each."""

    def __init__(self, tracer: RayTracer, meshes: ReflectingMeshes, threads: Executor, rays: int, shadow_rays: int) -> None:
        self._tracer, self._meshes, self._threads = tracer, meshes, threads
        self._rays, self._shadow_rays = rays, shadow_rays
        self._offsets, self._lift_m = disc_pattern(), LIFT_OF_REACH * tracer.reach_m
        self._polished, self._first = Polished(np.zeros(0, np.int64), np.zeros(0, np.float32)), 0
        self._hits = Hits(*(np.zeros((0, 1, rays, 3), np.float32) for _ in Hits._fields))
        self._followed = MirroredRays(np.zeros((0, rays), np.float32), np.zeros((0, 3), np.float32))
        llvmlite.binding.add_symbol(INTERSECT, function_address(INTERSECT))
        llvmlite.binding.add_symbol(OCCLUDED, function_address(OCCLUDED))

    def see(self, lobes: np.ndarray, eye: np.ndarray, number: int) -> None:
        """Follows the rays of the pixels with a lobe, (height, width) as `polished_of` has it, from the eye (3,) in the world. number: of
        the sample of each pixel, which has rays of its own."""
        self._polished, self._first = polished_of(lobes), number * self._rays
        count, scene, surfaces = len(self._polished.numbers), self._tracer.scene, self._tracer.surfaces
        self._hits = hits = Hits(*(np.zeros((count, 1, self._rays, 3), np.float32) for _ in Hits._fields))
        self._followed = followed = MirroredRays(np.zeros((count, self._rays), np.float32), np.zeros((count, 3), np.float32))
        pattern, origin = ray_pattern(self._first, self._rays), (eye - scene.origin).astype(np.float32)

        def follow(part: slice) -> None:
            own, ends, rays = (type(each)(*(array[part] for array in each)) for each in (self._polished, hits, followed))
            follow_mirrored(scene.address, query(), surfaces, own, pattern, origin, self._meshes, self._lift_m, ends, rays)

        self._in_parts(follow)

    def lit(self, light: Light, ground: np.ndarray) -> np.ndarray:
        """What the pixels show under a light, (height, width, 4) float32: the radiance that comes from the scene along the lobe, its mean
        with 0 where rays meet nothing, and the fraction of them that meet something. ground: albedo (3,) of catchers."""
        surfaces, hits = self._tracer.surfaces, self._hits
        narrow, shown, made = (np.zeros((count, 4), np.float32) for count in (*[len(self._polished.numbers)] * 2, surfaces.distances.size))
        albedo = ground.astype(np.float32)
        numbers = (self._polished.numbers + surfaces.distances.size * self._first).reshape(-1, 1)

        def own(part: slice) -> None:
            ends = Hits(*(array[part] for array in hits))
            radiance = np.empty_like(ends.places)
            sharp = np.zeros(ends.places.shape[:3], np.float32)
            light_hits(
                self._tracer.scene.address, query(), ends, sharp, light, albedo, self._offsets, self._shadow_rays, numbers[part], radiance
            )
            mean_of_rays(radiance, ends.normals, self._followed.weights[part], narrow[part])

        self._in_parts(own)
        index, views = np.full(surfaces.distances.shape, -1, np.int64), self._followed.views
        index.ravel()[self._polished.numbers] = np.arange(len(narrow))
        self._in_parts(lambda part: filter_lobes(narrow, index, surfaces, self._polished, views, part.start, shown[part]))
        made[self._polished.numbers] = shown
        return made.reshape(*surfaces.distances.shape, 4)

    def warm(self) -> None:
        """Compiles, or loads, what mirrors take; the tracer has seen surfaces, of which the first pixel then is polished."""
        lobes = np.zeros(self._tracer.surfaces.distances.shape, np.float32)
        lobes[0, 0] = 1.0
        self.see(lobes, np.ones(3), 0)
        self.lit(Light.of(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1), NearLightSet.empty()), np.zeros(3))

    def _in_parts(self, work: Callable[[slice], None]) -> None:
        """Does some work on all polished pixels, by all threads."""
        count = len(self._polished.numbers)
        parts = [slice(first, min(first + PIXELS_PER_TASK, count)) for first in range(0, count, PIXELS_PER_TASK)]
        for task in [self._threads.submit(work, part) for part in parts]:
            task.result()


@kernel(nogil=True)
def follow_mirrored(scene, query, surfaces, polished, pattern, eye, meshes, lift_m, hits, followed):
    """Fills the hits (m, 1, rays, 3) and MirroredRays of m polished pixels."""
    width = surfaces.distances.shape[1]
    rays = followed.weights.shape[1]
    total = len(polished.numbers) * rays
    for first in range(0, total, PACKET):
        count = min(PACKET, total - first)
        for k in range(PACKET):
            query.wanted[k] = 0
        for k in range(count):
            pixel, ray = (first + k) // rays, (first + k) % rays
            y, x = polished.numbers[pixel] // width, polished.numbers[pixel] % width
            u, turn = pattern[4 * (y % 4) + x % 4, ray]
            _set_mirrored(query, k, surfaces, y, x, polished.lobes[pixel], u * np.float32(MOST), turn, eye, followed, pixel, ray)
        intersect(query.wanted.ctypes.data, scene, query.rays.ctypes.data, query.arguments.ctypes.data)
        for k in range(count):
            if query.words[HIT_MESH, k] != NO_HIT:
                take_hit(query, k, meshes, lift_m, hits, (first + k) // rays, 0, (first + k) % rays)


@subroutine
def _set_mirrored(query, k, surfaces, y, x, lobe, u, turn, eye, followed, pixel, ray):
    """Sets ray k of a query to go from a pixel along a direction of its lobe: u, turn in the unit square.

    GGX: halfway vectors are drawn by their distribution, and weigh v.h / n.h. Phong: directions by the lobe, and weigh their cosine.
    """
    nx, ny, nz = surfaces.smooth_normals[y, x]
    fx, fy, fz = surfaces.flat_normals[y, x]
    place = surfaces.places[y, x]
    vx, vy, vz = eye[0] - place[0], eye[1] - place[1], eye[2] - place[2]
    scale = np.float32(1.0) / np.sqrt(vx * vx + vy * vy + vz * vz)
    vx, vy, vz = vx * scale, vy * scale, vz * scale
    twice = 2 * (nx * vx + ny * vy + nz * vz)
    mx, my, mz = twice * nx - vx, twice * ny - vy, twice * nz - vz
    followed.views[pixel, 0], followed.views[pixel, 1], followed.views[pixel, 2] = mx, my, mz
    ux, uy, uz = (nx, ny, nz) if lobe > 0 else (mx, my, mz)
    ax, ay, az, bx, by, bz = across(ux, uy, uz)
    if lobe > 0:
        slope = lobe * np.sqrt(u / (1 - u))
        along = 1 / np.sqrt(1 + slope * slope)
        out = slope * along
    else:
        along = (1 - u) ** (1 / (1 - lobe))
        out = np.sqrt(1 - along * along)
    p, q = out * np.cos(2 * PI * turn), out * np.sin(2 * PI * turn)
    dx, dy, dz = along * ux + p * ax + q * bx, along * uy + p * ay + q * by, along * uz + p * az + q * bz
    if lobe > 0:
        between = vx * dx + vy * dy + vz * dz
        dx, dy, dz = 2 * between * dx - vx, 2 * between * dy - vy, 2 * between * dz - vz
        weight = between / along
    else:
        weight = nx * dx + ny * dy + nz * dz
    below = fx * dx + fy * dy + fz * dz
    if below < 0:  # a smooth normal turns it into the surface, or the lobe reaches below: mirrored back
        dx, dy, dz = dx - 2 * below * fx, dy - 2 * below * fy, dz - 2 * below * fz
    followed.weights[pixel, ray] = max(np.float32(weight), LEAST_WEIGHT)
    set_ray(query, k, place, dx, dy, dz)


@kernel(nogil=True)
def mean_of_rays(radiance, normals, weights, shown):
    """Fills shown (m, 4) with the mean of the rays' radiance (m, 1, rays, 3) and the fraction of them that ends at a surface."""
    for pixel in range(len(shown)):
        total = np.float32(0.0)
        for ray in range(weights.shape[1]):
            x, y, z = normals[pixel, 0, ray]
            weight = weights[pixel, ray]
            total += weight
            if x != 0 or y != 0 or z != 0:
                shown[pixel, 3] += weight
                for axis in range(3):
                    shown[pixel, axis] += weight * radiance[pixel, 0, ray, axis]
        for channel in range(4):
            shown[pixel, channel] /= total


@kernel(nogil=True)
def filter_lobes(narrow, index, surfaces, polished, views, first, shown):
    """Fills shown (k, 4), of the polished pixels from `first` on, with the mean of `narrow` (m, 4) over neighbours on the same surface, as
    their mirrored views lie in the lobe. index: (height, width) int64, of the polished pixels, -1 elsewhere. views: (m, 3)."""
    height, width = index.shape
    for k in range(len(shown)):
        own = first + k
        y, x, lobe = polished.numbers[own] // width, polished.numbers[own] % width, polished.lobes[own]
        # Of the mirrored view along an axis: halfway vectors turn half as far, and have alpha^2 / 2.
        variance = 2 * lobe * lobe if lobe > 0 else 1 / (2 - lobe)
        flat, place, near = surfaces.flat_normals[y, x], surfaces.places[y, x], SAME_PLANE * surfaces.distances[y, x]
        total = np.float32(0.0)
        for j in range(max(y - REACH, 0), min(y + REACH + 1, height)):
            for i in range(max(x - REACH, 0), min(x + REACH + 1, width)):
                other = index[j, i]
                if other < 0:
                    continue
                off, square = 0.0, 0.0
                for axis in range(3):
                    off += flat[axis] * (surfaces.places[j, i, axis] - place[axis])
                    square += (views[other, axis] - views[own, axis]) ** 2
                if abs(off) > near:
                    continue
                weight = (1 if abs(j - y) == REACH else 2) * (1 if abs(i - x) == REACH else 2) * np.exp(-square / (2 * variance))
                total += weight
                for channel in range(4):
                    shown[k, channel] += weight * narrow[other, channel]
        for channel in range(4):
            shown[k, channel] /= total
