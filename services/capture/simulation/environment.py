"""The light around a virtual camera: a lat-long image, and suns that are smaller than its pixels."""

import math
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numba import njit

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import read_radiance
from vemlight.light.sphere import direction_from_angles, latlong_directions, latlong_solid_angles

NEAR = math.radians(2.5)  # the sun of a photographed map: what lies this near its brightest pixel, glow of the lens included


class Disc(NamedTuple):
    """A round source of even radiance."""

    direction: np.ndarray  # (3,) unit vector
    radius: float  # rad
    irradiance: np.ndarray  # (3,) on a plane that faces it


class Environment(NamedTuple):
    """The light from everywhere at one moment."""

    image: np.ndarray  # (height, width, 3) float64, lat-long radiance
    discs: list[Disc]


def dimmed(surround: Environment, factor: float) -> Environment:
    """The same light, `factor` times as strong."""
    return Environment(surround.image * factor, [d._replace(irradiance=d.irradiance * factor) for d in surround.discs])


class Scene(Protocol):
    """Light that changes in time."""

    name: str

    def surround(self, k: int, time_s: float, exposure_s: float) -> Environment:
        """Mean light from `time_s` on over `exposure_s`; k is the number of the frame."""
        ...


class Maps:
    """Lat-long files, one a frame, again from the first after the last."""

    def __init__(self, paths: list[Path]):
        self.paths = paths
        self.name = paths[0].stem
        self._read: tuple[Path, np.ndarray] | None = None

    def surround(self, k: int, time_s: float, exposure_s: float) -> Environment:
        """See Scene. nan, inf and negative pixels are black: no lens would have seen them. Raises UserError for a damaged file."""
        path = self.paths[k % len(self.paths)]
        if self._read is None or self._read[0] != path:
            image = read_radiance(path)[0].astype(np.float64)
            self._read = path, np.where(np.isfinite(image) & (image > 0), image, 0.0)
        return Environment(self._read[1], [])


def sun_direction(surround: Environment) -> np.ndarray:
    """Unit vector (3,) to the strongest disc, or to the centre of the light near the brightest pixel; +Z in the dark."""
    if surround.discs:
        return max(surround.discs, key=lambda disc: luminance_from_rgb(disc.irradiance)).direction
    height, width, _ = surround.image.shape
    y = luminance_from_rgb(surround.image)
    directions = latlong_directions(height, width)
    peak = directions[np.unravel_index(int(y.argmax()), y.shape)]
    flux = np.where(directions @ peak > math.cos(NEAR), y, 0.0) * latlong_solid_angles(height, width)[:, None]
    total = np.einsum("ij,ijc->c", flux, directions)
    length = np.linalg.norm(total)
    return total / length if length > 0 else np.array([0.0, 0.0, 1.0])


def disc_points(disc: Disc, count: int) -> np.ndarray:
    """Unit vectors (count, 3) spread evenly over the disc (Vogel's spiral: equal areas, golden angle apart)."""
    i = np.arange(count)
    # equal steps of 1 - cos(theta) are equal solid angles
    theta = 2 * np.arcsin(np.sqrt((i + 0.5) / count) * math.sin(disc.radius / 2))
    local = direction_from_angles(theta, i * (math.pi * (3 - math.sqrt(5))))
    helper = np.array([1.0, 0, 0]) if abs(disc.direction[0]) < 0.9 else np.array([0, 1.0, 0])
    x = np.cross(disc.direction, helper)
    x /= np.linalg.norm(x)
    return local @ np.stack([x, np.cross(disc.direction, x), disc.direction])


def hemisphere_irradiance(surround: Environment, world_from_map: np.ndarray) -> np.ndarray:
    """Integral of the radiance over the upper hemisphere of the world, (3,) float64: what a polar map's cells must add up to."""
    total = _upper_flux(surround.image, world_from_map)
    for disc in surround.discs:
        total = total + disc.irradiance * np.mean(disc_points(disc, 4096) @ world_from_map[2] > 0)
    return total


@njit(cache=True)
def _upper_flux(image, rotation):
    # 8 x 8 points in each pixel near the horizon, one elsewhere
    height, width, _ = image.shape
    total = np.zeros(3)
    reach = math.pi / height
    for y in range(height):
        top, bottom = math.cos(y * math.pi / height), math.cos((y + 1) * math.pi / height)
        solid = (top - bottom) * 2 * math.pi / width
        for x in range(width):
            z, phi = (top + bottom) / 2, math.pi - (x + 0.5) * 2 * math.pi / width
            s = math.sqrt(1 - z * z)
            up = rotation[2, 0] * s * math.cos(phi) + rotation[2, 1] * s * math.sin(phi) + rotation[2, 2] * z
            share = 1.0 if up > 0 else 0.0
            if abs(up) < 2 * reach:
                share = 0.0
                for v in range(8):
                    z = top + (v + 0.5) / 8 * (bottom - top)
                    s = math.sqrt(1 - z * z)
                    for u in range(8):
                        phi = math.pi - (x + (u + 0.5) / 8) * 2 * math.pi / width
                        if rotation[2, 0] * s * math.cos(phi) + rotation[2, 1] * s * math.sin(phi) + rotation[2, 2] * z > 0:
                            share += 1 / 64
            for c in range(3):
                total[c] += share * solid * image[y, x, c]
    return total
