"""Shadow rays from the surfaces in a G-buffer: what fraction of each light arrives at each pixel.

Rays go in packets of 16, those of 4 x 4 pixels to one light, and the lights follow each other while the pixels' places stay in the packet.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import llvmlite.binding
import numpy as np
from numba import types

from vemlight.kernels import kernel, subroutine
from vemlight.renderer.gl.constants import NORMAL_CODES
from vemlight.renderer.rays.embree import RayScene, function_address
from vemlight.renderer.rays.soft_filter import DARK, LIT, UNKNOWN, filter_rows
from vemlight.renderer.rays.soft_pattern import FEW, SoftPattern, soft_pattern
from vemlight.renderer.scene.materials import alpha_test_of
from vemlight.renderer.scene.scene import Scene

TILE = 4  # pixels on a side, 16 rays
TILE_ROWS_PER_TASK = 4  # a thread's; any value in 1 .. 16 does: short against the whole, long against handing it out
COHERENT = 1 << 16  # RTCRayQueryFlags: the rays of a packet are much alike
ALL_FEATURES = 0xFFFFFFFF
# Rays begin off their surface, along its flat normal. A place has float32's rounding of its depth and of the vertices' coordinates, 2^-24
# of either a few times over, and a flat normal is off by 16-bit codes and by differences of places: all that is below a tenth of this.
LIFT_OF_DISTANCE, LIFT_OF_REACH = 5e-6, 5e-7  # of the distance to the eye; of the farthest coordinate of the scene
ALIGNMENT = 64  # bytes, of what Embree reads in packets
# The lines of an RTCRay16, 16 numbers each.
ORIGIN, NEAR, DIRECTION, TIME, FAR, MASK, NUMBER, FLAGS, RAY_LINES = 0, 3, 4, 7, 8, 9, 10, 11, 12
PASSED = 16  # words into the query's context, behind what Embree keeps there: what fraction of each ray of a packet came through so far

# Compiled code finds Embree by this name, and so can be kept in numba's cache.
OCCLUDED = "rtcOccluded16"
_occluded = types.ExternalFunction(OCCLUDED, types.void(types.uintp, types.uintp, types.uintp, types.uintp))


class Surfaces(NamedTuple):
    """What the pixels of a picture see, (height, width, 3) float32: places about the ray scene's origin, lifted off the surface, flat and
    smooth normals on the viewer's side, zeros where there is no surface. distances: (height, width) float32, of the eye."""

    places: np.ndarray
    flat_normals: np.ndarray
    smooth_normals: np.ndarray
    distances: np.ndarray

    def of(self, rows: slice) -> "Surfaces":
        """Those of some rows."""
        return Surfaces(*(each[rows] for each in self))


class TracedLights(NamedTuple):
    """Lights to trace. directions: (n, 3) float32, unit, to the middle of each. axes: (n, 2, 3) float32, across it, each as long as the
    standard deviation of the light's directions along it; zeros for points. rays: (n,) int64 of a pixel to a soft light, 1, FEW or STRATA;
    what a single one finds is filtered over the pixel's neighbourhood."""

    directions: np.ndarray
    axes: np.ndarray
    rays: np.ndarray


class Packet(NamedTuple):
    """The memory in which a thread talks to Embree: which rays are wanted, the rays, the arguments of the query and its context."""

    wanted: np.ndarray
    rays: np.ndarray
    words: np.ndarray
    arguments: np.ndarray
    context: np.ndarray


