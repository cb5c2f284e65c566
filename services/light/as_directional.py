"""Near lights as directional ones, for formats and programs that know no places: true at one place, and the less the farther from it."""

import numpy as np

from vemlight.light.light_set import SIX_OF_MATRIX, LightSet, NearLights

NEAR_IDS = 2**30  # added to a near light's id, which may be that of a directional one; below what OSC and float64 hold


def as_directional(lights: LightSet, near: NearLights | None, place: np.ndarray | tuple[float, float, float] | None = None) -> LightSet:
    """The lights, and behind them the near ones as they are seen from `place` (3,) m; None: from where the lights are true.

    A light of radius r at distance d has the extent of an even disc of angular radius a = r / d, whose variance along each axis is a^2 / 4.
    """
    if near is None or not len(near.points.ids):
        return lights
    points, seen_from = near.points, np.asarray(near.at if place is None else place, np.float64)
    towards = points.at.astype(np.float64) - seen_from
    distance = np.linalg.norm(towards, axis=1)
    directions = np.where(distance[:, None] > 0, towards / np.maximum(distance, 1e-9)[:, None], [0.0, 0.0, 1.0])
    covariances = None
    if lights.covariances is not None:
        variance = np.minimum(points.radius / np.maximum(distance, 1e-9), 1.0) ** 2 / 4
        across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
        extents = (across * variance[:, None, None]).reshape(-1, 9)[:, SIX_OF_MATRIX]
        covariances = np.concatenate([lights.covariances, extents])
    return LightSet.of(
        np.concatenate([lights.ids, points.ids % NEAR_IDS + NEAR_IDS]),
        np.concatenate([lights.directions, directions]),
        np.concatenate([lights.irradiance, points.irradiance_at(seen_from)]),
        covariances,
    )
