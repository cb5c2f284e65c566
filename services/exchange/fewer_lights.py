"""A coarser level of detail of a frame's lights, for slow links: the strongest ones, to which the others' light is added.

Each light that is left out joins the kept one nearest to it, so that each channel's sum stays; what results has the mean and, for soft
lights, the covariance of all that it stands for, and the kept one's id.
"""

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import MATRIX_OF_SIX, SIX_OF_MATRIX, LightSet

STAY = 1.25  # a light that was kept counts so much more, or two of like strength would take turns; 1.1 to 2 would do


def fewer_lights(lights: LightSet, count: int, kept_before: np.ndarray) -> LightSet:
    """At most `count` lights for the frame's. kept_before: (k,) int64, ids of the lights that the frame before kept."""
    if len(lights.ids) <= count:
        return lights
    power = luminance_from_rgb(lights.irradiance.astype(np.float64))
    rank = power * np.where(np.isin(lights.ids, kept_before), STAY, 1.0)
    kept = np.sort(np.argsort(-rank, kind="stable")[:count])
    directions = lights.directions.astype(np.float64)
    owner = np.argmax(directions @ directions[kept].T, axis=1)
    owner[kept] = np.arange(count)
    share = np.zeros((count, len(power)))
    share[owner, np.arange(len(power))] = power
    total = share.sum(axis=1, keepdims=True)
    share = np.divide(share, total, out=np.zeros_like(share), where=total > 0)
    share[np.arange(count), kept] += total[:, 0] <= 0  # dark ones stay where they are

    extents = np.zeros((len(power), 6)) if lights.covariances is None else lights.covariances.astype(np.float64)
    means = directions * np.sqrt(np.clip(1 - extents[:, [0, 3, 5]].sum(axis=1), 0, 1))[:, None]
    mean = share @ means
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    towards = np.where(length > 1e-6, mean / np.maximum(length, 1e-6), directions[kept])
    second = share @ (extents[:, np.ravel(MATRIX_OF_SIX)] + np.einsum("ni,nj->nij", means, means).reshape(-1, 9))
    covariances = (second - np.einsum("ni,nj->nij", mean, mean).reshape(-1, 9))[:, SIX_OF_MATRIX]
    irradiance = np.zeros((count, 3))
    np.add.at(irradiance, owner, lights.irradiance.astype(np.float64))
    return LightSet.of(lights.ids[kept], towards, irradiance, None if lights.covariances is None else covariances)


def error_of(fewer: LightSet, lights: LightSet) -> float:
    """RMS over all normals and RGB of the irradiance's difference, relative to that of `lights`, without shadows.

    In closed form: the integral over n of max(0, n.a) max(0, n.b) is (2/3) (sin g + (pi - g) cos g) with g the angle between a and b. Soft
    lights count as points at their direction, which their unshadowed light nearly is.
    """
    directions = np.concatenate([fewer.directions, lights.directions]).astype(np.float64)
    signed = np.concatenate([fewer.irradiance.astype(np.float64), -lights.irradiance.astype(np.float64)])
    cosine = np.clip(directions @ directions.T, -1, 1)
    kernel = np.sqrt(1 - cosine**2) + (np.pi - np.arccos(cosine)) * cosine
    difference = float(np.einsum("ic,ij,jc->", signed, kernel, signed))
    own = signed[len(fewer.ids) :]
    whole = float(np.einsum("ic,ij,jc->", own, kernel[len(fewer.ids) :, len(fewer.ids) :], own))
    return float(np.sqrt(max(difference, 0) / whole)) if whole > 0 else 0.0
