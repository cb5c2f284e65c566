"""Shadow rays from the surfaces in a G-buffer to near lights: balls, seen from each surface as a disc of radiance that is even over it.

A ball of radius r and radiance L has the intensity pi r^2 L, and a surface at the distance d that faces it receives pi L (r / d)^2 of it,
which is the intensity over d^2 whatever r is. So places on it are drawn evenly by projected solid angle, and each counts with its cosine.
"""

from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, read_only, subroutine
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.rays.hits import across
from vemlight.renderer.rays.packets import (
    ALIKE_RAD,
    COHERENT,
    DIRECTION,
    ENDS_BEFORE,
    INCOHERENT,
    LEAST_SENT,
    ORIGIN,
    TIME,
    new_packet,
    occluded,
    of_tile,
    place_packet,
    unanimous,
)
from vemlight.renderer.rays.soft_filter import SAME_NORMAL, SAME_PLANE, TILE
from vemlight.renderer.rays.soft_pattern import GOLDEN, STRATA, ball_pattern, live_ball_pattern
from vemlight.renderer.rays.tracing import RayTracer

BALL_AGREED = 1  # ray of each pixel after which a tile is done live where all agree: its 16 rays go to 16 places spread over the ball
LEAST_SINE = np.float32(1e-4)  # of a ball's radius as a surface sees it: a smaller one is a point; any value in 1e-5 .. 1e-3 does


class Balls(NamedTuple):
    """Lights to trace, float32. places: (n, 3) about the ray scene's origin. radii: (n,) m. turns: (n, 2), cosine and sine of the angle by
    which each turns the pattern, so that the lights' patterns average out."""

    places: np.ndarray
    radii: np.ndarray
    turns: np.ndarray

    @staticmethod
    def of(lights: NearLightSet, origin: np.ndarray) -> "Balls":
        """Near lights about an origin (3,) float64."""
        turn = 2 * np.pi * (lights.ids * GOLDEN % 1.0)
        arrays = (lights.at - origin, lights.radius, np.stack([np.cos(turn), np.sin(turn)], axis=-1))
        return Balls(*(np.ascontiguousarray(array, np.float32) for array in arrays))


class Seen(NamedTuple):
    """What a tile's pixels see of a ball: distances and sines of its radius (16,), 0 of a point and -1 from inside; axes (9, 16), unit, to
    its middle and two across."""

    distances: np.ndarray
    sines: np.ndarray
    axes: np.ndarray


def trace_near(tracer: RayTracer, lights: NearLightSet, sample: int = 0, samples: int = 1, whole: bool = True) -> np.ndarray:
    """The fraction of each light that arrives at each pixel of the surfaces that a tracer saw last, (n, height, width) uint8.

    sample: of each pixel's `samples`, which together have all rays. whole: as RayTracer.trace has it; otherwise 2 x 2 pixels have all rays
    together, and a pixel the mean of those about it on its surface. What is nearer to a light's middle than its radius takes nothing from
    it.
    """
    surfaces, balls = tracer.surfaces, Balls.of(lights, tracer.scene.origin)
    arriving = np.empty((len(lights.ids), *surfaces.distances.shape), np.uint8)
    offsets, agreed = (ball_pattern(sample, samples), STRATA) if whole else (live_ball_pattern(), BALL_AGREED)

    def own(rows: slice) -> None:
        seen = Seen(np.zeros(TILE * TILE, np.float32), np.zeros(TILE * TILE, np.float32), np.zeros((9, TILE * TILE), np.float32))
        _trace(tracer.scene.address, new_packet(), seen, surfaces.of(rows), balls, offsets, agreed, rows.start, arriving)

    tracer.in_rows(own)
    if whole:
        return arriving
    smoothed = np.empty_like(arriving)
    tracer.in_rows(lambda rows: _smooth(arriving, surfaces, balls.radii, rows.start, rows.stop, smoothed))
    return smoothed


