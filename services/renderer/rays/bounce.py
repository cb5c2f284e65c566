"""One bounce of light: what the surfaces around a pixel, lit by the lights, send to it (final gathering, after Jensen 1996).

A pixel of every block of pixels sends rays over its hemisphere; where they meet a surface, shadow rays to some of the lights say how
bright it is there. That is about as much work as the direct light of thirty lights. The noise it leaves stands still, since all directions
and choices are fixed, and is spread over nine blocks; bounce.frag brings it to all pixels.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from typing import NamedTuple

import llvmlite.binding
import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.light.near_lights import MIN_DISTANCE_M, NearLightSet
from vemlight.renderer.rays.embree import RayScene, function_address
from vemlight.renderer.rays.hits import (
    INTERSECT,
    PACKET,
    PATTERN,
    Hits,
    across,
    find_hits,
    hemisphere_pattern,
    query,
    set_ray,
)
from vemlight.renderer.rays.packets import ENDS_BEFORE, FAR, OCCLUDED, PASSED, occluded
from vemlight.renderer.rays.reflecting import ReflectingMeshes
from vemlight.renderer.rays.soft_pattern import GOLDEN
from vemlight.renderer.rays.surfaces import LIFT_OF_REACH

ROWS_PER_TASK = 4  # of blocks; as tracing.TILE_ROWS_PER_TASK
SAME_NORMAL = 8.0  # exponent of the cosine between two normals: surfaces 30 degrees apart share a third of their light
SAME_PLANE = 0.02  # of the distance to the eye: so far off a block's plane light counts by 1 / e; a block is half of that wide
OFFSETS = 64  # directions of a light with extent; a hit takes one. Any value in 16 .. 1024 does
MIRROR_EXPONENT = 8  # of the lobe about the mirrored view: 30 degrees to half, in which two of sixteen rays lie
ORIGIN_OF_WORLD = np.zeros(3)
LEAST_AWAY = np.float32(1e-6)  # metres from a near light, in place of less: there is no direction to it
LEAST_REACH = np.float32(MIN_DISTANCE_M)
PI = np.pi


class BlockSurfaces(NamedTuple):
    """The pixels that stand for blocks, (rows, columns, 3) float32 each: places as in Surfaces, normals for shading, zeros where there
    is no surface."""

    places: np.ndarray
    normals: np.ndarray


class Blocks(NamedTuple):
    """What the blocks of a picture receive from surfaces, (rows, columns, 3) float32 each; where a block sees nothing, zeros.

    places: of the pixel that stands for the block, as in Surfaces; normals: the same pixel's, for shading. irradiance: at that pixel.
    mirrored: radiance from where a mirror would show it, averaged over a wide lobe.
    """

    places: np.ndarray
    normals: np.ndarray
    irradiance: np.ndarray
    mirrored: np.ndarray


class Light(NamedTuple):
    """The lights of a frame, float32: n directional ones and, after them, m near ones. directions: (n, 3). irradiance: (n + m, 3), of near
    ones intensity. luminance: (n + m,), of that. spreads: (n,), rad. places: (m, 3), about the ray scene's origin. radii: (m,), metres."""

    directions: np.ndarray
    irradiance: np.ndarray
    luminance: np.ndarray
    spreads: np.ndarray
    places: np.ndarray
    radii: np.ndarray

    @staticmethod
    def of(
        directions: np.ndarray, irradiance: np.ndarray, spreads: np.ndarray, near: NearLightSet, origin: np.ndarray = ORIGIN_OF_WORLD
    ) -> "Light":
        """Lights of directions (n, 3), irradiance (n, 3), spreads (n,) rad, and near ones about an origin (3,)."""
        both = np.concatenate([irradiance, near.intensity])
        arrays = (directions, both, both @ LUMINANCE_WEIGHTS, spreads, near.at - origin, near.radius)
        return Light(*(np.ascontiguousarray(array, np.float32) for array in arrays))


