"""Probes of the irradiance, by which lights are compared with the map: small surfaces, each behind a large occluder.

A probe is a surface's normal n and the normal h of a half-space of free sky: E = sum of irradiance x max(0, n . d) x v(h . d). v is a step
softened over +-2 degrees, since a shadow's edge is never sharper than that on a shadow map of 256 x 256 texels.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vemlight.kernels import kernel
from vemlight.light.colour import LUMINANCE_WEIGHTS
from vemlight.light.sphere import Coverage, cell_directions, cell_solid_angles

SOFTNESS = float(np.sin(np.radians(2.0)))


class Probes(NamedTuple):
    """normals, occluders: (k, 3) float64 unit vectors."""

    normals: np.ndarray
    occluders: np.ndarray


@lru_cache(maxsize=8)
def probes(count: int, coverage: Coverage) -> Probes:
    """A fixed set, evenly spread: normals over the part of the sphere that the map covers, occluders over the whole sphere."""
    # Kronecker sequence of the generalised golden ratio in four dimensions (the root of x^5 = x + 1): even in every prefix.
    steps = 1.1673039782614187 ** -np.arange(1.0, 5.0)
    u = (0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0
    return Probes(_on_sphere(u[:, 0] if coverage == "hemisphere" else 2 * u[:, 0] - 1, u[:, 1]), _on_sphere(2 * u[:, 2] - 1, u[:, 3]))


def _on_sphere(z: np.ndarray, turns: np.ndarray) -> np.ndarray:
    s = np.sqrt(1 - z * z)
    return np.stack([s * np.cos(2 * np.pi * turns), s * np.sin(2 * np.pi * turns), z], axis=-1)


def irradiance_of_lights(at: Probes, directions: np.ndarray, irradiance: np.ndarray) -> np.ndarray:
    """Luminance (k,) of the irradiance at the probes under lights with directions (n, 3) and irradiance (n, 3)."""
    result = np.zeros(len(at.normals))
    _gather(at.normals, at.occluders, np.ascontiguousarray(directions, np.float64), irradiance @ LUMINANCE_WEIGHTS, result)
    return result


def irradiance_of_map(at: Probes, radiance: np.ndarray, coverage: Coverage) -> np.ndarray:
    """Luminance (k,) of the irradiance at the probes under a polar map (rows, cols, 3) without invalid cells."""
    rows, cols, _ = radiance.shape
    cells = (radiance @ LUMINANCE_WEIGHTS) * cell_solid_angles(rows, cols, coverage)[:, None]
    lit = cells > 0
    result = np.zeros(len(at.normals))
    _gather(at.normals, at.occluders, cell_directions(rows, cols, coverage)[lit], cells[lit], result)
    return result


@kernel
def irradiance_of_unit_light(normal, occluder, direction):
    """Irradiance of the probe (normal, occluder) under a light of irradiance 1 in `direction`."""
    cosine = normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]
    if cosine <= 0:
        return 0.0
    height = occluder[0] * direction[0] + occluder[1] * direction[1] + occluder[2] * direction[2]
    return cosine * min(max(0.5 + 0.5 * height / SOFTNESS, 0.0), 1.0)


@kernel
def _gather(normals, occluders, directions, strength, result):
    for k in range(normals.shape[0]):
        total = 0.0
        for n in range(directions.shape[0]):
            total += strength[n] * irradiance_of_unit_light(normals[k], occluders[k], directions[n])
        result[k] = total
