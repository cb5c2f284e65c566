"""Browser's pictures beside the renderer's: lights for both, and by how much two pictures differ."""

import cv2
import numpy as np

from tests.support.light_sets import uniform_lights
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage, cell_directions, cell_solid_angles

EDGE = 0.2  # of a pixel's level, by which one of its eight neighbours differs where there is an edge, of a thing or of its shadow


def lights_of(count: int) -> LightSet:
    """Lights from above, of which the strongest has ten times the power of the weakest."""
    lights = uniform_lights(count, 0.05)
    levels = np.geomspace(0.3, 3, count)[:, None] / count * [[1.0, 0.9, 0.7]]
    return lights._replace(irradiance=np.random.default_rng(5).permutation(levels).astype(np.float32))


def off_edges(picture: np.ndarray) -> np.ndarray:
    """(h, w): where no neighbour differs much."""
    square = np.ones((3, 3), np.uint8)
    span = np.max([cv2.dilate(channel, square) - cv2.erode(channel, square) for channel in cv2.split(picture)], axis=0)
    return span < EDGE * picture.max(axis=2)


def relative_error(of_browser: np.ndarray, of_server: np.ndarray, least: float = 0.4) -> float:
    """Root mean square of the difference over that of the server's picture, off edges, which are no more than 1 - `least` of it."""
    where = off_edges(of_server)
    assert where.mean() > least
    return float(np.sqrt(np.mean((of_browser - of_server)[where] ** 2) / np.mean(of_server[where] ** 2)))


def sky_and_lights(coverage: Coverage) -> tuple[EnvironmentMap, LightSet]:
    """A sky with clouds and a sun of nine cells, and its lights: the sun, and 40 of which each has its part of the rest."""
    random, shape = np.random.default_rng(8), (90, 360) if coverage == "hemisphere" else (90, 180)
    clouds = cv2.GaussianBlur(random.lognormal(0, 1.5, shape), (0, 0), 5)
    radiance = (clouds[..., None] * np.array([0.6, 0.8, 1.2])).astype(np.float32)
    row, col = shape[0] // 4, shape[1] // 3
    radiance[row - 1 : row + 2, col - 1 : col + 2] += np.array([900.0, 800.0, 600.0], np.float32)
    directions, area = cell_directions(*shape, coverage), cell_solid_angles(*shape, coverage)
    power = radiance.astype(np.float64) * area[:, None, None]
    sun, sky = directions[row, col], uniform_lights(40, 0.0).directions
    of_sun = np.zeros(shape, bool)
    of_sun[row - 1 : row + 2, col - 1 : col + 2] = True
    nearest = np.argmax(directions.reshape(-1, 3) @ sky.T, axis=1)
    parts = np.stack([np.bincount(nearest, channel, 40) for channel in np.where(of_sun[..., None], 0, power).reshape(-1, 3).T], axis=1)
    lights = LightSet.of(
        np.arange(41) + 5, np.vstack([sun, sky]).astype(np.float32), np.vstack([power[of_sun].sum(axis=0), parts]).astype(np.float32)
    )
    return EnvironmentMap(radiance, coverage), lights
