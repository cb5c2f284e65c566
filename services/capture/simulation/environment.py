"""The light around a virtual camera: a lat-long image, and suns that are smaller than its pixels."""

import math
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from vemlight.kernels import kernel, subroutine
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import read_radiance
from vemlight.light.sphere import direction_from_angles, latlong_directions, latlong_solid_angles

SUN_GLARE = math.radians(2.5)  # around the brightest pixel of a photographed map, what belongs to its sun; 1 to 5 degrees do
DISC_POINTS = 4096  # that represent a disc, 64 across it: at an edge of pixels its flux divides to 2 %; 256 or more do
HORIZON_POINTS = 8  # on a side of a pixel that the horizon crosses: the total of an even map is then exact to 1e-4; 4 or more do


class SunDisc(NamedTuple):
    """A round source of even radiance."""

    direction: np.ndarray  # (3,) unit vector
    radius: float  # rad
    irradiance: np.ndarray  # (3,) on a plane that faces it


class Environment(NamedTuple):
    """The light from all directions at one moment."""

    image: np.ndarray  # (height, width, 3) float64, lat-long radiance
    discs: list[SunDisc]


def dimmed(environment: Environment, factor: float) -> Environment:
    """The same light, `factor` times as strong."""
    discs = [disc._replace(irradiance=disc.irradiance * factor) for disc in environment.discs]
    return Environment(environment.image * factor, discs)


class LightScene(Protocol):
    """Light that changes in time."""

    name: str

    def environment(self, k: int, time_s: float, exposure_s: float) -> Environment:
        """Mean light from `time_s` on over `exposure_s`; k is the number of the frame."""
        ...


class MapScene:
    """Lat-long files, one a frame, starting over after the last."""

    def __init__(self, paths: list[Path]):
        self.paths = paths
        self.name = paths[0].stem
        self._cached: tuple[Path, np.ndarray] | None = None

    def environment(self, k: int, time_s: float, exposure_s: float) -> Environment:
        """See LightScene. nan, inf and negative pixels are black, as no lens can see them. Raises UserError for a damaged file."""
        path = self.paths[k % len(self.paths)]
        if self._cached is None or self._cached[0] != path:
            image = read_radiance(path)[0].astype(np.float64)
            self._cached = path, np.where(np.isfinite(image) & (image > 0), image, 0.0)
        return Environment(self._cached[1], [])


def sun_direction(environment: Environment) -> np.ndarray:
    """Unit vector (3,) to the strongest disc, or to the centre of the light near the brightest pixel; +Z in darkness."""
    if environment.discs:
        return max(environment.discs, key=lambda disc: luminance_from_rgb(disc.irradiance)).direction
    height, width, _ = environment.image.shape
    y = luminance_from_rgb(environment.image)
    directions = latlong_directions(height, width)
    peak = directions[np.unravel_index(int(y.argmax()), y.shape)]
    flux = np.where(directions @ peak > math.cos(SUN_GLARE), y, 0.0) * latlong_solid_angles(height, width)[:, None]
    total = np.einsum("ij,ijc->c", flux, directions)
    length = np.linalg.norm(total)
    return total / length if length > 0 else np.array([0.0, 0.0, 1.0])


def disc_points(disc: SunDisc, count: int = DISC_POINTS) -> np.ndarray:
    """Unit vectors (count, 3) spread evenly over the disc (Vogel 1979, "A better way to construct the sunflower head")."""
    i = np.arange(count)
    # equal steps of 1 - cos(theta) are equal solid angles; the azimuth advances by the golden angle
    theta = 2 * np.arcsin(np.sqrt((i + 0.5) / count) * math.sin(disc.radius / 2))
    local = direction_from_angles(theta, i * (math.pi * (3 - math.sqrt(5))))
    not_parallel = np.array([1.0, 0, 0]) if abs(disc.direction[0]) < 0.9 else np.array([0, 1.0, 0])
    x = np.cross(disc.direction, not_parallel)
    x /= np.linalg.norm(x)
    return local @ np.stack([x, np.cross(disc.direction, x), disc.direction])


def hemisphere_irradiance(environment: Environment, world_from_map: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Integrals (3,) float64 over the upper hemisphere of the world: of the radiance, what a polar map's cells must add up to, and of
    radiance x cosine, the irradiance of level ground.
    """
    total, level = _upper_flux(environment.image, world_from_map)
    for disc in environment.discs:
        up = np.maximum(disc_points(disc) @ world_from_map[2], 0)
        total = total + disc.irradiance * np.mean(up > 0)
        level = level + disc.irradiance * np.mean(up)
    return total, level


@kernel
def _upper_flux(image, rotation):
    # pixels near the horizon count by the fraction of their points above it, others by their centre
    height, width, _ = image.shape
    total, level = np.zeros(3), np.zeros(3)
    reach = math.pi / height
    for y in range(height):
        top, bottom = math.cos(y * math.pi / height), math.cos((y + 1) * math.pi / height)
        solid = (top - bottom) * 2 * math.pi / width
        for x in range(width):
            up = _height_above_horizon((top + bottom) / 2, math.pi - (x + 0.5) * 2 * math.pi / width, rotation)
            fraction = 1.0 if up > 0 else 0.0
            if abs(up) < 2 * reach:
                fraction = 0.0
                for v in range(HORIZON_POINTS):
                    z = top + (v + 0.5) / HORIZON_POINTS * (bottom - top)
                    for u in range(HORIZON_POINTS):
                        phi = math.pi - (x + (u + 0.5) / HORIZON_POINTS) * 2 * math.pi / width
                        if _height_above_horizon(z, phi, rotation) > 0:
                            fraction += 1 / (HORIZON_POINTS * HORIZON_POINTS)
            for c in range(3):
                total[c] += fraction * solid * image[y, x, c]
                level[c] += max(up, 0.0) * solid * image[y, x, c]
    return total, level


@subroutine
def _height_above_horizon(z, phi, rotation):
    # z in the world of the map's direction with height z and azimuth phi
    s = math.sqrt(1 - z * z)
    return rotation[2, 0] * s * math.cos(phi) + rotation[2, 1] * s * math.sin(phi) + rotation[2, 2] * z
