"""Lamps whose light field has been measured, as the settings name them: where a near light is located, they take its place."""

from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

MAX_MEASURED = 32  # of a run: each has shadow maps of its own
Coordinate = Annotated[float, Meta(ge=-1e6, le=1e6)]
Degrees = Annotated[float, Meta(ge=-360, le=360)]


class MeasuredLamp(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A light field (.exr) or far field (.ldt, .ies) that shines along its own +z, is rotated about x, y, z and stands `at` a place, m.

    within_m: of that place a near light is this lamp. lamp_set: of a .ldt with alternatives, from 1; 0: the first.
    """

    file: Annotated[str, Meta(min_length=1)]
    at: tuple[Coordinate, Coordinate, Coordinate]
    within_m: Annotated[float, Meta(gt=0, le=100)] = 0.3
    rotate: tuple[Degrees, Degrees, Degrees] = (0.0, 0.0, 0.0)
    lamp_set: Annotated[int, Meta(ge=0, le=100)] = 0

    def __post_init__(self) -> None:
        if not np.isfinite([*self.at, *self.rotate, self.within_m]).all():
            raise ValueError("a lamp has a number that is not finite")