def spread(arriving: np.ndarray, weights: np.ndarray, step: int) -> np.ndarray:
    """What arrives at each pixel (height, width) uint8 by what arrives at every `step`th one each way: the mean of the four about it, whose
    weights (height, width, 4) uint8 sum to 255 or, where nothing is seen, to 0."""
    spread_out = np.empty(weights.shape[:2], np.uint8)
    _spread(arriving, weights, step, spread_out)
    return spread_out


def warm(tracer: RayTracer) -> None:
    """Compiles, or loads, what near lights need; the tracer has seen surfaces."""
    spread(np.zeros((2, 2), np.uint8), read_only(np.zeros((4, 4, 4), np.uint8)), 2)
    trace_near(tracer, NearLightSet.of(np.zeros(1), np.ones((1, 3)), np.ones((1, 3)), np.ones(1), np.ones(1)), whole=False)


@kernel(nogil=True)
def _trace(scene, packet, seen, surfaces, balls, offsets, agreed, first, arriving):
    """Fills the rows of surfaces, from `first` on, of arriving (n, height, columns) uint8. agreed: how many rays of each pixel may settle a
    tile."""
    rows, columns = surfaces.distances.shape
    for top in range(0, rows, TILE):
        for left in range(0, columns, TILE):
            height, width = min(TILE, rows - top), min(TILE, columns - left)
            if not np.any(surfaces.distances[top : top + height, left : left + width]):
                arriving[:, first + top : first + top + height, left : left + width] = 0
                continue
            place_packet(packet, surfaces, top, left, height, width)
            for i in range(len(balls.radii)):
                _trace_ball(scene, packet, seen, balls, i, offsets, agreed)
                around = of_tile(packet)
                for y in range(height):
                    for x in range(width):
                        k = TILE * y + x
                        fraction = packet.received[k] / packet.sent[k] if packet.sent[k] > LEAST_SENT else around
                        arriving[i, first + top + y, left + x] = np.uint8(np.int32(np.float32(255) * fraction + np.float32(0.5)))


@subroutine
def _see(packet, seen, balls, i):
    """Has a tile see ball i; returns the greatest sine of its radius."""
    widest = np.float32(0)
    for k in range(TILE * TILE):
        x = balls.places[i, 0] - packet.rays[ORIGIN, k]
        y = balls.places[i, 1] - packet.rays[ORIGIN + 1, k]
        z = balls.places[i, 2] - packet.rays[ORIGIN + 2, k]
        distance = np.sqrt(x * x + y * y + z * z)
        seen.distances[k], seen.sines[k] = distance, np.float32(-1)
        if distance > balls.radii[i]:
            x, y, z = x / distance, y / distance, z / distance
            sine = balls.radii[i] / distance
            seen.sines[k] = sine if sine > LEAST_SINE else np.float32(0)
            widest = max(widest, seen.sines[k])
            ax, ay, az, bx, by, bz = across(x, y, z)
            for line, value in enumerate((x, y, z, ax, ay, az, bx, by, bz)):
                seen.axes[line, k] = value
    return widest


