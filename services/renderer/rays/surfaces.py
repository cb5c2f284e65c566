"""What the pixels of a picture see, as rays begin there: decoded from a G-buffer."""

from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.renderer.gl.constants import NORMAL_CODES

# Rays begin off their surface, along its flat normal. A place has float32's rounding of its depth and of the vertices' coordinates, 2^-24
# of either a few times over, and a flat normal is off by 16-bit codes and by differences of places: all that is below a tenth of this.
LIFT_OF_DISTANCE, LIFT_OF_REACH = 5e-6, 5e-7  # of the distance to the eye; of the farthest coordinate of the scene

GRAZING = 0.05  # cosine of a view's angle with the normal, below which a pixel covers over 20 times its width; 0.02 to 0.1 would do


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


@kernel(nogil=True)
def decode(depth, codes, camera, lifts, first, last, surfaces):
    """Fills rows from first to last of Surfaces, zeros so far; camera: (4, 3), rows of ray_from_pixel's columns and the eye. lifts: a
    distance to the eye, and all."""
    for y in range(first, last):
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


@kernel(nogil=True)
def pixel_steps(surfaces, camera, lifts, first, last, steps):
    """Fills rows from first to last of steps (height, width, 2, 3) float32, zeros so far: by how much a place moves along its flat surface
    for a pixel to the right and one down. camera, lifts: as `decode` has them.

    Zeros stay where half of them leads below what a neighbour sees, into a corner or behind what stands before, and at grazing views.
    """
    ray, across = np.empty(3), np.empty((2, 3))
    for y in range(first, last):
        for x in range(surfaces.distances.shape[1]):
            distance = surfaces.distances[y, x]
            if not distance > 0:
                continue
            flat, square, along = surfaces.flat_normals[y, x], 0.0, 0.0
            for axis in range(3):
                ray[axis] = camera[0, axis] * (x + 0.5) + camera[1, axis] * (y + 0.5) + camera[2, axis]
                square += ray[axis] * ray[axis]
                along += ray[axis] * flat[axis]
            if along > -GRAZING * np.sqrt(square):
                continue
            depth = distance / np.sqrt(square)
            for way in range(2):
                lean = (camera[way, 0] * flat[0] + camera[way, 1] * flat[1] + camera[way, 2] * flat[2]) / along
                for axis in range(3):
                    across[way, axis] = depth * (camera[way, axis] - lean * ray[axis])
            if _stays_before(surfaces, y, x, across, 0.5 * (lifts[1] + lifts[0] * distance)):
                for way in range(2):
                    for axis in range(3):
                        steps[y, x, way, axis] = across[way, axis]


@subroutine
def _stays_before(surfaces, y, x, across, slack):
    """Whether half a step to each of the eight sides is before what the neighbour there sees."""
    height, width = surfaces.distances.shape
    for j in range(max(y - 1, 0), min(y + 2, height)):
        for i in range(max(x - 1, 0), min(x + 2, width)):
            if surfaces.distances[j, i] == 0:
                continue
            before = 0.0
            for axis in range(3):
                there = surfaces.places[y, x, axis] + 0.5 * ((i - x) * across[0, axis] + (j - y) * across[1, axis])
                before += surfaces.flat_normals[j, i, axis] * (there - surfaces.places[j, i, axis])
            if before < -slack:
                return False
    return True


@subroutine
def _unfold(first, second, normal):
    """The unit vector (3,) of an octahedron's 16-bit codes, as normals.py has it."""
    u, v = (first - (NORMAL_CODES + 1.0)) / NORMAL_CODES, (second - (NORMAL_CODES + 1.0)) / NORMAL_CODES
    z = 1.0 - abs(u) - abs(v)
    fold = max(-z, 0.0)
    u, v = u - np.copysign(fold, u), v - np.copysign(fold, v)
    length = np.sqrt(u * u + v * v + z * z)
    normal[0], normal[1], normal[2] = u / length, v / length, z / length
