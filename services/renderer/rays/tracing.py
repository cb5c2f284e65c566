"""Shadow rays from the surfaces in a G-buffer: what fraction of each light arrives at each pixel.

Rays go in packets of 16, those of 4 x 4 pixels to one light, and the lights follow each other while the pixels' places stay in the packet.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import llvmlite.binding
import numpy as np

from vemlight.kernels import kernel, read_only, subroutine
from vemlight.renderer.rays.embree import RayScene, function_address
from vemlight.renderer.rays.packets import (
    COHERENT,
    OCCLUDED,
    ORIGIN,
    TIME,
    alike,
    follow,
    keep_arriving,
    new_packet,
    place_packet,
    send,
    unanimous,
)
from vemlight.renderer.rays.soft_filter import DARK, LIT, TILE, UNKNOWN, filter_rows, tile_states
from vemlight.renderer.rays.soft_pattern import FEW, POINT, STRATA, SoftPattern, soft_pattern
from vemlight.renderer.rays.surfaces import LIFT_OF_DISTANCE, LIFT_OF_REACH, Surfaces, decode, pixel_steps
from vemlight.renderer.scene.materials import alpha_test_of
from vemlight.renderer.scene.scene import Scene

TILE_ROWS_PER_TASK = 4  # a thread's; any value in 1 .. 16 does: short against the whole, long against handing it out
# Rays of each pixel to a light after which a tile is done where all of its rays agree, and after which, of a narrow light, a pixel is where
# its own do and less than BUSY of the 3 x 3 about it are mixed: in the shadow of leaves four agree by chance. In wide penumbrae it shows.
TILE_AGREED, PIXEL_AGREED, BUSY = 2, 4, 2
# Of filtered lights, whose number is rounded up to that: the filter adds so many at a time.
TOGETHER = 16
AT_THE_MIDDLE = np.zeros((1, 2), np.float32)
NO_STEPS = np.zeros((0, 0, 2, 3), np.float32)  # of pixels none of whose lights has several rays


class TracedLights(NamedTuple):
    """Lights to trace. directions: (n, 3) float32, unit, to the middle of each. axes: (n, 2, 3) float32, across it, each as long as the
    standard deviation of the light's directions along it. rays: (n,) int64 of a pixel to it: POINT, one to its middle; 1, which stands for
    the pixel's neighbourhood, FEW or STRATA."""

    directions: np.ndarray
    axes: np.ndarray
    rays: np.ndarray


