"""Small rigs and lights."""

import math
from typing import Literal

import numpy as np

from vemlight.fixtures.rig import Emitter, Fixture, Rig
from vemlight.light.light_set import LightSet

TARGET = (0.0, 0.0, 1.5)
RGB = (
    Emitter(name="red", xy=(0.690, 0.308), share=0.24), Emitter(name="green", xy=(0.190, 0.720), share=0.66),
    Emitter(name="blue", xy=(0.140, 0.050), share=0.10),
)  # fmt: skip
RGBAL = (*RGB, Emitter(name="amber", xy=(0.57, 0.42), share=0.3), Emitter(name="lime", xy=(0.40, 0.54), share=0.5))
BICOLOUR = (Emitter(name="warm", xy=(0.4578, 0.4101)), Emitter(name="cold", xy=(0.3127, 0.3290)))


def beam(number: int, direction, emitters=RGB, bits: Literal[8, 16] = 16, metres: float = 3.0) -> Fixture:
    """A fixture at `metres` from the target towards `direction`, behind the one before it in the universe."""
    at = np.add(TARGET, metres * np.asarray(direction, np.float64))
    return Fixture(
        name=f"beam {number}", at=(float(at[0]), float(at[1]), float(at[2])), candela=9000.0, beam_deg=30.0, emitters=emitters, bits=bits,
        address=1 + number * len(emitters) * bits // 8,
    )  # fmt: skip


def rig_of(fixtures, gain: float | Literal["auto"] = 1.0) -> Rig:
    return Rig(target=TARGET, gain=gain, fixture=tuple(fixtures))


def dome(count: int) -> np.ndarray:
    """(count, 3): directions on a golden spiral over the upper hemisphere."""
    z = 1 - (np.arange(count) + 0.5) / count
    phi = np.arange(count) * math.pi * (3 - math.sqrt(5))
    return np.stack([np.sqrt(1 - z * z) * np.cos(phi), np.sqrt(1 - z * z) * np.sin(phi), z], axis=1)


def light_set(directions, irradiance) -> LightSet:
    return LightSet.of(np.arange(len(irradiance)), np.asarray(directions), np.asarray(irradiance))
