"""Packets of 16 rays, those of 4 x 4 pixels, as a thread and Embree exchange them."""

from typing import NamedTuple

import numpy as np
from numba import types

from vemlight.kernels import subroutine
from vemlight.renderer.rays.soft_filter import TILE

ALIGNMENT = 64  # bytes, of what Embree reads in packets
ALL_FEATURES = 0xFFFFFFFF
INCOHERENT, COHERENT = 0, 1 << 16  # RTCRayQueryFlags: whether the rays of a packet are much alike
# Spread of lights to which the rays of a packet are alike: .0008 rad saves a third of the time, .17 rad costs half of it.
ALIKE_RAD = np.float32(0.01)
LEAST_SENT = np.float32(1e-6)  # in place of 0 where it divides 0; any value in 1e-30 .. 1e-3 does
# Rays to a near light end so far before its ball, of their length: the surface of a lamp that is modelled at its radius takes nothing.
ENDS_BEFORE = np.float32(1e-4)
# The lines of an RTCRay16, 16 numbers each.
ORIGIN, NEAR, DIRECTION, TIME, FAR, MASK, NUMBER, FLAGS, RAY_LINES = 0, 3, 4, 7, 8, 9, 10, 11, 12
PASSED = 16  # words into the query's context, behind what Embree keeps there: what fraction of each ray of a packet came through so far

# Compiled code finds Embree by this name, and so can be kept in numba's cache.
OCCLUDED = "rtcOccluded16"
occluded = types.ExternalFunction(OCCLUDED, types.void(types.uintp, types.uintp, types.uintp, types.uintp))


class Packet(NamedTuple):
    """The memory in which a thread talks to Embree, 16 rays at a time, and what it keeps of a tile.

    wanted: (16,) int32, -1 for rays that are. rays: (RAY_LINES, 16) float32, an RTCRay16; x, y, z: its lines of directions; far: that of
    their ends. arguments: (16,) uint32, of the query. context: float32; passed: (16,) of it, what fraction of each ray came through.
    flat, smooth, places: (3, 16) float32, normals and where the tile's pixels are; steps: (2, 3, 16), from each to the pixel on its right
    and the one below. sent, received: (16,) float32, the rays of a light and what came through. codes, mixed: (16,) uint8.
    """

    wanted: np.ndarray
    rays: np.ndarray
    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    far: np.ndarray
    arguments: np.ndarray
    context: np.ndarray
    passed: np.ndarray
    flat: np.ndarray
    smooth: np.ndarray
    places: np.ndarray
    steps: np.ndarray
    sent: np.ndarray
    received: np.ndarray
    codes: np.ndarray
    mixed: np.ndarray


def new_packet() -> Packet:
    """The memory of a thread."""
    rays, words, context = aligned(RAY_LINES * 16).reshape(RAY_LINES, 16), aligned(16), aligned(PASSED + 16)
    arguments = words.view(np.uint32)
    arguments[1] = ALL_FEATURES
    arguments[2:4] = np.array([context.ctypes.data], np.uint64).view(np.uint32)
    words[8] = 1.0  # times the radius of curves, of which there are none
    context.view(np.uint32)[:PASSED] = 0xFFFFFFFF  # of the instances that a ray is in: none
    rays.view(np.uint32)[MASK], rays.view(np.uint32)[NUMBER] = 0xFFFFFFFF, np.arange(16)
    x, y, z, far = (rays[line] for line in (DIRECTION, DIRECTION + 1, DIRECTION + 2, FAR))
    flat, smooth, places = (np.zeros((3, 16), np.float32) for _ in range(3))
    steps = np.zeros((2, 3, 16), np.float32)
    sent, received = (np.zeros(16, np.float32) for _ in range(2))
    codes, mixed = (np.zeros(16, np.uint8) for _ in range(2))
    wanted, passed = aligned(16).view(np.int32), context[PASSED:]
    return Packet(wanted, rays, x, y, z, far, arguments, context, passed, flat, smooth, places, steps, sent, received, codes, mixed)


def aligned(count: int) -> np.ndarray:
    """Zeros (count,) float32 from a multiple of ALIGNMENT on."""
    block = np.zeros(4 * count + ALIGNMENT, np.uint8)
    first = -block.ctypes.data % ALIGNMENT
    return block[first : first + 4 * count].view(np.float32)


@subroutine(forceinline=True)
def unanimous(packet):
    """Whether everything that a tile sent to a light came through, or nothing."""
    dark, lit = 0, 0
    for k in range(TILE * TILE):
        sent, received = packet.sent[k], packet.received[k]
        lit += received > 0
        dark += received < sent
    return dark == 0 or lit == 0


