"""Shadow rays from the surfaces in a G-buffer: what fraction of each light arrives at each pixel.

Rays go in packets of 16, those of 4 x 4 pixels to one light, and the lights follow each other while the pixels' places stay in the packet.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import llvmlite.binding
import numpy as np
from numba import types

from vemlight.kernels import kernel, subroutine
from vemlight.renderer.gl.constants import NORMAL_CODES
from vemlight.renderer.rays.embree import RayScene, function_address
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

# Embree finds by this name what numba calls; compiled code with it can be kept in numba's cache.
OCCLUDED = "rtcOccluded16"
_occluded = types.ExternalFunction(OCCLUDED, types.void(types.uintp, types.uintp, types.uintp, types.uintp))


class Surfaces(NamedTuple):
    """What the pixels of a picture see, (height, width, 3) float32: places about the ray scene's origin, lifted off the surface, and flat
    normals on the viewer's side, zeros where there is no surface."""

    places: np.ndarray
    normals: np.ndarray


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
        self.normal_codes = np.zeros((*size[::-1], 4), np.uint16)  # of these surfaces

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
        surfaces = Surfaces(np.empty((height, width, 3), np.float32), np.empty((height, width, 3), np.float32))
        camera = np.concatenate([ray_from_pixel.T, [eye - self._scene.origin]])
        _decode(depth, normal_codes, camera, (LIFT_OF_DISTANCE, LIFT_OF_REACH * self._reach_m), surfaces)
        self._surfaces, self.normal_codes = surfaces, normal_codes

    def trace(self, directions: np.ndarray) -> np.ndarray:
        """The fraction of each light that arrives at each pixel, (n, height, width) uint8, for directions (n, 3) float32 to the lights."""
        assert self._surfaces is not None
        width, height = self._size
        arriving = np.empty((len(directions), height, width), np.uint8)
        step = TILE * TILE_ROWS_PER_TASK
        rows = [slice(first, min(first + step, height)) for first in range(0, height, step)]
        tasks = [self._threads.submit(self._trace_rows, directions, own, arriving) for own in rows]
        for task in tasks:
            task.result()
        return arriving

    def _trace_rows(self, directions: np.ndarray, rows: slice, arriving: np.ndarray) -> None:
        assert self._surfaces is not None
        own = Surfaces(self._surfaces.places[rows], self._surfaces.normals[rows])
        _trace(self._scene.address, _packet(), own, directions, arriving[:, rows])

    def warm(self) -> None:
        """Compiles, or loads, what a picture needs."""
        width, height = self._size
        self.see(np.zeros((height, width), np.float32), np.zeros((height, width, 4), np.uint16), np.eye(3), np.zeros(3))
        self.trace(np.zeros((1, 3), np.float32))

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
    """Fills Surfaces; camera: (4, 3), rows of ray_from_pixel's columns and the eye. lifts: a distance to the eye, and all."""
    for y in range(depth.shape[0]):
        for x in range(depth.shape[1]):
            surfaces.normals[y, x] = 0.0
            surfaces.places[y, x] = 0.0
            if not depth[y, x] > 0:
                continue
            u, v = (codes[y, x, 2] - (NORMAL_CODES + 1.0)) / NORMAL_CODES, (codes[y, x, 3] - (NORMAL_CODES + 1.0)) / NORMAL_CODES
            z = 1.0 - abs(u) - abs(v)
            fold = max(-z, 0.0)
            u, v = u - np.copysign(fold, u), v - np.copysign(fold, v)
            length = np.sqrt(u * u + v * v + z * z)
            rx = camera[0, 0] * (x + 0.5) + camera[1, 0] * (y + 0.5) + camera[2, 0]
            ry = camera[0, 1] * (x + 0.5) + camera[1, 1] * (y + 0.5) + camera[2, 1]
            rz = camera[0, 2] * (x + 0.5) + camera[1, 2] * (y + 0.5) + camera[2, 2]
            d = float(depth[y, x])
            off = (lifts[1] + lifts[0] * d * np.sqrt(rx * rx + ry * ry + rz * rz)) / length
            surfaces.normals[y, x, 0], surfaces.normals[y, x, 1], surfaces.normals[y, x, 2] = u / length, v / length, z / length
            surfaces.places[y, x, 0] = camera[3, 0] + d * rx + off * u
            surfaces.places[y, x, 1] = camera[3, 1] + d * ry + off * v
            surfaces.places[y, x, 2] = camera[3, 2] + d * rz + off * z


@kernel(nogil=True)
def _trace(scene, packet, surfaces, directions, arriving):
    """Fills arriving (n, rows, columns) uint8 for the lights of directions (n, 3)."""
    rows, columns = arriving.shape[1:]
    normals = np.zeros((3, TILE * TILE), np.float32)
    for top in range(0, rows, TILE):
        for left in range(0, columns, TILE):
            height, width = min(TILE, rows - top), min(TILE, columns - left)
            _place_packet(packet, surfaces, top, left, height, width, normals)
            for i in range(len(directions)):
                dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
                wanted = 0
                for k in range(TILE * TILE):
                    facing = normals[0, k] * dx + normals[1, k] * dy + normals[2, k] * dz > 0
                    packet.wanted[k] = -1 if facing else 0
                    wanted += facing
                    packet.rays[DIRECTION, k], packet.rays[DIRECTION + 1, k], packet.rays[DIRECTION + 2, k] = dx, dy, dz
                if wanted:
                    _follow(scene, packet)
                for y in range(height):
                    for x in range(width):
                        k = TILE * y + x
                        open_ = packet.wanted[k] != 0 and packet.rays[FAR, k] >= 0
                        arriving[i, top + y, left + x] = int(255 * packet.context[PASSED + k] + 0.5) if open_ else 0


@subroutine
def _place_packet(packet, surfaces, top, left, height, width, normals):
    """Has the rays of a packet begin at a tile's pixels; normals (3, 16) become theirs, zeros where there is no pixel."""
    normals[:] = 0
    for y in range(height):
        for x in range(width):
            k = TILE * y + x
            for axis in range(3):
                packet.rays[ORIGIN + axis, k] = surfaces.places[top + y, left + x, axis]
                normals[axis, k] = surfaces.normals[top + y, left + x, axis]


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