class RayTracer:
    """Traces shadow rays through a scene from the surfaces that `see` was given last."""

    def __init__(self, scene: Scene, size: tuple[int, int]) -> None:
        """Raises UserError where Embree is not installed or has no memory for the scene."""
        self._holes = {}
        if any(alpha_test_of(mesh.material) for mesh in scene.meshes):
            from vemlight.renderer.rays.holes import let_through, scene_holes  # here, since most scenes do without this kernel

            self._holes = scene_holes(scene)
        filters = {k: (let_through.address, data.table.ctypes.data) for k, data in self._holes.items()}
        self._scene, self._size = RayScene(scene, filters), size
        self._reach_m = float(np.abs([scene.centre - scene.half, scene.centre + scene.half]).max())
        llvmlite.binding.add_symbol(OCCLUDED, function_address(OCCLUDED))
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._threads = ThreadPoolExecutor(cores, "rays")
        self._surfaces: Surfaces | None = None

    @property
    def scene(self) -> RayScene:
        """What it traces."""
        return self._scene

    @property
    def reach_m(self) -> float:
        """The farthest coordinate of the scene."""
        return self._reach_m

    @property
    def surfaces(self) -> Surfaces:
        """What `see` was given last."""
        assert self._surfaces is not None
        return self._surfaces

    def place(self, matrices: np.ndarray) -> None:
        """Moves the meshes: world_from_rest (n, 4, 4)."""
        self._scene.place(matrices)

    def see(self, depth: np.ndarray, normal_codes: np.ndarray, ray_from_pixel: np.ndarray, eye: np.ndarray) -> None:
        """Takes the surfaces of a G-buffer: depth (height, width) float32 in lengths of the pixel's ray, 0 where there is none; codes of
        normals (height, width, 4) uint16, the flat normal's last; the matrix (3, 3) from pixels to rays; the eye (3,), float64."""
        width, height = self._size
        surfaces = Surfaces(*(np.zeros((height, width, 3), np.float32) for _ in range(3)), np.zeros((height, width), np.float32))
        camera = np.concatenate([ray_from_pixel.T, [eye - self._scene.origin]])
        _decode(depth, normal_codes, camera, (LIFT_OF_DISTANCE, LIFT_OF_REACH * self._reach_m), surfaces)
        self._surfaces = surfaces

    def trace(self, lights: TracedLights, pattern: SoftPattern) -> np.ndarray:
        """The fraction of each light that arrives at each pixel, (n, height, width) uint8. pattern: where rays go on soft lights."""
        assert self._surfaces is not None
        width, height = self._size
        arriving = np.empty((len(lights.directions), height, width), np.uint8)
        filtered = np.flatnonzero((lights.rays == 1) & lights.axes.any(axis=(1, 2)))
        found = np.empty((height, width, len(filtered)), np.uint16)
        self._in_rows(lambda rows: self._trace_rows(lights, pattern, rows, arriving[:, rows], found[rows]))
        if len(filtered):
            surfaces = self._surfaces
            self._in_rows(lambda rows: filter_rows(found, surfaces, rows.start, rows.stop, filtered, arriving))
        return arriving

    def _in_rows(self, work: Callable[[slice], None]) -> None:
        """Does some work on all rows of tiles, by all threads."""
        height, step = self._size[1], TILE * TILE_ROWS_PER_TASK
        tasks = [self._threads.submit(work, slice(first, min(first + step, height))) for first in range(0, height, step)]
        for task in tasks:
            task.result()

    def _trace_rows(self, lights: TracedLights, pattern: SoftPattern, rows: slice, arriving: np.ndarray, found: np.ndarray) -> None:
        assert self._surfaces is not None
        _trace(self._scene.address, _packet(), self._surfaces.of(rows), lights, pattern, arriving, found)

    def warm(self) -> None:
        """Compiles, or loads, what a picture needs."""
        width, height = self._size
        self.see(np.zeros((height, width), np.float32), np.zeros((height, width, 4), np.uint16), np.eye(3), np.zeros(3))
        lights = TracedLights(np.zeros((2, 3), np.float32), np.ones((2, 2, 3), np.float32), np.array([1, FEW]))
        self.trace(lights, soft_pattern(0, 1))

    def release(self) -> None:
        """Ends its threads and frees the scene."""
        self._threads.shutdown()
        self._scene.release()


def _packet() -> Packet:
    rays, words, context = aligned(RAY_LINES * 16), aligned(16), aligned(PASSED + 16)
    arguments = words.view(np.uint32)
    arguments[:2] = COHERENT, ALL_FEATURES
    arguments[2:4] = np.array([context.ctypes.data], np.uint64).view(np.uint32)
    words[8] = 1.0  # times the radius of curves, of which there are none
    context.view(np.uint32)[:PASSED] = 0xFFFFFFFF  # of the instances that a ray is in: none
    return Packet(aligned(16).view(np.int32), rays.reshape(RAY_LINES, 16), rays.view(np.uint32).reshape(RAY_LINES, 16), arguments, context)


