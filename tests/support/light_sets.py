"""Light sets of tests: lights from given directions and uniform skies."""

import numpy as np
import numpy.typing as npt

from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles


def lights_from(directions: npt.ArrayLike, irradiance: float | np.ndarray = 1.0) -> LightSet:
    """Grey lights from directions (n, 3) or (3,); irradiance in W m^-2, one for all or (n,)."""
    directions = np.atleast_2d(np.asarray(directions, float))
    power = np.broadcast_to(np.asarray(irradiance, float).reshape(-1, 1), (len(directions), 3))
    return LightSet.of(np.arange(len(directions)), directions, power)


def uniform_lights(count: int, lowest_z: float) -> LightSet:
    """The lights of a sky of radiance 1 over all directions with z > lowest_z: a Fibonacci spiral of equal solid angles."""
    z = lowest_z + (1 - lowest_z) * (np.arange(count) + 0.5) / count
    phi = np.arange(count) * np.pi * (3 - np.sqrt(5))
    return lights_from(direction_from_angles(np.arccos(z), phi), 2 * np.pi * (1 - lowest_z) / count)


def sky_and_sun(turn: float = 0.0, strength: float = 3.0) -> LightSet:
    """Twenty soft lights of the sky and a narrow sun."""
    k = np.arange(21) + 0.5
    directions = direction_from_angles(np.arccos(1 - 0.9 * k / 21), k * 2.4 + turn)
    irradiance = np.tile([0.1, 0.11, 0.13], (21, 1))
    irradiance[8] = strength
    spread = np.where(np.arange(21) == 8, 0.004, 0.2)
    across = np.eye(3) - directions[:, :, None] * directions[:, None]
    covariances = (across * spread[:, None, None] ** 2)[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    return LightSet.of(np.arange(21), directions, irradiance, covariances)


def some_lights(count: int, soft: bool) -> LightSet:
    """Seeded by their number, with ids beyond 32 bits."""
    random = np.random.default_rng(count)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    covariances = np.tile([1e-3, 0, 0, 2e-3, 0, 3e-3], (count, 1)) if soft else None
    return LightSet.of(random.permutation(count) + 2**40, directions, random.random((count, 3)), covariances)
