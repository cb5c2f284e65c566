"""A procedural day: clear sky, the sun's disc on its path, and clouds that drift in front of it.

Computed in float64, so that differences between machines stay far below the half floats of a frame. The constants are the look of the
scene; other values make another sequence.
"""

import math
from typing import NamedTuple

import numpy as np

from vemlight.capture.simulation.environment import Environment, SunDisc
from vemlight.kernels import kernel, subroutine
from vemlight.light.sphere import direction_from_angles

HEIGHT, WIDTH = 256, 512  # of the lat-long image, which does not contain the sun
SUN_RADIUS = math.radians(0.2665)  # as seen from the Earth
SUN = np.array([5.2, 4.9, 4.4])  # irradiance on a plane that faces it, when no cloud is in front of it
AZIMUTH_DEG, AZIMUTH_DEG_PER_S = 120.0, 12.0  # a day takes about a minute
ELEVATION_DEG, ELEVATION_SWING_DEG, ELEVATION_RAD_PER_S = 34.0, 12.0, 0.8
ZENITH, HORIZON = np.array([0.10, 0.19, 0.42]), np.array([0.42, 0.52, 0.66])  # radiance
CLOUD = np.array([0.85, 0.85, 0.87])
GROUND = np.array([0.10, 0.09, 0.07])
DRIFT_PER_S = (0.30, 0.11)  # of the clouds, in units of their height
CLOUD_SCALE = 1.6  # features per unit of height
OCTAVES = 5
SEEN_THROUGH_CLOUD = 0.02  # of the sun behind the densest cloud


class SkyState(NamedTuple):
    """What determines the sky at one moment."""

    sun: np.ndarray  # (3,) unit vector
    time_s: float
    seed: np.uint32


class Sky:
    """The day as a LightScene; `seed` chooses the clouds."""

    name = "sky"

    def __init__(self, seed: int):
        self._seed = np.uint32(seed)

    def environment(self, k: int, time_s: float, exposure_s: float) -> Environment:
        """See LightScene; motion within one exposure is neglected."""
        state = SkyState(sun_at(time_s), time_s, self._seed)
        clear = 1 - _cloud_cover(state.sun[0], state.sun[1], state.sun[2], time_s, self._seed)
        sun = SUN * (SEEN_THROUGH_CLOUD + (1 - SEEN_THROUGH_CLOUD) * clear**3)
        return Environment(_image(state), [SunDisc(state.sun, SUN_RADIUS, sun)])


def sun_at(time_s: float) -> np.ndarray:
    """Unit vector (3,) to the sun."""
    elevation = math.radians(ELEVATION_DEG + ELEVATION_SWING_DEG * math.sin(ELEVATION_RAD_PER_S * time_s))
    return direction_from_angles(math.pi / 2 - elevation, math.radians(AZIMUTH_DEG + AZIMUTH_DEG_PER_S * time_s))


@subroutine
def _lattice(ix, iy, seed):
    # a pseudorandom number in [0, 1) for each point of a lattice: 32-bit mixing by odd constants and shifts
    h = np.uint32(ix * 374761393 + iy * 668265263) ^ seed
    h = np.uint32(np.uint32(h ^ np.uint32(h >> np.uint32(13))) * np.uint32(1274126177))
    return float(np.uint32(h ^ np.uint32(h >> np.uint32(16)))) / 4294967296.0


@subroutine
def _noise(x, y, seed):
    # value noise (Perlin's smoothstep between lattice points), 0 .. 1
    ix, iy = math.floor(x), math.floor(y)
    u, v = x - ix, y - iy
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    ix, iy = int(ix), int(iy)
    low = _lattice(ix, iy, seed) * (1 - u) + _lattice(ix + 1, iy, seed) * u
    high = _lattice(ix, iy + 1, seed) * (1 - u) + _lattice(ix + 1, iy + 1, seed) * u
    return low * (1 - v) + high * v


@kernel
def _cloud_cover(x, y, z, time_s, seed):
    # cloud in a direction, 0 .. 1; the layer is a plane at height 1, curved down towards the horizon
    if z <= 0:
        return 0.0
    across = CLOUD_SCALE / (z + 0.12)
    px, py = x * across + DRIFT_PER_S[0] * CLOUD_SCALE * time_s, y * across + DRIFT_PER_S[1] * CLOUD_SCALE * time_s
    total = 0.0
    for octave in range(OCTAVES):
        total += _noise(px * 2**octave, py * 2**octave, seed) / 2 ** (octave + 1)
    dense = min(max((total - 0.50) / 0.22, 0.0), 1.0)
    return dense * dense * (3 - 2 * dense)


@kernel
def _image(state):
    # radiance (HEIGHT, WIDTH, 3) without the sun's disc
    image, sun = np.empty((HEIGHT, WIDTH, 3)), state.sun
    for i in range(HEIGHT):
        theta = (i + 0.5) * math.pi / HEIGHT
        for j in range(WIDTH):
            phi = math.pi - (j + 0.5) * 2 * math.pi / WIDTH
            x, y, z = math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)
            to_sun = x * sun[0] + y * sun[1] + z * sun[2]
            # forward scattering: a narrow and a wide lobe around the sun
            glow = 1.5 * math.exp(40 * (to_sun - 1)) + 0.25 * math.exp(4 * (to_sun - 1))
            low = (1 - max(z, 0.0)) ** 4
            cover = _cloud_cover(x, y, z, state.time_s, state.seed)
            for c in range(3):
                if z > 0:
                    clear = ZENITH[c] * (1 - low) + HORIZON[c] * low + glow * (0.9 - 0.1 * c)
                    lit = CLOUD[c] * (0.55 + 0.45 * (0.5 + 0.5 * to_sun) + 0.8 * glow)
                    image[i, j, c] = clear * (1 - cover) + lit * cover
                else:
                    image[i, j, c] = GROUND[c]
    return image
