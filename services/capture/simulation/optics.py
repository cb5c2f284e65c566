"""The virtual camera's optics: an environment in, fisheye images out.

A pixel's radiance is the mean over its footprint. Moderate light is gathered, by 4 x 4 rays a pixel; what exceeds it (a sun, perhaps
smaller than a pixel) is scattered point by point with its flux, so that nothing bright falls between two rays and nothing is counted twice.
"""

import math
from typing import NamedTuple

import numpy as np

from vemlight.capture.lens import Intrinsics, Lens, angle_from_radius, centred, decentred, pixel_solid_angles, radius_from_angle
from vemlight.capture.simulation.environment import DISC_POINTS, Environment, disc_points
from vemlight.kernels import kernel, subroutine

RAYS = 4  # on a side of a pixel; 3 to 8 do
BRIGHT = 16.0  # times the image's mean: light above is scattered by flux. Below, a missed ray costs a pixel its mean at most (1/16 of 16)
SCATTER_POINTS = 4  # on a side of a camera's pixel for scattered light; 2 to 8 do
BEYOND_RIM = 1.05  # times the rim: directions farther off meet no pixel that is lit; any value from 1.02, a pixel of 2 degrees, does


class Footprints(NamedTuple):
    """The image that is being taken, and what its pixels see."""

    image: np.ndarray  # (height, width, 3) float64, mean radiance
    solid: np.ndarray  # (height, width), sr; 0 beyond the rim
    lens: Intrinsics


def fisheye_radiance(environment: Environment, world_from_map: np.ndarray, lens: Lens) -> np.ndarray:
    """What the lens makes of the light, before vignetting: mean radiance of each pixel (height, width, 3) float64, 0 beyond the rim."""
    solid = pixel_solid_angles(lens)
    map_from_camera = world_from_map.T @ lens.rotation
    level = BRIGHT * environment.image.mean(axis=(0, 1))
    taken = Footprints(np.zeros((*solid.shape, 3)), solid, lens.intrinsics)
    if environment.image.any():
        _gather(environment.image, level, taken, map_from_camera)
    camera_from_map = np.ascontiguousarray(map_from_camera.T)
    points_per_side = math.ceil(SCATTER_POINTS * (math.pi / environment.image.shape[0]) * max(lens.f))
    _scatter_bright_pixels(environment.image, level, points_per_side, taken, camera_from_map)
    for disc in environment.discs:
        _scatter_points(disc_points(disc), disc.irradiance / DISC_POINTS, taken, camera_from_map)
    return taken.image


@kernel
def _gather(source, level, taken, rotation):
    # adds the mean of the source, up to `level`, over each pixel's rays
    rows, cols, _ = source.shape
    height, width = taken.solid.shape
    lens = taken.lens
    for y in range(height):
        for x in range(width):
            if taken.solid[y, x] == 0:
                continue
            for n in range(RAYS * RAYS):
                px = (x - 0.5 + (n % RAYS + 0.5) / RAYS - lens.cx) / lens.fx
                py = (y - 0.5 + (n // RAYS + 0.5) / RAYS - lens.cy) / lens.fy
                px, py = centred(px, py, lens)
                radius = math.hypot(px, py)
                theta = min(angle_from_radius(radius, lens), math.pi)
                across = math.sin(theta) / radius if radius > 0 else 0.0
                dx, dy, dz = px * across, py * across, math.cos(theta)
                mx = rotation[0, 0] * dx + rotation[0, 1] * dy + rotation[0, 2] * dz
                my = rotation[1, 0] * dx + rotation[1, 1] * dy + rotation[1, 2] * dz
                mz = rotation[2, 0] * dx + rotation[2, 1] * dy + rotation[2, 2] * dz
                row = min(int(math.atan2(math.hypot(mx, my), mz) / math.pi * rows), rows - 1)
                col = int((math.pi - math.atan2(my, mx)) / (2 * math.pi) * cols) % cols
                for q in range(3):
                    taken.image[y, x, q] += min(source[row, col, q], level[q]) / (RAYS * RAYS)


@subroutine
def _scatter(dx, dy, dz, flux, taken):
    # adds `flux` to the pixel in the camera's direction dx, dy, dz
    across = math.hypot(dx, dy)
    theta = math.atan2(across, dz)
    lens, solid = taken.lens, taken.solid
    if theta > lens.rim * BEYOND_RIM:
        return
    radius = radius_from_angle(theta, lens)
    scale = radius / across if across > 0 else 0.0
    u, v = decentred(dx * scale, dy * scale, lens)
    x, y = math.floor(lens.cx + lens.fx * u + 0.5), math.floor(lens.cy + lens.fy * v + 0.5)
    if 0 <= x < solid.shape[1] and 0 <= y < solid.shape[0] and solid[y, x] > 0:
        for q in range(3):
            taken.image[y, x, q] += flux[q] / solid[y, x]


@kernel
def _scatter_points(points, flux, taken, rotation):
    for n in range(len(points)):
        d = rotation @ points[n]
        _scatter(d[0], d[1], d[2], flux, taken)


@kernel
def _scatter_bright_pixels(source, level, points_per_side, taken, rotation):
    # what exceeds `level` in a pixel of the source, from points_per_side x points_per_side points of equal solid angle
    rows, cols, _ = source.shape
    flux = np.empty(3)
    for y in range(rows):
        top, bottom = math.cos(y * math.pi / rows), math.cos((y + 1) * math.pi / rows)
        solid = (top - bottom) * 2 * math.pi / cols / (points_per_side * points_per_side)
        for x in range(cols):
            exceeds = False
            for q in range(3):
                flux[q] = max(source[y, x, q] - level[q], 0.0) * solid
                exceeds |= flux[q] > 0
            if not exceeds:
                continue
            for v in range(points_per_side):
                mz = top + (v + 0.5) / points_per_side * (bottom - top)
                s = math.sqrt(1 - mz * mz)
                for u in range(points_per_side):
                    phi = math.pi - (x + (u + 0.5) / points_per_side) * 2 * math.pi / cols
                    mx, my = s * math.cos(phi), s * math.sin(phi)
                    dx = rotation[0, 0] * mx + rotation[0, 1] * my + rotation[0, 2] * mz
                    dy = rotation[1, 0] * mx + rotation[1, 1] * my + rotation[1, 2] * mz
                    dz = rotation[2, 0] * mx + rotation[2, 1] * my + rotation[2, 2] * mz
                    _scatter(dx, dy, dz, flux, taken)