def aligned(count: int) -> np.ndarray:
    """Zeros (count,) float32 from a multiple of ALIGNMENT on."""
    block = np.zeros(4 * count + ALIGNMENT, np.uint8)
    first = -block.ctypes.data % ALIGNMENT
    return block[first : first + 4 * count].view(np.float32)


@kernel(nogil=True)
def _decode(depth, codes, camera, lifts, surfaces):
    """Fills Surfaces, zeros so far; camera: (4, 3), rows of ray_from_pixel's columns and the eye. lifts: a distance to the eye, and all."""
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            if not depth[y, x] > 0:
                continue
            flat = surfaces.flat_normals[y, x]
            _unfold(codes[y, x, 0], codes[y, x, 1], surfaces.smooth_normals[y, x])
            _unfold(codes[y, x, 2], codes[y, x, 3], flat)
            d, square = float(depth[y, x]), 0.0
            for axis in range(3):
                along = d * (camera[0, axis] * (x + 0.5) + camera[1, axis] * (y + 0.5) + camera[2, axis])
                square += along * along
                surfaces.places[y, x, axis] = camera[3, axis] + along
            surfaces.distances[y, x] = np.sqrt(square)
            lift = lifts[1] + lifts[0] * surfaces.distances[y, x]
            for axis in range(3):
                surfaces.places[y, x, axis] += lift * flat[axis]


@subroutine
def _unfold(first, second, normal):
    """The unit vector (3,) of an octahedron's 16-bit codes, as normals.py has it."""
    u, v = (first - (NORMAL_CODES + 1.0)) / NORMAL_CODES, (second - (NORMAL_CODES + 1.0)) / NORMAL_CODES
    z = 1.0 - abs(u) - abs(v)
    fold = max(-z, 0.0)
    u, v = u - np.copysign(fold, u), v - np.copysign(fold, v)
    length = np.sqrt(u * u + v * v + z * z)
    normal[0], normal[1], normal[2] = u / length, v / length, z / length


@kernel(nogil=True)
def _trace(scene, packet, surfaces, lights, pattern, arriving, found):
    """Fills arriving (n, rows, columns) uint8, and found (rows, columns, m) with what the ray of each pixel met on its way to those lights
    that are filtered: UNKNOWN, DARK or LIT."""
    rows, columns = arriving.shape[1:]
    flat, smooth = np.zeros((3, TILE * TILE), np.float32), np.zeros((3, TILE * TILE), np.float32)
    received, sent = np.zeros(TILE * TILE, np.float32), np.zeros(TILE * TILE, np.float32)
    for top in range(0, rows, TILE):
        for left in range(0, columns, TILE):
            height, width = min(TILE, rows - top), min(TILE, columns - left)
            _place_packet(packet, surfaces, top, left, height, width, flat, smooth)
            m = 0
            for i in range(len(lights.directions)):
                soft = _is_soft(lights.axes[i])
                filtered = soft and lights.rays[i] == 1
                if soft:
                    offsets = pattern.one if filtered else pattern.few if lights.rays[i] == FEW else pattern.many
                    _trace_soft(scene, packet, lights, i, offsets, flat, smooth, received, sent)
                else:
                    _trace_point(scene, packet, lights.directions[i], flat, received, sent)
                for y in range(height):
                    for x in range(width):
                        k = TILE * y + x
                        fraction = received[k] / sent[k] if sent[k] > 0 else np.float32(0)
                        arriving[i, top + y, left + x] = int(255 * fraction + np.float32(0.5))
                        if filtered:
                            found[top + y, left + x, m] = UNKNOWN if sent[k] == 0 else DARK if fraction < 0.5 else LIT
                m += filtered