@subroutine(forceinline=True)
def of_tile(packet):
    """The fraction of all rays of a tile that came through: what a pixel takes whose few rays live all went below its horizon."""
    sent, received = np.float32(0), np.float32(0)
    for k in range(TILE * TILE):
        sent += packet.sent[k]
        received += packet.received[k]
    return received / max(sent, LEAST_SENT)


@subroutine
def place_packet(packet, surfaces, top, left, height, width):
    """Has the rays of a packet begin at a tile's pixels; the normals become theirs, zeros where there is no pixel."""
    packet.flat[:] = 0
    packet.smooth[:] = 0
    for y in range(height):
        for x in range(width):
            k = TILE * y + x
            for axis in range(3):
                packet.rays[ORIGIN + axis, k] = surfaces.places[top + y, left + x, axis]
                packet.flat[axis, k] = surfaces.flat_normals[top + y, left + x, axis]
                packet.smooth[axis, k] = surfaces.smooth_normals[top + y, left + x, axis]


@subroutine(forceinline=True)
def send(scene, packet, lights, i, offsets, first, last):
    """Traces rays first to last of each pixel of a tile to places spread over light i; adds their weights, the cosines with the surface, to
    `sent`, and of those that came through to `received`."""
    x, y, z = lights.directions[i, 0], lights.directions[i, 1], lights.directions[i, 2]
    ax, ay, az = lights.axes[i, 0, 0], lights.axes[i, 0, 1], lights.axes[i, 0, 2]
    bx, by, bz = lights.axes[i, 1, 0], lights.axes[i, 1, 1], lights.axes[i, 1, 2]
    packet.arguments[0] = COHERENT if alike(lights, i) else INCOHERENT
    for turn in range(first, last):
        wanted = 0
        for k in range(TILE * TILE):
            u, v = offsets[turn, 0, k], offsets[turn, 1, k]
            packet.x[k], packet.y[k], packet.z[k] = x + u * ax + v * bx, y + u * ay + v * by, z + u * az + v * bz
        for k in range(TILE * TILE):
            dx, dy, dz = packet.x[k], packet.y[k], packet.z[k]
            cosine = packet.smooth[0, k] * dx + packet.smooth[1, k] * dy + packet.smooth[2, k] * dz
            flat = packet.flat[0, k] * dx + packet.flat[1, k] * dy + packet.flat[2, k] * dz
            weight = max(cosine, np.float32(0))
            packet.sent[k] += weight
            packet.rays[TIME, k] = weight
            packet.wanted[k] = -1 if min(weight, flat) > 0 else 0
            wanted += packet.wanted[k]
        if wanted:
            follow(scene, packet)
            for k in range(TILE * TILE):
                came = packet.passed[k] * packet.rays[TIME, k]
                packet.received[k] += came if packet.wanted[k] != 0 and packet.far[k] >= 0 else np.float32(0)


@subroutine(forceinline=True)
def alike(lights, i):
    """Whether the rays of a packet to light i are much alike."""
    ax, ay, az = lights.axes[i, 0, 0], lights.axes[i, 0, 1], lights.axes[i, 0, 2]
    bx, by, bz = lights.axes[i, 1, 0], lights.axes[i, 1, 1], lights.axes[i, 1, 2]
    return max(ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz) < ALIKE_RAD * ALIKE_RAD


@subroutine(forceinline=True)
def keep_arriving(packet, top, left, height, width, arriving):
    """Fills the pixels of a tile of arriving (rows, columns) uint8 with which fraction of what they sent came through."""
    around = of_tile(packet)
    for k in range(TILE * TILE):
        fraction = packet.received[k] / packet.sent[k] if packet.sent[k] > LEAST_SENT else around
        packet.codes[k] = np.uint8(np.int32(np.float32(255) * fraction + np.float32(0.5)))
    for y in range(height):
        for x in range(width):
            arriving[top + y, left + x] = packet.codes[TILE * y + x]


@subroutine(forceinline=True)
def follow(scene, packet):
    """Traces the wanted rays of a packet: those that end at a surface have `far` < 0 then; `passed` is what came through of the others."""
    for k in range(TILE * TILE):
        packet.far[k] = np.inf
        packet.passed[k] = 1
    occluded(packet.wanted.ctypes.data, scene, packet.rays.ctypes.data, packet.arguments.ctypes.data)
