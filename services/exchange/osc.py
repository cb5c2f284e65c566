"""Lights as Open Sound Control 1.0, for Unreal, TouchDesigner, Max and others: bundles that fit a network's packets.

Each bundle begins with `/vemlight/frame` (sequence, count of the frame's lights), then has up to LIGHTS `/vemlight/light`: id, direction
x y z, irradiance r g b, angle in degrees. Numbers are big-endian; a bundle is "#bundle", a time tag (1: at once) and elements, each after
its length (M. Wright, "The Open Sound Control 1.0 Specification", 2002).
"""

import struct
from collections.abc import Iterator

import numpy as np

from vemlight.exchange.punctual import angles_deg
from vemlight.light.light_set import LightSet

LIGHTS = 20  # of a bundle
MAX_BYTES = 1400  # that pass as one packet through every common network: Ethernet's 1,500 less headers and tunnels
AT_ONCE = struct.pack(">8sQ", b"#bundle\0", 1)
NUMBERS = 2**31  # int32: ids and sequences beyond begin at 0 again


def _padded(text: bytes) -> bytes:
    """With a NUL at least and to a multiple of four."""
    return text + bytes(4 - len(text) % 4)


FRAME = _padded(b"/vemlight/frame") + _padded(b",ii")
LIGHT_HEAD = _padded(b"/vemlight/light") + _padded(b",ifffffff")
# A light with its length before it: "V" keeps the head's bytes.
LIGHT = np.dtype([("length", ">i4"), ("head", f"V{len(LIGHT_HEAD)}"), ("id", ">i4"), ("numbers", ">f4", 7)])


def osc_bundles(lights: LightSet, sequence: int) -> Iterator[bytes]:
    """The bundles of a frame, one at least."""
    elements = np.zeros(len(lights.ids), LIGHT)
    elements["length"] = LIGHT.itemsize - 4
    elements["head"] = np.void(LIGHT_HEAD)
    elements["id"] = lights.ids % NUMBERS
    elements["numbers"][:, :3], elements["numbers"][:, 3:6] = lights.directions, lights.irradiance
    elements["numbers"][:, 6] = angles_deg(lights)
    frame = FRAME + struct.pack(">2i", sequence % NUMBERS, len(lights.ids))
    head = AT_ONCE + struct.pack(">i", len(frame)) + frame
    for first in range(0, max(1, len(elements)), LIGHTS):
        yield head + elements[first : first + LIGHTS].tobytes()
