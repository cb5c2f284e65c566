"""One frame's lights in one block of bytes, as the viewer's websocket sends it to browsers and Blender: docs/clients.md has both layouts.

Numbers are little-endian, and each array begins at a multiple of its numbers' size, so that a typed array of JavaScript can lie over it.
"""

import struct

import numpy as np

from vemlight.light.light_set import LightSet, NearLights
from vemlight.light.near_lights import NearLightSet
from vemlight.light.sphere import Coverage

KIND, LAYOUT = 3, 1  # the first two bytes: what the message is among the page's, and the version of what follows
PLACED_KIND = 4  # with near lights where they are
# kind, layout, floats of an extent for each light, coverage (0 hemisphere, 1 sphere), count, sequence, time_s
HEAD = struct.Struct("<4BI2d")
PLACE = struct.Struct("<3d2I")  # of PLACED_KIND, after HEAD: the place (m) that directional lights are true for, near lights, 0
NO_EXTENT, COVARIANCE = 0, 6  # floats; 1 is kept for a single standard deviation
COVERAGES: tuple[Coverage, ...] = ("hemisphere", "sphere")


def binary_from_lights(lights: LightSet, sequence: int, time_s: float, coverage: Coverage) -> bytes:
    """HEAD, then ids (count,) float64, directions and irradiance (count, 3) float32, covariances (count, 6) float32 or none."""
    return b"".join([_head(KIND, lights, sequence, time_s, coverage), _bytes(lights.ids, "<f8"), *_floats(lights)])


def placed_binary(lights: LightSet, near: NearLights | None, sequence: int, time_s: float, coverage: Coverage) -> bytes:
    """HEAD, PLACE, ids of the lights and of the near ones float64, then as above, then of the near ones at (m, 3), intensity (m, 3) and
    radius (m,) float32. `lights` are without them."""
    points, at = (near.points, near.at) if near else (NearLightSet.empty(), (0.0, 0.0, 0.0))
    place = PLACE.pack(*at, len(points.ids), 0)
    own = (_bytes(array, "<f4") for array in (points.at, points.intensity, points.radius))
    ids = _bytes(lights.ids, "<f8"), _bytes(points.ids, "<f8")
    return b"".join([_head(PLACED_KIND, lights, sequence, time_s, coverage), place, *ids, *_floats(lights), *own])


def _head(kind: int, lights: LightSet, sequence: int, time_s: float, coverage: Coverage) -> bytes:
    extent = NO_EXTENT if lights.covariances is None else COVARIANCE
    return HEAD.pack(kind, LAYOUT, extent, COVERAGES.index(coverage), len(lights.ids), sequence, time_s)


def _floats(lights: LightSet) -> list[bytes]:
    arrays = [lights.directions, lights.irradiance, *([] if lights.covariances is None else [lights.covariances])]
    return [_bytes(array, "<f4") for array in arrays]


def _bytes(array: np.ndarray, kind: str) -> bytes:
    return array.astype(kind).tobytes()
