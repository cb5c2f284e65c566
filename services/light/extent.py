"""What the covariance of a soft light says: how wide its light is, which axes it has, how much less it gives to a plane than a point.

A light's directions d vary about their mean m by C = E[d d^T] - m m^T, weighted by luminance, so |m|^2 = 1 - trace C.
"""

from typing import NamedTuple

import numpy as np

from vemlight.light.light_set import LightSet


class Extents(NamedTuple):
    """spreads: (n,) float64 rad, standard deviation of a light's directions along an axis across it, the mean over the axes; 0 for points.

    concentrations: (n,) float64, the mean cosine of a light's directions with their middle: the irradiance of a plane that faces the light,
    as a fraction of the light's. axes: (n, 2, 3) float64, two axes across it, each as long as the standard deviation along it.
    """

    spreads: np.ndarray
    concentrations: np.ndarray
    axes: np.ndarray

    @staticmethod
    def of(lights: LightSet) -> "Extents":
        """The extents of lights; zeros for points."""
        count = len(lights.ids)
        if lights.covariances is None:
            return Extents(np.zeros(count), np.ones(count), np.zeros((count, 2, 3)))
        full = lights.covariances.astype(np.float64)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        trace = np.clip(np.trace(full, axis1=1, axis2=2), 0, 1)
        first, second = tangents(lights.directions.astype(np.float64))
        across = np.stack([first, second], axis=1)
        values, vectors = np.linalg.eigh(np.einsum("nia,nab,njb->nij", across, full, across))
        axes = np.einsum("nji,nja->nia", vectors, across) * np.sqrt(np.maximum(values, 0))[..., None]
        return Extents(np.sqrt(trace / 2), np.sqrt(1 - trace), axes)


POINTS = 4  # for a light with extent: they have its mean, its covariance and its irradiance
DIVIDED_RAD = 0.01  # a narrower light stays one point: its points would be nearer to each other than a texel of a shadow map of 256


def points_of_extents(lights: LightSet) -> LightSet:
    """Lights with extent as points, for shadows that know points alone: POINTS each, one standard deviation to either side along both axes
    of each, on a circle of sqrt(2) of it. Ids stay the same from frame to frame."""
    if lights.covariances is None:
        return lights
    extents = Extents.of(lights)
    wide = np.flatnonzero(extents.spreads >= DIVIDED_RAD)
    narrow = np.flatnonzero(extents.spreads < DIVIDED_RAD)
    signs = np.sqrt(2) * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    offsets = np.einsum("pa,nai->pni", signs, extents.axes[wide])
    spread = lights.directions[wide] * extents.concentrations[wide, None] + offsets
    spread /= np.linalg.norm(spread, axis=-1, keepdims=True)
    ids = np.concatenate([POINTS * lights.ids[narrow], *(POINTS * lights.ids[wide] + k for k in range(POINTS))])
    directions = np.concatenate([lights.directions[narrow], spread.reshape(-1, 3)])
    irradiance = np.concatenate([lights.irradiance[narrow], np.tile(lights.irradiance[wide] / POINTS, (POINTS, 1))])
    return LightSet.of(ids, directions, irradiance)


def tangents(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two axes (n, 3) across unit vectors (n, 3) that make a right-handed frame with them (Duff et al. 2017)."""
    x, y, z = directions.T
    sign = np.where(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    first = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    return first, np.stack([b, sign + y * y * a, -y], axis=-1)


def received(cosines: np.ndarray, extents: Extents) -> np.ndarray:
    """Irradiance of an unshadowed plane as a fraction of each light's, for the cosines (n,) of its normal with the lights.

    Of a point the cosine, 0 below the plane. Across a soft light's horizon the cosine's mean over a band of the light's variance: that of
    a box of half width sqrt(3) x spread, within 1 % of a Gaussian's.
    """
    width = np.maximum(np.sqrt(3) * extents.spreads, 1e-9)
    inside = np.clip(cosines + width, 0, 2 * width)
    soft = inside**2 / (4 * width) + np.maximum(cosines - width, 0)
    return extents.concentrations * np.where(extents.spreads > 0, soft, np.maximum(cosines, 0))
