"""A procedural day: clear sky, the sun's disc on its way, and clouds that drift before it.

All in float64: what machines differ by then lies far below the half floats of a frame.
"""

import math

import numpy as np
from numba import njit

from vemlight.capture.simulation.environment import Disc, Environment
from vemlight.light.sphere import direction_from_angles

HEIGHT, WIDTH = 256, 512  # of the lat-long image; the sun is not in it
SUN_RADIUS = math.radians(0.2665)  # as seen from the earth
SUN = np.array([5.2, 4.9, 4.4])  # irradiance on a plane that faces it, when no cloud stands before it
AZIMUTH_DEG, AZIMUTH_DEG_PER_S = 120.0, 12.0  # a day in a minute or so
ELEVATION_DEG, ELEVATION_SWING_DEG, ELEVATION_RAD_PER_S = 34.0, 12.0, 0.8
ZENITH, HORIZON = np.array([0.10, 0.19, 0.42]), np.array([0.42, 0.52, 0.66])  # radiance
CLOUD = np.array([0.85, 0.85, 0.87])
GROUND = np.array([0.10, 0.09, 0.07])
DRIFT_PER_S = (0.30, 0.11)  # of the clouds, in their own heights
CLOUD_SCALE = 1.6  # lumps in a height


class Sky:
    """Light that changes in time; `seed` chooses the clouds."""

    name = "sky"

    def __init__(self, seed: int):
        self._seed = np.uint32(seed)

    def surround(self, k: int, time_s: float, exposure_s: float) -> Environment:
        """See surround.Scene; nothing here changes within one exposure."""
        sun = sun_at(time_s)
        image = _image(HEIGHT, WIDTH, sun, time_s, self._seed, ZENITH, HORIZON, CLOUD, GROUND)
        clear = 1 - _cover(sun[0], sun[1], sun[2], time_s, self._seed)
        return Environment(image, [Disc(sun, SUN_RADIUS, SUN * (0.02 + 0.98 * clear**3))])


def sun_at(time_s: float) -> np.ndarray:
    """Unit vector (3,) to the sun."""
    elevation = math.radians(ELEVATION_DEG + ELEVATION_SWING_DEG * math.sin(ELEVATION_RAD_PER_S * time_s))
    return direction_from_angles(math.pi / 2 - elevation, math.radians(AZIMUTH_DEG + AZIMUTH_DEG_PER_S * time_s))


@njit(cache=True)
def _lattice(ix, iy, seed):
    # a number in [0, 1) for each point of a lattice: 32-bit mixing by odd constants and shifts
    h = np.uint32(ix * 374761393 + iy * 668265263) ^ seed
    h = np.uint32(np.uint32(h ^ np.uint32(h >> np.uint32(13))) * np.uint32(1274126177))
    return float(np.uint32(h ^ np.uint32(h >> np.uint32(16)))) / 4294967296.0


@njit(cache=True)
def _noise(x, y, seed):
    ix, iy = math.floor(x), math.floor(y)
    u, v = x - ix, y - iy
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    ix, iy = int(ix), int(iy)
    low = _lattice(ix, iy, seed) * (1 - u) + _lattice(ix + 1, iy, seed) * u
    high = _lattice(ix, iy + 1, seed) * (1 - u) + _lattice(ix + 1, iy + 1, seed) * u
    return low * (1 - v) + high * v


@njit(cache=True)
def _cover(x, y, z, time_s, seed):
    # cloud before the direction, 0 .. 1; the layer is a plane one height up, bent down a little at the horizon
    if z <= 0:
        return 0.0
    across = CLOUD_SCALE / (z + 0.12)
    px, py = x * across + DRIFT_PER_S[0] * CLOUD_SCALE * time_s, y * across + DRIFT_PER_S[1] * CLOUD_SCALE * time_s
    total = 0.0
    for octave in range(5):
        total += _noise(px * 2**octave, py * 2**octave, seed) / 2 ** (octave + 1)
    dense = min(max((total - 0.50) / 0.22, 0.0), 1.0)
    return dense * dense * (3 - 2 * dense)


@njit(cache=True)
def _image(height, width, sun, time_s, seed, zenith, horizon, cloud, ground):
    image = np.empty((height, width, 3))
    for i in range(height):
        theta = (i + 0.5) * math.pi / height
        for j in range(width):
            phi = math.pi - (j + 0.5) * 2 * math.pi / width
            x, y, z = math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)
            to_sun = x * sun[0] + y * sun[1] + z * sun[2]
            # light scattered forward: a narrow and a wide lobe round the sun
            glow = 1.5 * math.exp(40 * (to_sun - 1)) + 0.25 * math.exp(4 * (to_sun - 1))
            low = (1 - max(z, 0.0)) ** 4
            cover = _cover(x, y, z, time_s, seed)
            for c in range(3):
                if z > 0:
                    clear = zenith[c] * (1 - low) + horizon[c] * low + glow * (0.9 - 0.1 * c)
                    lit = cloud[c] * (0.55 + 0.45 * (0.5 + 0.5 * to_sun) + 0.8 * glow)
                    image[i, j, c] = clear * (1 - cover) + lit * cover
                else:
                    image[i, j, c] = ground[c]
    return image
