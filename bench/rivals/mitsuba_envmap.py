"""Mitsuba 3's own importance sampling of environment maps, fed with our points of the unit square.

Mitsuba puts row k of an image at theta = k pi / (rows - 1), so the map is registered anew: a row between two of ours is their mean. The
scalar variant is used, one sample at a time from Python: its accuracy is Mitsuba's, its time is not. Lights are equal in nothing but their
number: each carries radiance / density / N, and the channels' totals are then made exact.
"""

import mitsuba as mi  # pyright: ignore[reportMissingImports]
import numpy as np

from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage, map_irradiance
from vemlight.sampler.warps.points import points


def mitsuba_envmap(radiance: np.ndarray, coverage: Coverage, count: int) -> LightSet:
    """`count` lights of a polar map (rows, cols, 3)."""
    mi.set_variant("scalar_rgb")  # other rivals select another one
    clean = np.where(np.isfinite(radiance) & (radiance > 0), radiance, 0).astype(np.float32)
    total = map_irradiance(clean, coverage)
    if not total.any():
        return LightSet.of(np.arange(count), np.tile([0.0, 0.0, 1.0], (count, 1)), np.zeros((count, 3)))
    rows, cols, _ = clean.shape
    edges = np.concatenate([clean[:1], 0.5 * (clean[1:] + clean[:-1]), clean[-1:]])
    below = np.zeros((0 if coverage == "sphere" else rows, cols, 3), np.float32)
    emitter = {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(np.concatenate([edges, below])))}
    scene = mi.load_dict({"type": "scene", "emitter": emitter})
    at = mi.Interaction3f()
    directions, flux = np.empty((count, 3)), np.empty((count, 3))
    for k, (u, v) in enumerate(points(count, "halton")):
        found, weight = scene.sample_emitter_direction(at, mi.Point2f(u, v), False)
        directions[k] = -found.d.z, found.d.x, found.d.y  # Mitsuba's envmap has +Y up and u = 0 at -Z
        flux[k] = weight[0], weight[1], weight[2]
    if coverage == "hemisphere":
        directions[:, 2] = np.maximum(directions[:, 2], 0)  # the last row of the map reaches below the horizon by half a cell
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return LightSet.of(np.arange(count), directions, flux * total / np.where(flux.sum(axis=0) > 0, flux.sum(axis=0), 1))