class Bounce:
    """Gathers one bounce for the surfaces that `see` was given last.

    rays: of each block, a multiple of 16, in so many sets: each is gathered by itself, and what blocks receive is the mean over those that
    were. shadow_rays: of each of their ends; with as many lights or fewer each is traced, otherwise so
    many are drawn by how much they would bring, so that the mean is right.
    """

    def __init__(
        self, scene: RayScene, meshes: ReflectingMeshes, reach_m: float, threads: Executor, rays: int, shadow_rays: int, sets: int = 1
    ) -> None:
        self._scene, self._meshes, self._threads = scene, meshes, threads
        self._lift_m, self._shadow_rays, self._rays = LIFT_OF_REACH * reach_m, shadow_rays, rays
        pattern, number = hemisphere_pattern(rays), np.arange(rays)
        # One of each `sets` that follow each other in height, and not the same one again, which has a like turn.
        self._patterns = [np.ascontiguousarray(pattern[:, (number + number // sets) % sets == k]) for k in range(sets)]
        self._offsets = disc_pattern()
        self._surfaces: BlockSurfaces | None = None
        self._eye = np.zeros(3, np.float32)
        self._hits: dict[int, Hits] = {}
        self._gathered: dict[int, Blocks] = {}
        llvmlite.binding.add_symbol(INTERSECT, function_address(INTERSECT))
        llvmlite.binding.add_symbol(OCCLUDED, function_address(OCCLUDED))

    def see(self, surfaces: BlockSurfaces, eye: np.ndarray) -> None:
        """Takes the surfaces of the pixels that stand for blocks, their normals for shading, and the eye (3,) in the world."""
        self._surfaces = surfaces
        self._eye = (eye - self._scene.origin).astype(np.float32)
        self._hits, self._gathered = {}, {}  # until they are asked for

    def gather(self, light: Light, ground: np.ndarray, which: int = 0) -> None:
        """Gathers set `which` under a light. ground: albedo (3,) of catchers."""
        assert self._surfaces is not None
        places, normals = self._surfaces
        pattern = self._patterns[which]
        if which not in self._hits:
            shape = (*places.shape[:2], pattern.shape[1], 3)
            self._hits[which] = hits = Hits(*(np.zeros(shape, np.float32) for _ in Hits._fields))
            self._over_rows(lambda rows: self._shoot(rows, pattern, hits))
        albedo = ground.astype(np.float32)
        hits, made = self._hits[which], Blocks(places, normals, np.zeros_like(places), np.zeros_like(places))
        numbers = np.arange(places.shape[0] * places.shape[1]).reshape(places.shape[:2])

        def own(rows: slice) -> None:
            ends = Hits(*(array[rows] for array in hits))
            radiance = np.empty_like(ends.places)
            footprints = np.zeros(ends.places.shape[:3], np.float32)
            if len(light.radii):
                footprints[:] = ((ends.places - places[rows, :, None]) ** 2).sum(axis=-1) / self._rays
            light_hits(
                self._scene.address, query(), ends, footprints, light, albedo, self._offsets, self._shadow_rays, numbers[rows], radiance
            )
            _sum_rays(radiance, Blocks(*(array[rows] for array in made)), pattern, self._eye, rows.start)

        self._over_rows(own)
        self._gathered[which] = made

    def received(self) -> Blocks:
        """What the blocks receive, smoothed: the mean over the sets that were gathered since the surfaces were seen."""
        assert self._surfaces is not None
        places, normals = self._surfaces
        irradiance, mirrored = (
            np.mean([getattr(each, name) for each in self._gathered.values()], axis=0) for name in ("irradiance", "mirrored")
        )
        smoothed = Blocks(places, normals, np.zeros_like(places), np.zeros_like(places))
        _smooth(Blocks(places, normals, irradiance, mirrored), self._eye, smoothed)
        return smoothed

    def warm(self) -> None:
        """Compiles, or loads, what a bounce takes."""
        block_pixels(np.zeros((4, 4, 3), np.float32), 4)
        nothing = np.zeros((1, 1, 3), np.float32)
        self.see(BlockSurfaces(nothing, nothing), np.zeros(3))
        self.gather(Light.of(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(1), NearLightSet.empty()), np.zeros(3))
        self.received()

    def _shoot(self, rows: slice, pattern: np.ndarray, hits: Hits) -> None:
        assert self._surfaces is not None
        surfaces, ends = (type(arrays)(*(array[rows] for array in arrays)) for arrays in (self._surfaces, hits))
        find_hits(self._scene.address, query(), surfaces, pattern, self._meshes, self._lift_m, rows.start, ends)

    def _over_rows(self, task: Callable[[slice], None]) -> None:
        """Runs a task for all rows of blocks, some at a time."""
        assert self._surfaces is not None
        rows = len(self._surfaces.places)
        tasks = [self._threads.submit(task, slice(first, min(first + ROWS_PER_TASK, rows))) for first in range(0, rows, ROWS_PER_TASK)]
        for each in tasks:
            each.result()


def disc_pattern() -> np.ndarray:
    """Points (OFFSETS, 2) float32 of a Gaussian of standard deviation 1, cut at 2.5 (of 1 - exp(-2.5^2 / 2) = 96 %)."""
    number = np.arange(OFFSETS)
    u = (number + 0.5) / OFFSETS * (1 - np.exp(-(2.5**2) / 2))
    radius, turn = np.sqrt(-2 * np.log(1 - u)), 2 * np.pi * GOLDEN * number
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=-1).astype(np.float32)


@kernel(nogil=True)
def block_pixels(normals, block):
    """Of each block of so many pixels a side the pixel in its middle, or else the first with a surface: its row and its column.

    Both (rows, columns) int64.
    """
    height, width, _ = normals.shape
    rows, columns = (height + block - 1) // block, (width + block - 1) // block
    chosen = np.empty((rows, columns), np.int64), np.empty((rows, columns), np.int64)
    for row in range(rows):
        for column in range(columns):
            top, left = row * block, column * block
            y, x = min(top + block // 2, height - 1), min(left + block // 2, width - 1)
            for k in range(block * block):
                if normals[y, x, 0] != 0 or normals[y, x, 1] != 0 or normals[y, x, 2] != 0:
                    break
                y, x = min(top + k // block, height - 1), min(left + k % block, width - 1)
            chosen[0][row, column], chosen[1][row, column] = y, x
    return chosen


@subroutine
def _hashed(number):
    """A number in 0 .. 1 that looks random, of 32 bits (Wellons' lowbias32)."""
    x = np.uint32(number)
    x = np.uint32((x ^ (x >> np.uint32(16))) * np.uint32(0x21F0AAAD))
    x = np.uint32((x ^ (x >> np.uint32(15))) * np.uint32(0x735A2D97))
    return np.float32((x ^ (x >> np.uint32(15))) * np.float32(2.0**-32))


@subroutine
def _near(light, i, place, footprint, nx, ny, nz):
    """Near light i from a place: its irradiance over its intensity, mean of a footprint, the direction to it (three numbers), the standard
    deviation of its directions along an axis, rad, and how far it is to its ball.

    At a height h over a plane a light gives h / (h^2 + x^2)^1.5 at x from its foot, and 2 / f^2 (1 - h / sqrt(h^2 + f^2)) on average over a
    disc of radius f there. That is what it gives from sqrt(h^2 + 3/4 f^2), to the fourth order in f / h; and from any height it gives the
    plane as much in all.
    """
    x, y, z = light.places[i, 0] - place[0], light.places[i, 1] - place[1], light.places[i, 2] - place[2]
    distance, radius = np.sqrt(x * x + y * y + z * z), light.radii[i]
    away, height = max(distance, LEAST_AWAY), nx * x + ny * y + nz * z
    blur = np.float32(0.75) * footprint
    far = np.sqrt(away * away + blur)
    reach = max(far, radius, LEAST_REACH)
    irradiance = np.sqrt(height * height + blur) / (far * reach * reach) if height > 0 else np.float32(0.0)
    x, y, z = x / away, y / away, z / away
    end = max(distance - radius, np.float32(0.0)) * (np.float32(1) - ENDS_BEFORE)
    return irradiance, x, y, z, np.float32(0.5) * radius / max(away, radius), end


@kernel(nogil=True)
def light_hits(scene, query, hits, footprints, light, ground, offsets, shadow_rays, numbers, radiance):
    """Fills the radiance (rows, columns, rays, 3) that the hits send back, of what they emit and of the lights that reach them.

    footprints: (rows, columns, rays) float32 m^2, squared radius of the disc that each hit stands for: near lights beside a surface make
    spots there that few rays meet. numbers: (rows, columns) int64, by which lights and places on them are drawn.
    """
    rows, columns, count, _ = hits.places.shape
    lights = len(light.luminance)
    brought, sent = np.empty(lights, np.float32), np.empty((PACKET, 3), np.float32)
    target = np.empty((PACKET, 3), np.int64)
    pending = np.int64(0)
    for row in range(rows):
        for column in range(columns):
            for ray in range(count):
                for axis in range(3):
                    radiance[row, column, ray, axis] = hits.emission[row, column, ray, axis]
                total, facing = _weigh(hits, footprints, row, column, ray, light, brought)
                if not total > 0:
                    continue
                place = numbers[row, column] * count + ray
                step = total / shadow_rays
                following, summed = _hashed(place) * step, np.float32(0.0)
                for i in range(lights):
                    if not brought[i] > 0:
                        continue
                    summed += brought[i]
                    share = np.float32(1.0)
                    if facing > shadow_rays:  # drawn as often as steps fall into its part of the total
                        share = np.float32(0.0)
                        while following < summed:
                            share += step / brought[i]
                            following += step
                        if share == 0:
                            continue
                    received = share * brought[i] / light.luminance[i]  # over its irradiance, or its intensity
                    for axis in range(3):
                        albedo = hits.albedo[row, column, ray, axis]
                        albedo = ground[axis] if albedo < 0 else albedo
                        sent[pending, axis] = albedo / PI * light.irradiance[i, axis] * received
                    target[pending, 0], target[pending, 1], target[pending, 2] = row, column, ray
                    k = int(_hashed(place * 31 + i + 17) * len(offsets))
                    _aim(query, pending, hits, footprints, row, column, ray, light, i, offsets[k, 0], offsets[k, 1])
                    pending += 1
                    if pending == PACKET:
                        _deliver(scene, query, pending, target, sent, radiance)
                        pending = 0
    if pending:
        _deliver(scene, query, pending, target, sent, radiance)


@subroutine
def _weigh(hits, footprints, row, column, ray, light, brought):
    """Fills brought (n + m,) with the luminance that each light would bring to a hit; returns its sum and how many bring any."""
    nx, ny, nz = hits.normals[row, column, ray]
    total, facing, directional = np.float32(0.0), 0, len(light.spreads)
    for i in range(directional):
        cosine = nx * light.directions[i, 0] + ny * light.directions[i, 1] + nz * light.directions[i, 2]
        brought[i] = light.luminance[i] * max(cosine, np.float32(0.0))
        total += brought[i]
        facing += brought[i] > 0
    for i in range(directional, len(light.luminance)):
        received, _, _, _, _, _ = _near(light, i - directional, hits.places[row, column, ray], footprints[row, column, ray], nx, ny, nz)
        brought[i] = light.luminance[i] * received
        total += brought[i]
        facing += brought[i] > 0
    return total, facing


@subroutine
def _aim(query, k, hits, footprints, row, column, ray, light, i, u, v):
    """Sets ray k of a query to go from a hit to light i, where u and v, in standard deviations, are on it."""
    directional, at = len(light.spreads), hits.places[row, column, ray]
    if i < directional:
        dx, dy, dz = light.directions[i]
        spread, end = light.spreads[i], np.float32(np.inf)
    else:
        nx, ny, nz = hits.normals[row, column, ray]
        _, dx, dy, dz, spread, end = _near(light, i - directional, at, footprints[row, column, ray], nx, ny, nz)
    ax, ay, az, bx, by, bz = across(dx, dy, dz)
    p, q = spread * u, spread * v
    set_ray(query, k, at, dx + p * ax + q * bx, dy + p * ay + q * by, dz + p * az + q * bz)
    query.rays[FAR, k] = end


@subroutine
def _deliver(scene, query, pending, target, sent, radiance):
    """Adds what the rays of a packet bring where nothing is in their way."""
    for k in range(pending, PACKET):
        query.wanted[k] = 0
    occluded(query.wanted.ctypes.data, scene, query.rays.ctypes.data, query.arguments.ctypes.data)
    for k in range(pending):
        if query.rays[FAR, k] >= 0:
            for axis in range(3):
                radiance[target[k, 0], target[k, 1], target[k, 2], axis] += sent[k, axis] * query.context[PASSED + k]


@kernel(nogil=True)
def _sum_rays(radiance, blocks, pattern, eye, first_row):
    """Fills irradiance and mirrored radiance of rows of blocks from the radiance along their rays."""
    rows, columns, count, _ = radiance.shape
    for row in range(rows):
        for column in range(columns):
            nx, ny, nz = blocks.normals[row, column]
            if nx == 0 and ny == 0 and nz == 0:
                continue
            ax, ay, az, bx, by, bz = across(nx, ny, nz)
            place = blocks.places[row, column]
            vx, vy, vz = eye[0] - place[0], eye[1] - place[1], eye[2] - place[2]
            length = np.sqrt(vx * vx + vy * vy + vz * vz)
            height = (nx * vx + ny * vy + nz * vz) / length
            mx, my, mz = 2 * height * nx - vx / length, 2 * height * ny - vy / length, 2 * height * nz - vz / length
            own = pattern[PATTERN * ((first_row + row) % PATTERN) + column % PATTERN]
            weights = 0.0
            for ray in range(count):
                x, y, z = own[ray]
                cosine = mx * (x * ax + y * bx + z * nx) + my * (x * ay + y * by + z * ny) + mz * (x * az + y * bz + z * nz)
                weight = max(cosine, 0.0) ** MIRROR_EXPONENT
                weights += weight
                for axis in range(3):
                    blocks.irradiance[row, column, axis] += PI / count * radiance[row, column, ray, axis]
                    blocks.mirrored[row, column, axis] += weight * radiance[row, column, ray, axis]
            for axis in range(3):
                blocks.mirrored[row, column, axis] /= max(weights, 1e-9)


@kernel
def _smooth(blocks, eye, smoothed):
    """Fills irradiance and mirrored radiance with their means over those of 3 x 3 blocks that lie on the same surface.

    The weights, 1 2 1 each way, give all sets of directions the same part.
    """
    rows, columns, _ = blocks.places.shape
    for row in range(rows):
        for column in range(columns):
            normal, place = blocks.normals[row, column], blocks.places[row, column]
            if normal[0] == 0 and normal[1] == 0 and normal[2] == 0:
                continue
            reach = 0.0
            for axis in range(3):
                reach += (place[axis] - eye[axis]) ** 2
            reach = SAME_PLANE * np.sqrt(reach)
            total = 0.0
            for y in range(max(row - 1, 0), min(row + 2, rows)):
                for x in range(max(column - 1, 0), min(column + 2, columns)):
                    cosine, off = 0.0, 0.0
                    for axis in range(3):
                        cosine += normal[axis] * blocks.normals[y, x, axis]
                        off += normal[axis] * (blocks.places[y, x, axis] - place[axis])
                    weight = (2 - abs(y - row)) * (2 - abs(x - column)) * max(cosine, 0.0) ** SAME_NORMAL * np.exp(-((off / reach) ** 2))
                    total += weight
                    for axis in range(3):
                        smoothed.irradiance[row, column, axis] += weight * blocks.irradiance[y, x, axis]
                        smoothed.mirrored[row, column, axis] += weight * blocks.mirrored[y, x, axis]
            for axis in range(3):
                smoothed.irradiance[row, column, axis] /= total
                smoothed.mirrored[row, column, axis] /= total