class RayTracer:
    """Traces shadow rays through a scene from the surfaces that `see` was given last."""

    def __init__(self, scene: Scene, size: tuple[int, int], beside: "RayTracer | None" = None) -> None:
        """beside: one for the same scene at another size, whose triangles and threads this uses.

        Raises UserError where Embree is not installed or has no memory for the scene.
        """
        self._size, self._owns = size, beside is None
        self._surfaces: Surfaces | None = None
        self._camera, self._steps = np.zeros((4, 3)), np.zeros((0, 0, 2, 3), np.float32)
        if beside:
            self._scene, self._reach_m, self._threads = beside._scene, beside._reach_m, beside._threads
            return
        self._holes = {}
        if any(alpha_test_of(mesh.material) for mesh in scene.meshes):
            from vemlight.renderer.rays.holes import let_through, scene_holes  # here, since most scenes do without this kernel

            self._holes = scene_holes(scene)
        filters = {k: (let_through.address, data.table.ctypes.data) for k, data in self._holes.items()}
        self._scene = RayScene(scene, filters)
        self._reach_m = float(np.abs([scene.centre - scene.half, scene.centre + scene.half]).max())
        llvmlite.binding.add_symbol(OCCLUDED, function_address(OCCLUDED))
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        self._threads = ThreadPoolExecutor(cores, "rays")

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
        self._surfaces = self.surfaces_of(depth, normal_codes, ray_from_pixel, eye)
        self._camera, self._steps = self._camera_of(ray_from_pixel, eye), self._steps[:0]

    def _camera_of(self, ray_from_pixel: np.ndarray, eye: np.ndarray) -> np.ndarray:
        return np.concatenate([ray_from_pixel.T, [eye - self._scene.origin]])

    @property
    def _lifts(self) -> tuple[float, float]:
        return LIFT_OF_DISTANCE, LIFT_OF_REACH * self._reach_m

    def surfaces_of(self, depth: np.ndarray, normal_codes: np.ndarray, ray_from_pixel: np.ndarray, eye: np.ndarray) -> Surfaces:
        """The surfaces of a G-buffer, as `see` takes it."""
        width, height = self._size
        places, flat, smooth = (np.zeros((height, width, 3), np.float32) for _ in range(3))
        surfaces = Surfaces(places, flat, smooth, np.zeros((height, width), np.float32))
        camera, lifts = self._camera_of(ray_from_pixel, eye), self._lifts
        self.in_rows(lambda rows: decode(depth, normal_codes, camera, lifts, rows.start, rows.stop, surfaces))
        return surfaces

    def _pixel_steps(self) -> np.ndarray:
        """As `pixel_steps` has them, of what `see` was given last."""
        surfaces, camera, lifts = self.surfaces, self._camera, self._lifts
        if not len(self._steps):
            steps = np.zeros((*surfaces.distances.shape, 2, 3), np.float32)
            self.in_rows(lambda rows: pixel_steps(surfaces, camera, lifts, rows.start, rows.stop, steps))
            self._steps = steps
        return self._steps

    def trace(self, lights: TracedLights, pattern: SoftPattern, whole: bool = True) -> np.ndarray:
        """The fraction of each light that arrives at each pixel, (n, height, width) uint8. pattern: where rays go on soft lights.

        whole: whether all rays are traced. Otherwise 4 x 4 pixels whose first rays to a light agree are done, which shows in faint fringes.
        The rays of a pixel to a light that has several begin all over the pixel, so that edges of shadows are smooth.
        """
        assert self._surfaces is not None
        width, height = self._size
        arriving = np.empty((len(lights.directions), height, width), np.uint8)
        filtered, agreed = np.flatnonzero(lights.rays == 1), STRATA if whole else TILE_AGREED
        found = np.zeros((height, width, -(-len(filtered) // TOGETHER) * TOGETHER), np.uint16)
        steps = self._pixel_steps() if np.any(lights.rays > 1) and pattern.within.any() else None
        self.in_rows(lambda rows: self._trace_rows(lights, pattern, rows, agreed, steps, arriving, found))
        if len(filtered):
            surfaces, states = self._surfaces, np.zeros((-(-height // TILE), -(-width // TILE), len(filtered)), np.uint8)
            self.in_rows(lambda rows: tile_states(found, rows.start, rows.stop, states))
            self.in_rows(lambda rows: filter_rows(found, states, surfaces, rows.start, rows.stop, filtered, arriving))
        return arriving

    def in_rows(self, work: Callable[[slice], None]) -> None:
        """Does some work on all rows of tiles, by all threads."""
        height, step = self._size[1], TILE * TILE_ROWS_PER_TASK
        tasks = [self._threads.submit(work, slice(first, min(first + step, height))) for first in range(0, height, step)]
        for task in tasks:
            task.result()

    def _trace_rows(
        self,
        lights: TracedLights,
        pattern: SoftPattern,
        rows: slice,
        agreed: int,
        steps: np.ndarray | None,
        arriving: np.ndarray,
        found: np.ndarray,
    ) -> None:
        own, spread = self.surfaces.of(rows), NO_STEPS if steps is None else steps[rows]
        _trace(self._scene.address, new_packet(), own, spread, lights, pattern, agreed, rows.start, arriving, found[rows])

    def warm(self) -> None:
        """Compiles, or loads, what a picture needs."""
        width, height = self._size
        depth, codes = np.zeros((height, width), np.float32), np.zeros((height, width, 4), np.uint16)
        self.see(read_only(depth), read_only(codes), np.eye(3), np.zeros(3))
        lights = TracedLights(np.zeros((3, 3), np.float32), np.ones((3, 2, 3), np.float32), np.array([POINT, 1, STRATA]))
        self.trace(lights, soft_pattern(0, 1))

    def release(self) -> None:
        """Ends its threads and frees the scene, unless they are another's."""
        if self._owns:
            self._threads.shutdown()
            self._scene.release()


@kernel(nogil=True)
def _trace(scene, packet, surfaces, steps, lights, pattern, agreed, first, arriving, found):
    """Fills the rows of surfaces, from `first` on, of arriving (n, height, columns) uint8, and found (rows, columns, m) with what the ray
    of each pixel met on its way to those lights that are filtered: UNKNOWN, so far everywhere, DARK or LIT. steps: (rows, columns, 2, 3) of
    pixels. agreed: how many rays of each pixel may settle a tile."""
    rows, columns = surfaces.distances.shape
    for top in range(0, rows, TILE):
        for left in range(0, columns, TILE):
            height, width = min(TILE, rows - top), min(TILE, columns - left)
            if not np.any(surfaces.distances[top : top + height, left : left + width]):
                arriving[:, first + top : first + top + height, left : left + width] = 0
                continue
            place_packet(packet, surfaces, top, left, height, width)
            packet.places[:] = packet.rays[ORIGIN : ORIGIN + 3]
            if len(steps):
                _step_packet(packet, steps, top, left, height, width)
            m = 0
            for i in range(len(lights.directions)):
                if lights.rays[i] == POINT:
                    trace_point(scene, packet, lights.directions, i)
                elif lights.rays[i] == 1:
                    _trace_soft(scene, packet, lights, i, pattern.one, AT_THE_MIDDLE, agreed)
                    for y in range(height):
                        for x in range(width):
                            k = TILE * y + x
                            lit = LIT if packet.received[k] > np.float32(0.5) * packet.sent[k] else DARK
                            found[top + y, left + x, m] = lit if packet.sent[k] > 0 else UNKNOWN
                    m += 1
                    continue
                elif lights.rays[i] == FEW:
                    _trace_soft(scene, packet, lights, i, pattern.few, pattern.within_few, agreed)
                else:
                    _trace_soft(scene, packet, lights, i, pattern.many, pattern.within, agreed)
                keep_arriving(packet, first + top, left, height, width, arriving[i])


@subroutine(forceinline=True)
def trace_point(scene, packet, directions, i):
    """Traces a tile's rays to a point; received: (16,), what came through."""
    x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
    wanted = 0
    for k in range(TILE * TILE):
        facing = packet.flat[0, k] * x + packet.flat[1, k] * y + packet.flat[2, k] * z > 0
        packet.wanted[k] = -1 if facing else 0
        wanted += packet.wanted[k]
        packet.x[k], packet.y[k], packet.z[k] = x, y, z
        packet.sent[k], packet.received[k] = 1, 0
    if wanted:
        packet.arguments[0] = COHERENT
        follow(scene, packet)
        for k in range(TILE * TILE):
            packet.received[k] = packet.passed[k] if packet.wanted[k] != 0 and packet.far[k] >= 0 else np.float32(0)


@subroutine
def _step_packet(packet, steps, top, left, height, width):
    """The steps of a tile's pixels become those of a packet."""
    packet.steps[:] = 0
    for y in range(height):
        for x in range(width):
            for axis in range(3):
                packet.steps[0, axis, TILE * y + x] = steps[top + y, left + x, 0, axis]
                packet.steps[1, axis, TILE * y + x] = steps[top + y, left + x, 1, axis]


@subroutine(forceinline=True)
def _begin_within(packet, right, down):
    """Has the rays of a packet begin beside the middles of their pixels."""
    for axis in range(3):
        for k in range(TILE * TILE):
            packet.rays[ORIGIN + axis, k] = packet.places[axis, k] + right * packet.steps[0, axis, k] + down * packet.steps[1, axis, k]


@subroutine(forceinline=True)
def _trace_soft(scene, packet, lights, i, offsets, within, agreed):
    """Traces a tile's rays to places spread over light i, other ones in each pixel, from places (k, 2) within the pixels. sent, received:
    (16,), the rays above the surface, weighted with their cosines, and what came through. After `agreed` rays of each pixel no more are
    traced if all or none came through."""
    packet.sent[:] = 0
    packet.received[:] = 0
    narrow = alike(lights, i)
    for turn in range(offsets.shape[0]):
        if turn >= agreed:
            if (turn == PIXEL_AGREED or (narrow and turn < PIXEL_AGREED)) and unanimous(packet):
                break
            if narrow and turn == PIXEL_AGREED:
                _finish_pixels(scene, packet, lights, i, offsets, within)
                break
        _begin_within(packet, within[turn, 0], within[turn, 1])
        send(scene, packet, lights, i, offsets, turn, turn + 1)
    _begin_within(packet, np.float32(0), np.float32(0))


@subroutine
def _finish_pixels(scene, packet, lights, i, offsets, within):
    """Traces the rays from PIXEL_AGREED on, those of a pixel together, where the first do not agree."""
    x, y, z = lights.directions[i, 0], lights.directions[i, 1], lights.directions[i, 2]
    ax, ay, az = lights.axes[i, 0, 0], lights.axes[i, 0, 1], lights.axes[i, 0, 2]
    bx, by, bz = lights.axes[i, 1, 0], lights.axes[i, 1, 1], lights.axes[i, 1, 2]
    for k in range(TILE * TILE):
        packet.mixed[k] = packet.received[k] > 0 and packet.received[k] < packet.sent[k]
    for pixel in range(TILE * TILE):
        mixed = 0
        for row in range(max(pixel // TILE - 1, 0), min(pixel // TILE + 2, TILE)):
            for column in range(max(pixel % TILE - 1, 0), min(pixel % TILE + 2, TILE)):
                mixed += packet.mixed[TILE * row + column]
        if packet.mixed[pixel] == 0 and mixed < BUSY:
            continue
        for k in range(TILE * TILE):
            packet.wanted[k] = 0
        for axis in range(3):
            for k in range(offsets.shape[0] - PIXEL_AGREED):
                right, down = within[PIXEL_AGREED + k, 0], within[PIXEL_AGREED + k, 1]
                aside = right * packet.steps[0, axis, pixel] + down * packet.steps[1, axis, pixel]
                packet.rays[ORIGIN + axis, k] = packet.places[axis, pixel] + aside
        for k in range(offsets.shape[0] - PIXEL_AGREED):
            u, v = offsets[PIXEL_AGREED + k, 0, pixel], offsets[PIXEL_AGREED + k, 1, pixel]
            packet.x[k], packet.y[k], packet.z[k] = x + u * ax + v * bx, y + u * ay + v * by, z + u * az + v * bz
            dx, dy, dz = packet.x[k], packet.y[k], packet.z[k]
            cosine = packet.smooth[0, pixel] * dx + packet.smooth[1, pixel] * dy + packet.smooth[2, pixel] * dz
            flat = packet.flat[0, pixel] * dx + packet.flat[1, pixel] * dy + packet.flat[2, pixel] * dz
            packet.rays[TIME, k] = max(cosine, np.float32(0))
            packet.sent[pixel] += packet.rays[TIME, k]
            packet.wanted[k] = -1 if min(cosine, flat) > 0 else 0
        follow(scene, packet)
        for k in range(offsets.shape[0] - PIXEL_AGREED):
            if packet.wanted[k] != 0 and packet.far[k] >= 0:
                packet.received[pixel] += packet.passed[k] * packet.rays[TIME, k]