@subroutine
def _trace_ball(scene, packet, seen, balls, i, offsets, agreed):
    """Traces a tile's rays to places spread over ball i. sent, received: (16,), the rays above the surface, weighted with their cosines,
    and what came through; after `agreed` rays of each pixel no more are traced if all or none came through."""
    widest = _see(packet, seen, balls, i)
    cos, sin = balls.turns[i, 0], balls.turns[i, 1]
    alike = widest < ALIKE_RAD
    packet.arguments[0] = COHERENT if alike else INCOHERENT
    for k in range(TILE * TILE):
        packet.sent[k], packet.received[k] = 0, 0
    for turn in range(offsets.shape[0] if widest > 0 else 1):
        if turn >= agreed and unanimous(packet):
            break
        wanted = 0
        for k in range(TILE * TILE):
            packet.wanted[k] = 0
            sine = seen.sines[k]
            if sine < 0:  # inside
                packet.sent[k], packet.received[k] = 1, 1
                continue
            u = (cos * offsets[turn, 0, k] - sin * offsets[turn, 1, k]) * sine
            v = (sin * offsets[turn, 0, k] + cos * offsets[turn, 1, k]) * sine
            w = np.sqrt(max(np.float32(1) - u * u - v * v, np.float32(0)))
            cosine, flat = np.float32(0), np.float32(0)
            for axis in range(3):
                direction = w * seen.axes[axis, k] + u * seen.axes[3 + axis, k] + v * seen.axes[6 + axis, k]
                packet.rays[DIRECTION + axis, k] = direction
                cosine += packet.smooth[axis, k] * direction
                flat += packet.flat[axis, k] * direction
            weight = max(cosine, np.float32(0)) / max(w, LEAST_SENT)
            packet.sent[k] += weight
            packet.rays[TIME, k] = weight  # which Embree does not read
            if min(weight, flat) > 0:
                # Up to the ball: the nearer root of the distance to its middle.
                inside = max(sine * sine - u * u - v * v, np.float32(0))
                packet.far[k] = seen.distances[k] * (w - np.sqrt(inside)) * (np.float32(1) - ENDS_BEFORE)
                packet.wanted[k], packet.passed[k] = -1, 1
                wanted += 1
        if wanted:
            occluded(packet.wanted.ctypes.data, scene, packet.rays.ctypes.data, packet.arguments.ctypes.data)
            for k in range(TILE * TILE):
                if packet.wanted[k] != 0 and packet.far[k] >= 0:
                    packet.received[k] += packet.passed[k] * packet.rays[TIME, k]


@kernel(nogil=True)
def _spread(arriving, weights, step, spread_out):
    rows, columns = arriving.shape
    for y in range(weights.shape[0]):
        top, bottom = y // step, min(y // step + 1, rows - 1)
        for x in range(weights.shape[1]):
            left, right = x // step, min(x // step + 1, columns - 1)
            own = weights[y, x]
            total = np.int32(own[0]) + np.int32(own[1]) + np.int32(own[2]) + np.int32(own[3])
            value = np.int32(own[0]) * arriving[top, left] + np.int32(own[1]) * arriving[top, right]
            value += np.int32(own[2]) * arriving[bottom, left] + np.int32(own[3]) * arriving[bottom, right]
            spread_out[y, x] = np.uint8((value + total // 2) // max(total, np.int32(1)))


@kernel(nogil=True)
def _smooth(arriving, surfaces, radii, first, last, smoothed):
    """Fills the rows from first to last of smoothed (n, height, width) uint8: of lights with a radius the mean over the pixels about each
    on its surface, weighted 1 2 1 each way. That is the mean of the four squares of 2 x 2 in which it lies, each of which has all rays."""
    _, height, width = arriving.shape
    for i in range(len(radii)):
        for y in range(first, last):
            for x in range(width):
                own = np.int32(arriving[i, y, x])
                smoothed[i, y, x] = own
                if radii[i] == 0 or surfaces.distances[y, x] == 0:
                    continue
                mixed = False
                for k in range(max(y - 1, 0), min(y + 2, height)):
                    for j in range(max(x - 1, 0), min(x + 2, width)):
                        mixed |= arriving[i, k, j] != own
                if mixed:
                    smoothed[i, y, x] = _mean_about(arriving, surfaces, i, y, x)


@subroutine
def _mean_about(arriving, surfaces, i, y, x):
    _, height, width = arriving.shape
    normal, flat, place = surfaces.smooth_normals[y, x], surfaces.flat_normals[y, x], surfaces.places[y, x]
    near, total, count = SAME_PLANE * surfaces.distances[y, x], np.int32(0), np.int32(0)
    for k in range(max(y - 1, 0), min(y + 2, height)):
        for j in range(max(x - 1, 0), min(x + 2, width)):
            other, there = surfaces.smooth_normals[k, j], surfaces.places[k, j]
            alike = normal[0] * other[0] + normal[1] * other[1] + normal[2] * other[2]
            off = flat[0] * (there[0] - place[0]) + flat[1] * (there[1] - place[1]) + flat[2] * (there[2] - place[2])
            if alike >= SAME_NORMAL and abs(off) <= near:
                weight = np.int32(2 - abs(k - y)) * np.int32(2 - abs(j - x))
                total += weight * np.int32(arriving[i, k, j])
                count += weight
    return np.uint8((total + count // 2) // count)
