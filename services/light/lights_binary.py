"""One frame's lights in one block of bytes, as the viewer's websocket sends it to browsers and Blender: docs/clients.md has its layout.

Numbers are little-endian, and each array begins at a multiple of its numbers' size, so that a typed array of JavaScript can lie over it.
"""

import struct

from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage

KIND, LAYOUT = 3, 1  # the first two bytes: what the message is among the page's, and the version of what follows
# kind, layout, floats of an extent for each light, coverage (0 hemisphere, 1 sphere), count, sequence, time_s
HEAD = struct.Struct("<4BI2d")
NO_EXTENT, COVARIANCE = 0, 6  # floats; 1 is kept for a single standard deviation
COVERAGES: tuple[Coverage, ...] = ("hemisphere", "sphere")


def binary_from_lights(lights: LightSet, sequence: int, time_s: float, coverage: Coverage) -> bytes:
    """HEAD, then ids (count,) float64, directions and irradiance (count, 3) float32, covariances (count, 6) float32 or none."""
    soft = lights.covariances is not None
    head = HEAD.pack(KIND, LAYOUT, COVARIANCE if soft else NO_EXTENT, COVERAGES.index(coverage), len(lights.ids), sequence, time_s)
    arrays = [lights.ids.astype("<f8"), lights.directions.astype("<f4"), lights.irradiance.astype("<f4")]
    if lights.covariances is not None:
        arrays.append(lights.covariances.astype("<f4"))
    return b"".join([head, *(array.tobytes() for array in arrays)])
