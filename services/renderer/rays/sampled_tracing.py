"""Shadow rays of a picture that is the mean over several samples of each pixel: at each as many as a light needs there.

At the first sample 4 x 4 pixels whose rays to a light agree with each other and with those of the tiles around are settled: the other
samples take what they found. Elsewhere, at the edges of shadows, each sample has its own rays.
"""

from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.renderer.rays.packets import keep_arriving, new_packet, place_packet, send
from vemlight.renderer.rays.soft_filter import SAME_NORMAL, SAME_PLANE, SEEN_DARK, SEEN_LIT, TILE, states_around
from vemlight.renderer.rays.soft_pattern import FEW, POINT, STRATA, soft_pattern
from vemlight.renderer.rays.surfaces import Surfaces
from vemlight.renderer.rays.tracing import RayTracer, TracedLights, trace_point

MIXED = SEEN_DARK | SEEN_LIT  # of a tile and a light: each sample traces it


class Settled(NamedTuple):
    """What the first sample found. states: (rows, columns, n) uint8, of each tile and light: SEEN_DARK, SEEN_LIT, or MIXED where it is not
    settled. surfaces: that it saw."""

    states: np.ndarray
    surfaces: Surfaces


def trace_first(tracer: RayTracer, lights: TracedLights, samples: int) -> tuple[np.ndarray, Settled]:
    """The fraction of each light that arrives at each pixel at the first of so many samples, (n, height, width) uint8, and what that
    settles. lights.rays: of a pixel to each at all samples; POINT is never settled."""
    surfaces, scene, count = tracer.surfaces, tracer.scene.address, len(lights.rays)
    height, width = surfaces.distances.shape
    arriving, tiles = np.empty((count, height, width), np.uint8), (-(-height // TILE), -(-width // TILE))
    offsets = soft_pattern(0, min(samples, FEW)).many
    found, states = (np.zeros((*tiles, count), np.uint8) for _ in range(2))
    tracer.in_rows(lambda rows: _trace_first(scene, new_packet(), surfaces, lights, offsets, rows.start, rows.stop, found, arriving))
    tracer.in_rows(lambda rows: _settle(found, rows.start, rows.stop, states))
    return arriving, Settled(states, surfaces)


def trace_next(tracer: RayTracer, lights: TracedLights, sample: int, samples: int, settled: Settled) -> np.ndarray:
    """The same at another sample."""
    scene, surfaces, offsets = tracer.scene.address, tracer.surfaces, soft_pattern(sample, samples).many
    arriving = np.empty((len(lights.rays), *surfaces.distances.shape), np.uint8)
    tracer.in_rows(lambda rows: _trace_mixed(scene, new_packet(), surfaces, lights, offsets, rows.start, rows.stop, *settled, arriving))
    return arriving


def warm(tracer: RayTracer) -> None:
    """Compiles, or loads, what such pictures need; the tracer has seen surfaces."""
    lights = TracedLights(np.zeros((2, 3), np.float32), np.ones((2, 2, 3), np.float32), np.array([POINT, STRATA]))
    trace_next(tracer, lights, 1, FEW, trace_first(tracer, lights, FEW)[1])


@subroutine(forceinline=True)
def _send_all(scene, packet, lights, i, offsets):
    """Traces a tile's rays to light i."""
    if lights.rays[i] == POINT:
        trace_point(scene, packet, lights.directions, i)
    else:
        packet.sent[:] = 0
        packet.received[:] = 0
        send(scene, packet, lights, i, offsets, 0, offsets.shape[0])


@kernel(nogil=True)
def _trace_first(scene, packet, surfaces, lights, offsets, first, last, found, arriving):
    """Fills rows from first to last of arriving, and found with what the rays of each tile met."""
    columns = surfaces.distances.shape[1]
    for top in range(first, last, TILE):
        for left in range(0, columns, TILE):
            height, width = min(TILE, last - top), min(TILE, columns - left)
            if not np.any(surfaces.distances[top : top + height, left : left + width]):
                arriving[:, top : top + height, left : left + width] = 0
                continue
            place_packet(packet, surfaces, top, left, height, width)
            for i in range(len(lights.rays)):
                _send_all(scene, packet, lights, i, offsets)
                keep_arriving(packet, top, left, height, width, arriving[i])
                lit, dark = np.uint8(0), np.uint8(0)
                for k in range(TILE * TILE):
                    lit |= np.uint8(packet.received[k] > 0)
                    dark |= np.uint8(packet.received[k] < packet.sent[k])
                found[top // TILE, left // TILE, i] = MIXED if lights.rays[i] == POINT else lit * SEEN_LIT + dark * SEEN_DARK


@kernel(nogil=True)
def _settle(found, first, last, states):
    """Fills the tiles of rows from first to last of states, also those that saw nothing: another sample may see a rim there.

    What is dark takes twice the reach: in a dark place the little that slips through is all there is.
    """
    wide = np.zeros(found.shape[2], np.uint8)
    for top in range(first, last, TILE):
        for column in range(found.shape[1]):
            around = states[top // TILE, column]
            states_around(found, top // TILE, column, 1, around)
            states_around(found, top // TILE, column, 2, wide)
            for i in range(len(wide)):
                if around[i] != SEEN_LIT:
                    around[i] = wide[i]


@subroutine
def _is_new(surfaces, seen, y, x):
    """Whether nothing of a pixel's surface was seen in the 3 x 3 about it."""
    height, width = surfaces.distances.shape
    normal, place, near = surfaces.smooth_normals[y, x], surfaces.places[y, x], SAME_PLANE * surfaces.distances[y, x]
    for j in range(max(y - 1, 0), min(y + 2, height)):
        for i in range(max(x - 1, 0), min(x + 2, width)):
            other, there = seen.smooth_normals[j, i], seen.places[j, i]
            off = normal[0] * (there[0] - place[0]) + normal[1] * (there[1] - place[1]) + normal[2] * (there[2] - place[2])
            cosine = normal[0] * other[0] + normal[1] * other[1] + normal[2] * other[2]  # 0 where nothing was seen
            if cosine > SAME_NORMAL and abs(off) < near:
                return False
    return True


@kernel(nogil=True)
def _trace_mixed(scene, packet, surfaces, lights, offsets, first, last, states, seen, arriving):
    """Fills rows from first to last of arriving: as tiles are settled, or else, and where they see surfaces that were not seen, by rays."""
    columns = surfaces.distances.shape[1]
    for top in range(first, last, TILE):
        for left in range(0, columns, TILE):
            height, width = min(TILE, last - top), min(TILE, columns - left)
            if not np.any(surfaces.distances[top : top + height, left : left + width]):
                arriving[:, top : top + height, left : left + width] = 0
                continue
            new = False
            for y in range(top, top + height):
                for x in range(left, left + width):
                    new = new or (surfaces.distances[y, x] != 0 and _is_new(surfaces, seen, y, x))
            place_packet(packet, surfaces, top, left, height, width)
            for i in range(len(lights.rays)):
                state = MIXED if new else states[top // TILE, left // TILE, i]
                if state == MIXED:
                    _send_all(scene, packet, lights, i, offsets)
                    keep_arriving(packet, top, left, height, width, arriving[i])
                else:
                    code = np.uint8(255 if state == SEEN_LIT else 0)
                    for y in range(top, top + height):
                        for x in range(left, left + width):
                            arriving[i, y, x] = code
