"""Regions of the sphere whose light is left out of a map or filled from around it, as settings and controls name them."""

from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

MAX_MASKS = 16  # a person, a tripod, some lamps; 8 to 64 would do
MAX_MASK_POINTS = 64  # of one
MAX_POINTS = 512  # of all: with every pose and lamp 59 kB of a control's header, which may have 64
MIN_POLYGON = 3

Azimuth = Annotated[float, Meta(ge=-360, le=360)]
Elevation = Annotated[float, Meta(ge=-90, le=90)]
MaskMode = Literal["fill", "dark"]


class Mask(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A region of directions, (azimuth, elevation) in degrees, azimuth from +X towards +Y: a polygon, or a stroke of a brush.

    Its edges are straight on the disc of the sky that has the zenith in its middle and the angle from it as its radius; a polygon that
    crosses itself is empty where it lies over itself. mode: "fill" puts in what lies smoothly between the light around, "dark" nothing.
    """

    points: Annotated[tuple[tuple[Azimuth, Elevation], ...], Meta(min_length=1, max_length=MAX_MASK_POINTS)]
    mode: MaskMode = "fill"
    width_deg: Annotated[float, Meta(ge=0, le=90)] = 0.0  # of the stroke along the points; 0: the points are a polygon's

    def __post_init__(self) -> None:
        if not self.width_deg and len(self.points) < MIN_POLYGON:
            raise ValueError(f"a mask's polygon has {MIN_POLYGON} points or more; give it more, or a width_deg, which makes it a stroke")


def check_masks(masks: Sequence[Mask]) -> None:
    """Raises ValueError for more points than a message holds."""
    if (count := sum(len(mask.points) for mask in masks)) > MAX_POINTS:
        raise ValueError(f"masks have {count} points together and {MAX_POINTS} are the most; draw them with fewer points")
