"""Which near lights a frame draws, and which of them are traced anew: values, without GL.

What arrives of a light is kept, a layer of 8 bits a pixel, until the light moves or anything else does.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import MAX_INTENSITY, NearLightSet
from vemlight.renderer.frame_budget import COARSE_WEIGHT, MIN_LIGHTS, octaves
from vemlight.renderer.gl.constants import MIN_DISTANCE_M, NEAR_BATCH
from vemlight.renderer.passes.shadow_maps.casters import PlacedCasters
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import SPARE_SLOTS

KEPT_RAD = np.radians(0.1)  # by which a light may turn about the scene before it is traced again, as of directional lights
STRONG = 0.3  # of all light: from it on a light is traced on all pixels where others are on coarse ones; at most three lights are
NARROW_RAD = 0.005  # radius of a ball as the scene sees it, below which its penumbrae are narrower than coarse pixels, and it is so, too
KEPT_RADIUS = 1 / 8  # of its radius, by which it may move or grow: its penumbra hides that
ROOMY = 4  # times the layers that lights need, beyond which they are laid out anew: so many fewer have maps of twice as many texels a side


class LitBy(NamedTuple):
    """What lights the surfaces of a frame."""

    lights: LightSet
    near: NearLightSet


class NearLayers(NamedTuple):
    """What each layer was traced for: ids (m,) int64; at (m, 3) float32, nan in an empty one; radius (m,) float32; coarse (m,) bool."""

    ids: np.ndarray
    at: np.ndarray
    radius: np.ndarray
    coarse: np.ndarray

    @staticmethod
    def empty(count: int) -> "NearLayers":
        at, radius = np.full((count, 3), np.nan, np.float32), np.zeros(count, np.float32)
        return NearLayers(np.full(count, -1), at, radius, np.zeros(count, bool))

    @property
    def filled(self) -> np.ndarray:
        """(m,) bool, whether each holds a light."""
        return ~np.isnan(self.at[:, 0])


class NearBatch(NamedTuple):
    """Near lights that are drawn together, the strongest first. layers: (n,) int64, that each reads, of `slots`. traced: (k,) int64, which
    of them are traced into theirs. coarse: (n,) bool, whether on coarse pixels."""

    lights: NearLightSet
    layers: np.ndarray
    slots: int
    traced: np.ndarray
    coarse: np.ndarray

    @property
    def trace_work(self) -> float:
        """How many lights on all pixels are as much work as those that are traced."""
        return float(trace_work(self.coarse[self.traced]).sum())


class NearInTime(NamedTuple):
    """A batch that traces some of its lights, the layers after it, and how many lights should have been traced."""

    batch: NearBatch
    layers: NearLayers
    stale: int

    @staticmethod
    def none() -> "NearInTime":
        nothing = np.zeros(0, np.int64)
        return NearInTime(NearBatch(NearLightSet.empty(), nothing, 0, nothing, np.zeros(0, bool)), NearLayers.empty(0), 0)

    @property
    def drawn(self) -> tuple[NearBatch, ...]:
        """The batch, if it has a light."""
        return (self.batch,) if len(self.batch.layers) else ()

    def kept(self, samples: Sequence[object]) -> NearLayers | None:
        """The layers that the next frame may read: of one sample of each pixel."""
        return self.layers if len(samples) == 1 and self.drawn else None


def mean_squares(lights: NearLightSet, placed: PlacedCasters) -> np.ndarray:
    """Mean square of the distance from each light to the points of the box about what stands in the scene, m^2, (n,) float64."""
    squares = ((lights.at.astype(np.float64) - placed.box_centre) ** 2).sum(axis=1) + (placed.box_half**2).sum() / 3
    return np.maximum(squares, MIN_DISTANCE_M**2)


def mean_irradiance(lights: NearLightSet, placed: PlacedCasters) -> np.ndarray:
    """What each light gives to what stands in the scene, (n,) float64: its luminance over `mean_squares`."""
    return luminance_from_rgb(lights.intensity.astype(np.float64)) / mean_squares(lights, placed)


def near_of(lights: NearLightSet, chosen: np.ndarray) -> NearLightSet:
    """Those of the numbers (k,)."""
    return NearLightSet(*(array[chosen] for array in lights.arrays()))


def strongest_first(lights: NearLightSet, placed: PlacedCasters) -> NearLightSet:
    """The lights that have any intensity: those that give the scene more by a power of two come first, then those of lower ids, so that
    noise does not change which are drawn."""
    added = mean_irradiance(lights, placed)
    shining = np.flatnonzero(added > 0)
    return near_of(lights, shining[np.lexsort((lights.ids[shining], -octaves(added[shining])))] if len(shining) else shining)


def near_within(lights: NearLightSet, placed: PlacedCasters, directional: LightSet, affordable: int, most_layers: int) -> NearLightSet:
    """The first of near lights in their order, `most_layers` at most, of which as many are drawn as are among the `affordable` strongest of
    all lights; they shine for the others, too.

    Directional lights keep MIN_LIGHTS, and so do near ones, if they are as many.
    """
    others = luminance_from_rgb(directional.irradiance.astype(np.float64))
    order = np.argsort(-np.concatenate([others, mean_irradiance(lights, placed)]), kind="stable")
    count = int(np.count_nonzero(order[:affordable] >= len(others)))
    most = max(affordable - min(MIN_LIGHTS, len(others)), MIN_LIGHTS)
    return with_joined(lights, min(max(count, MIN_LIGHTS), most, most_layers), placed)


def with_joined(lights: NearLightSet, count: int, placed: PlacedCasters) -> NearLightSet:
    """The first `count` of the lights, each with the light of those others to which it is the nearest: together they give the scene, by
    `mean_squares`, as much in each channel. Where they stand and how large they are stays, and so do their shadows."""
    if count >= len(lights.ids):
        return lights
    at, squares = lights.at.astype(np.float64), mean_squares(lights, placed)[:, None]
    nearest = np.linalg.norm(at[count:, None] - at[:count], axis=-1).argmin(axis=1)
    given = lights.intensity / squares
    np.add.at(given, nearest, given[count:])
    intensity = np.minimum(given[:count] * squares[:count], MAX_INTENSITY)
    return NearLightSet.of(lights.ids[:count], lights.at[:count], intensity, lights.radius[:count], lights.sigma[:count])


def near_batches(lights: NearLightSet, most_layers: int) -> tuple[NearBatch, ...]:
    """All of the lights, all traced, in batches of as many layers at most."""
    together, count = min(max(most_layers, 1), NEAR_BATCH), len(lights.ids)
    parts = [np.arange(first, min(first + together, count)) for first in range(0, count, together)]
    return tuple(NearBatch(near_of(lights, part), every := np.arange(len(part)), len(part), every, every < 0) for part in parts)


def slots_for(count: int, most: int) -> int:
    """Layers, `most` at most, that are laid out for so many lights: some more, for lights that come."""
    return min(count + math.ceil(SPARE_SLOTS * count), most)


def trace_work(coarse: np.ndarray) -> np.ndarray:
    """What tracing lights costs, over one on all pixels: (n,) float64 of (n,) bool, whether on coarse pixels."""
    return np.where(coarse, COARSE_WEIGHT, 1.0)


def may_be_coarse(lights: NearLightSet, placed: PlacedCasters, directional: LightSet) -> np.ndarray:
    """Which lights coarse pixels do for, (n,) bool: those that are neither strong nor narrow."""
    strength, others = mean_irradiance(lights, placed), luminance_from_rgb(directional.irradiance.astype(np.float64)).sum()
    narrow = lights.radius < NARROW_RAD * np.sqrt(mean_squares(lights, placed))
    return (strength < STRONG * (strength.sum() + others)) & ~narrow


def near_in_time(
    layers: NearLayers | None,
    lights: NearLightSet,
    coarse: np.ndarray,
    placed: PlacedCasters,
    most_layers: int,
    affordable: Callable[[int], int],
) -> NearInTime:
    """The lights, strongest first, as one batch that traces as many of those that moved as are `affordable`, the strongest first and one at
    least, and all those that no layer has. most_layers: that there can be, as many as lights at least. coarse: (n,) bool, which are traced
    on coarse pixels."""
    count = len(lights.ids)
    slots = slots_for(count, min(most_layers, NEAR_BATCH))
    if layers is None or not count <= len(layers.ids) <= ROOMY * slots:
        layers = NearLayers.empty(slots)
    layers = NearLayers(*(array.copy() for array in layers))
    same = (layers.ids == lights.ids[:, None]) & layers.filled
    known = same.any(axis=1)
    layer = same.argmax(axis=1) if len(layers.ids) else np.zeros(0, np.int64)
    moved = np.linalg.norm(lights.at.astype(np.float64) - layers.at[layer], axis=1)
    grown = np.abs(lights.radius - layers.radius[layer])
    reach = np.linalg.norm(np.maximum(np.abs(lights.at - placed.box_centre) - placed.box_half, 0), axis=1)
    allowed = np.maximum(KEPT_RAD * reach, KEPT_RADIUS * layers.radius[layer])
    stale = known & ((moved > allowed) | (grown > np.maximum(KEPT_RADIUS * layers.radius[layer], 1e-3)))
    new, waiting = np.flatnonzero(~known), np.flatnonzero(stale)
    work = np.cumsum(trace_work(coarse[np.concatenate([new, waiting])]))[len(new) :]
    in_time = affordable(int(np.ceil(work[-1]))) if len(waiting) else 0
    chosen = waiting[: max(int(np.count_nonzero(work <= in_time)), 1)]
    free = np.setdiff1d(np.arange(len(layers.ids)), layer[known])
    layer[new] = free[: len(new)]
    traced = np.sort(np.concatenate([new, chosen]))
    layers.ids[layer[traced]], layers.at[layer[traced]] = lights.ids[traced], lights.at[traced]
    layers.radius[layer[traced]], layers.coarse[layer[traced]] = lights.radius[traced], coarse[traced]
    return NearInTime(NearBatch(lights, layer, len(layers.ids), traced, coarse), layers, len(new) + len(waiting))


def restoring_near_batches(layers: NearLayers) -> tuple[NearBatch, ...]:
    """Batches that trace again what the layers hold."""
    filled = np.flatnonzero(layers.filled)
    dark, none = np.zeros((len(filled), 3), np.float32), np.zeros(len(filled), np.float32)
    lights = NearLightSet(layers.ids[filled], layers.at[filled], dark, layers.radius[filled], none)
    return (NearBatch(lights, filled, len(layers.ids), np.arange(len(filled)), layers.coarse[filled]),) if len(filled) else ()


def joined(batches: Sequence[NearBatch]) -> NearLightSet:
    """The lights of all batches."""
    parts = [batch.lights for batch in batches]
    if len(parts) <= 1:
        return parts[0] if parts else NearLightSet.empty()
    return NearLightSet(*(np.concatenate(arrays) for arrays in zip(*(part.arrays() for part in parts), strict=True)))


def same_light(before: LitBy, now: LitBy) -> bool:
    """Whether two frames are lit by the same."""
    a, b = ((*each.lights, *each.near.arrays()) for each in (before, now))
    return all(x is y or (x is not None and y is not None and np.array_equal(x, y)) for x, y in zip(a, b, strict=True))
