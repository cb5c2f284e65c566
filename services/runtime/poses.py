"""Where objects and lamps of a scene stand, and from where it is seen."""

from typing import Annotated

import msgspec
from msgspec import Meta

from vemlight.runtime.wire_fields import Finite, Metres, Name

MAX_POSES = 128  # of a message: with names of 64 four-byte letters 45 kB of header
UNIT = 1e-3  # by which a quaternion's squared length may be off: three decimals of each number are enough
MIN_VIEW_M = 1e-9  # between an eye and what it looks at; any value in 1e-12 .. 1e-6 does


class Pose(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where a named object or lamp of the scene stands."""

    name: Name
    position: tuple[Metres, Metres, Metres]
    rotation: tuple[Finite, Finite, Finite, Finite] = (0.0, 0.0, 0.0, 1.0)  # unit quaternion x, y, z, w
    power: Annotated[float, Meta(ge=0, le=1e12)] | None = None  # of a lamp: times the measured one; None: unchanged, or not a lamp
    scale: Annotated[float, Meta(ge=1e-3, le=1e3)] = 1.0  # of an object, over its size in the scene file; lamps have none

    def __post_init__(self) -> None:
        if not abs(sum(q * q for q in self.rotation) - 1) < UNIT:
            raise ValueError("rotation is not a unit quaternion")


class View(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """From where a scene is seen: the eye, a point in the middle of the picture, and the angle between lower and upper edge, degrees."""

    eye: tuple[Metres, Metres, Metres] = msgspec.field(name="from")
    at: tuple[Metres, Metres, Metres]
    fov_y: Annotated[float, Meta(ge=1, le=170)]

    def __post_init__(self) -> None:
        if not max(abs(a - b) for a, b in zip(self.eye, self.at, strict=True)) > MIN_VIEW_M:
            raise ValueError("from and at are one point")
