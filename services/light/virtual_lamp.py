"""Lamps that nobody has set up: directional soft lights that are added to those of the map."""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.light.light_set import LightSet
from vemlight.light.mask import Azimuth, Elevation
from vemlight.light.sphere import direction_from_angles

MAX_LAMPS = 16  # as many fit into a control message beside every pose; 8 to 32 would do
VIRTUAL_IDS_FROM = 2**40  # of virtual lamps: no map's light ever gets so many, and four times it is exact in JSON
MAX_LAMP_ID = 2**20
Irradiance = Annotated[float, Meta(ge=0, le=1e12)]


class VirtualLamp(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A lamp at infinity: an even disc, size_deg across, that gives `irradiance` (RGB, the map's unit x sr) to a plane facing it.

    Azimuth from +X towards +Y. Its light has the id VIRTUAL_IDS_FROM + `id` from frame to frame.
    """

    id: Annotated[int, Meta(ge=1, le=MAX_LAMP_ID)]
    azimuth_deg: Azimuth
    elevation_deg: Elevation
    irradiance: tuple[Irradiance, Irradiance, Irradiance]
    size_deg: Annotated[float, Meta(ge=0, le=120)] = 10.0  # across; 0: a point

    def __post_init__(self) -> None:
        if not np.isfinite([self.azimuth_deg, self.elevation_deg, self.size_deg, *self.irradiance]).all():
            raise ValueError("a lamp has a number that is not finite")


def check_lamps(lamps: Sequence[VirtualLamp]) -> None:
    """Raises ValueError for two lamps with one id."""
    ids = [lamp.id for lamp in lamps]
    if repeated := [each for each in ids if ids.count(each) > 1]:
        raise ValueError(f"{repeated[0]} is the id of several lamps; give each its own")


def is_virtual(lights: LightSet) -> np.ndarray:
    """Which lights are virtual lamps', (n,) bool: also where each light stands as several points with four times its id."""
    return lights.ids >= VIRTUAL_IDS_FROM


def with_lamps(lights: LightSet, lamps: Sequence[VirtualLamp]) -> LightSet:
    """The lights and those of the lamps, which come last; soft where a lamp has a size."""
    if not lamps:
        return lights
    added = lights_of_lamps(lamps)
    extents = lights.covariances
    if extents is None and any(lamp.size_deg for lamp in lamps):
        extents = np.zeros((len(lights.ids), 6), np.float32)
    assert added.covariances is not None
    return LightSet(
        np.concatenate([lights.ids, added.ids]),
        np.concatenate([lights.directions, added.directions]),
        np.concatenate([lights.irradiance, added.irradiance]),
        None if extents is None else np.concatenate([extents, added.covariances]),
    )


def lights_of_lamps(lamps: Sequence[VirtualLamp]) -> LightSet:
    """Each lamp as a soft light with the mean and the covariance of its disc.

    Of a cap of half angle a, evenly bright: z = cos of the angle from its axis is even in [cos a, 1], so E[z] = (1 + c) / 2 with c = cos a,
    E[z^2] = (1 + c + c^2) / 3, and the variance is (1 - E[z^2]) / 2 along each axis across it. A plane that faces the light gets E[z] of
    all its light.
    """
    angles = np.radians([[90 - lamp.elevation_deg, lamp.azimuth_deg] for lamp in lamps]).reshape(-1, 2)
    axis = direction_from_angles(angles[:, 0], angles[:, 1])
    cosine = np.cos(np.radians([lamp.size_deg / 2 for lamp in lamps]))
    mean, square = (1 + cosine) / 2, (1 + cosine + cosine**2) / 3
    across, along = (1 - square) / 2, square - mean**2
    outer = axis[:, :, None] * axis[:, None, :]
    full = across[:, None, None] * (np.eye(3) - outer) + along[:, None, None] * outer
    light = np.array([lamp.irradiance for lamp in lamps]).reshape(-1, 3) / mean[:, None]
    ids = VIRTUAL_IDS_FROM + np.array([lamp.id for lamp in lamps], np.int64)
    return LightSet.of(ids, axis, light, full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]])