@subroutine
def _is_soft(axes):
    """Whether a light's axes (2, 3) have any length."""
    return axes[0, 0] != 0 or axes[0, 1] != 0 or axes[0, 2] != 0 or axes[1, 0] != 0 or axes[1, 1] != 0 or axes[1, 2] != 0


@subroutine
def _trace_point(scene, packet, direction, flat, received, sent):
    """Traces a tile's rays to a point."""
    dx, dy, dz = direction[0], direction[1], direction[2]
    wanted = 0
    for k in range(TILE * TILE):
        facing = flat[0, k] * dx + flat[1, k] * dy + flat[2, k] * dz > 0
        packet.wanted[k] = -1 if facing else 0
        wanted += facing
        packet.rays[DIRECTION, k], packet.rays[DIRECTION + 1, k], packet.rays[DIRECTION + 2, k] = dx, dy, dz
    if wanted:
        _follow(scene, packet)
    for k in range(TILE * TILE):
        sent[k] = 1
        received[k] = packet.context[PASSED + k] if packet.wanted[k] != 0 and packet.rays[FAR, k] >= 0 else 0


@subroutine
def _trace_soft(scene, packet, lights, i, offsets, flat, smooth, received, sent):
    """Traces a tile's rays to places spread over light i, other ones in each pixel. sent, received: (16,), the rays above
    the surface, weighted with their cosines, and what came through."""
    received[:] = 0
    sent[:] = 0
    for turn in range(offsets.shape[1]):
        wanted = 0
        for k in range(TILE * TILE):
            u, v = offsets[k, turn, 0], offsets[k, turn, 1]
            dx = lights.directions[i, 0] + u * lights.axes[i, 0, 0] + v * lights.axes[i, 1, 0]
            dy = lights.directions[i, 1] + u * lights.axes[i, 0, 1] + v * lights.axes[i, 1, 1]
            dz = lights.directions[i, 2] + u * lights.axes[i, 0, 2] + v * lights.axes[i, 1, 2]
            scale = 1 / np.sqrt(dx * dx + dy * dy + dz * dz)
            cosine = (smooth[0, k] * dx + smooth[1, k] * dy + smooth[2, k] * dz) * scale
            facing = cosine > 0 and flat[0, k] * dx + flat[1, k] * dy + flat[2, k] * dz > 0
            sent[k] += max(cosine, np.float32(0))
            packet.wanted[k] = -1 if facing else 0
            wanted += facing
            packet.rays[DIRECTION, k], packet.rays[DIRECTION + 1, k], packet.rays[DIRECTION + 2, k] = dx * scale, dy * scale, dz * scale
            packet.rays[TIME, k] = cosine
        if wanted:
            _follow(scene, packet)
        for k in range(TILE * TILE):
            if packet.wanted[k] != 0 and packet.rays[FAR, k] >= 0:
                received[k] += packet.context[PASSED + k] * packet.rays[TIME, k]


@subroutine
def _place_packet(packet, surfaces, top, left, height, width, flat, smooth):
    """Has the rays of a packet begin at a tile's pixels; the normals (3, 16) become theirs, zeros where there is no pixel."""
    flat[:] = 0
    smooth[:] = 0
    for y in range(height):
        for x in range(width):
            k = TILE * y + x
            for axis in range(3):
                packet.rays[ORIGIN + axis, k] = surfaces.places[top + y, left + x, axis]
                flat[axis, k] = surfaces.flat_normals[top + y, left + x, axis]
                smooth[axis, k] = surfaces.smooth_normals[top + y, left + x, axis]


@subroutine
def _follow(scene, packet):
    """Traces the wanted rays of a packet: those that end at a surface have FAR < 0 then, and the context how much of the others passed."""
    for k in range(TILE * TILE):
        packet.rays[NEAR, k] = 0.0
        packet.rays[FAR, k] = np.inf
        packet.words[MASK, k] = 0xFFFFFFFF
        packet.words[NUMBER, k] = k
        packet.context[PASSED + k] = 1.0
    _occluded(packet.wanted.ctypes.data, scene, packet.rays.ctypes.data, packet.arguments.ctypes.data)
