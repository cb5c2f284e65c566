"""A directional light as other programs have it: a strength and a colour, a rotation, an angle that it covers."""

from typing import NamedTuple

import numpy as np

from vemlight.light.light_set import LightSet

SUN_DEG = 0.53  # the sun's diameter, below which no angle goes: USD's own default, and renderers make hard shadows of less
WHOLE_DEG = 180.0  # the largest angle of a USD DistantLight that lights a plane from its front


class Punctual(NamedTuple):
    """strength: (n,) float32, the largest channel of the irradiance. colour: (n, 3) float32, the irradiance over it; white where dark.

    rotation: (n, 4) float64 x, y, z, w, the shortest that turns +Z towards the light, so that -Z shines. angle_deg: (n,) float64, the
    diameter of a disc with the light's extent.
    """

    strength: np.ndarray
    colour: np.ndarray
    rotation: np.ndarray
    angle_deg: np.ndarray

    @staticmethod
    def of(lights: LightSet) -> "Punctual":
        """The lights in world space, z up."""
        strength = lights.irradiance.max(axis=1, initial=0)
        colour = np.divide(lights.irradiance, strength[:, None], out=np.ones_like(lights.irradiance), where=strength[:, None] > 0)
        return Punctual(strength, colour, rotations_to(lights.directions), angles_deg(lights))


def rotations_to(directions: np.ndarray) -> np.ndarray:
    """Unit quaternions (n, 4) float64 x, y, z, w that turn +Z to directions (n, 3); straight down is half a turn about +X.

    For d of length r the rotation is (r + d_z, -d_y, d_x, 0), w first, over its length. Near straight down r + d_z is taken as
    (d_x^2 + d_y^2) / (r - d_z), which keeps its digits.
    """
    x, y, z = np.ascontiguousarray(directions.T, np.float64)
    across = x * x + y * y
    length = np.sqrt(across + z * z)
    w = np.where(z < 0, across / (length + np.abs(z)), length + z)
    scale = np.sqrt(across + w * w)
    down = scale == 0
    scale[down] = 1
    rotations = np.zeros((len(x), 4))
    rotations[:, 0], rotations[:, 1], rotations[:, 3] = -y / scale, x / scale, w / scale
    rotations[down, 0] = 1
    return rotations


def angles_deg(lights: LightSet) -> np.ndarray:
    """Diameter in degrees (n,) float64 of the evenly bright disc whose directions have the light's mean; SUN_DEG to WHOLE_DEG.

    A cap of half angle R has a mean of length (1 + cos R) / 2, and a light's is sqrt(1 - trace C).
    """
    if lights.covariances is None:
        return np.full(len(lights.ids), SUN_DEG)
    trace = np.clip(lights.covariances[:, [0, 3, 5]].astype(np.float64).sum(axis=1), 0, 1)
    sin_half = np.sqrt(trace / (1 + np.sqrt(1 - trace)))  # (1 - cos R) / 2 = 1 - sqrt(1 - trace)
    return np.clip(4 * np.degrees(np.arcsin(np.minimum(sin_half, 1))), SUN_DEG, WHOLE_DEG)
