"""Between which distances perspective shadow maps hold depths."""

import numpy as np

from vemlight.renderer.gl.constants import NEAR_FRACTION

FAR_MARGIN = 1.01  # of the far plane, in distances of the scene's farthest corner; any value in 1.001 .. 1.1 does
QUARTER = 0.25  # of the meshes: all but a few are about the light, and a few small ones may be close to it. Any value in .1 .. .5 does


def depth_range(place: np.ndarray, corners: np.ndarray) -> tuple[float, float]:
    """The clipping distances, m, of maps drawn from a place (3,), of meshes in boxes of corners (m, 8, 3).

    They reach to the farthest corner, from a fraction of how far a quarter of the meshes reach: grounds of kilometres take no shadow from
    what stands near the light. What is so far that steps of depth show has next to none of its light.
    """
    farthest = np.linalg.norm(corners - place, axis=-1).max(axis=1)
    far_m = float(farthest.max()) * FAR_MARGIN
    return NEAR_FRACTION * float(np.quantile(farthest, QUARTER, method="lower")), far_m
