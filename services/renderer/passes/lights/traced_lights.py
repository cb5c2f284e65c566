"""Which lights are traced: values, without GL.

What arrives of a light is kept, a layer of 8 bits a pixel, until the light moves or anything else does. A frame's budget traces those anew
that are worst off; the others read the layer that fits them best.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vemlight.light.extent import Extents
from vemlight.light.light_set import LightSet
from vemlight.renderer.gl.buffers import LIGHT_ENTRY
from vemlight.renderer.gl.constants import MAX_LIGHTS
from vemlight.renderer.passes.lights.light_regions import region_rows
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import SPARE_SLOTS, Batch, ShadowSetup, light_rows, lit_lights
from vemlight.renderer.passes.shadow_maps.shadow_map_resolution import Packing
from vemlight.renderer.rays.soft_pattern import FEW, POINT, STRATA

MANY_FROM = 4.0  # times the mean power, from which on a light has many rays live: a sun or a lamp
NARROW_RAD = 0.02  # spread of lights whose penumbra is seldom wider than the filter
KEPT_SPREAD = 1 / 8  # of a light's spread, by which it may turn or widen as well: its penumbra hides that
KEPT_RAD = np.radians(0.1)  # by which a light may turn before it is traced again: at 10 m its shadows move by 17 mm, at 1 m by 1.7


class TracedLayers(NamedTuple):
    """What each layer was traced for, and by how many rays: ids (m,) int64, directions (m, 3) and covariances (m, 6) float32, nan in an
    empty one, rays (m,) int64."""

    ids: np.ndarray
    directions: np.ndarray
    covariances: np.ndarray
    rays: np.ndarray

    @staticmethod
    def empty(count: int) -> "TracedLayers":
        directions, covariances = np.full((count, 3), np.nan, np.float32), np.zeros((count, 6), np.float32)
        return TracedLayers(np.zeros(count, np.int64), directions, covariances, np.zeros(count, np.int64))

    @property
    def filled(self) -> np.ndarray:
        """(m,) bool, whether each holds a light."""
        return ~np.isnan(self.directions[:, 0])


class TracedBatch(NamedTuple):
    """A batch that traces some of its lights, the layers after it, and how many lights should have been traced."""

    batch: Batch
    layers: TracedLayers
    stale: int


def traced_batches(setup: ShadowSetup, lights: LightSet, most: int) -> tuple[Batch, ...]:
    """The lights that carry power in batches of `most` at most, all of them traced; one empty batch where none does."""
    lit, _ = lit_lights(lights)
    most = min(max(most, 1), MAX_LIGHTS)
    parts = [lit[first : first + most] for first in range(0, max(len(lit), 1), most)]
    many = np.where(Extents.of(lights).spreads > 0, STRATA, POINT)
    return tuple(_batch(setup, lights, own, np.arange(len(own)), np.arange(len(own)), many[own], len(own)) for own in parts)


def traced_batch(
    setup: ShadowSetup, layers: TracedLayers | None, lights: LightSet, rays: np.ndarray, most: int, affordable: Callable[[int], int]
) -> TracedBatch | None:
    """The lights that carry power as one batch that traces as many of those that should be as are `affordable`, one at least.

    rays: (n,) int64, of a pixel to each light. most: how many layers there can be. None where that is too few.
    """
    lit, power = lit_lights(lights)
    rays = rays[lit]
    if len(lit) > min(most, MAX_LIGHTS):
        return None
    if layers is None or len(layers.ids) < len(lit):
        layers = TracedLayers.empty(min(len(lit) + int(np.ceil(SPARE_SLOTS * len(lit))), most))
    own = lights_of(lights, lit)
    error, spreads = _errors(layers, own), Extents.of(own).spreads
    layer = error.argmin(axis=1) if len(layers.ids) else np.zeros(len(lit), np.int64)
    least = np.min(error, axis=1, initial=np.inf)
    stale = np.flatnonzero(least > np.maximum(KEPT_RAD, KEPT_SPREAD * spreads))
    stale = stale[np.argsort(-(power * np.minimum(least, np.pi))[stale], kind="stable")]  # no layer counts as one behind the light
    count = len(stale) if not layers.filled.any() else min(max(affordable(len(stale)), 1), len(stale))
    chosen, waiting = stale[:count], stale[count:]
    needed, read = np.zeros(len(layers.ids), bool), np.zeros(len(layers.ids), bool)
    needed[np.delete(layer, stale)] = True
    read[layer[waiting]] = True
    free = np.flatnonzero(~needed)
    loss = np.where(layers.filled, 1 + read, 0)  # of overwriting a layer: nothing, a light, a light that another one reads
    layer[chosen] = free[np.argsort(loss[free], kind="stable")][: len(chosen)]
    layers = TracedLayers(*(each.copy() for each in layers))
    for kept, new in zip(layers, (own.ids, own.directions, _covariances(own), rays), strict=True):
        kept[layer[chosen]] = new[chosen]
    if len(waiting):
        layer[waiting] = _errors(layers, lights_of(own, waiting)).argmin(axis=1)
    chosen = np.sort(chosen)
    return TracedBatch(_batch(setup, lights, lit, layer, chosen, rays[chosen], len(layers.ids)), layers, len(stale))


def live_rays(lights: LightSet) -> np.ndarray:
    """How many rays of a pixel go to each light where time counts, (n,) int64. More to the strong, whose errors show most.

    A single ray is filtered over 5 x 5 pixels. Narrow lights would lose the edges of their shadows by that.
    """
    lit, power = lit_lights(lights)
    rays, spreads = np.zeros(len(lights.ids), np.int64), Extents.of(lights).spreads[lit]
    if len(lit):
        soft = np.where(power >= MANY_FROM * power.mean(), STRATA, np.where(spreads < NARROW_RAD, FEW, 1))
        rays[lit] = np.where(spreads > 0, soft, POINT)
    return rays


def lights_of(lights: LightSet, chosen: np.ndarray) -> LightSet:
    """Those of the numbers (k,)."""
    return LightSet.of(lights.ids[chosen], lights.directions[chosen], lights.irradiance[chosen], _covariances(lights)[chosen])


def renumbered(batch: Batch, numbers: np.ndarray) -> Batch:
    """A batch of a part of a frame's lights, whose entries then have their numbers (n,) in the whole."""
    entries = batch.entries.copy()
    entries["number"] = numbers[entries["number"].astype(np.int64)]
    return batch._replace(entries=entries)


def restoring_batches(setup: ShadowSetup, layers: TracedLayers) -> tuple[Batch, ...]:
    """Batches that trace again what the layers hold."""
    filled = np.flatnonzero(layers.filled)
    made = []
    for first in range(0, len(filled), MAX_LIGHTS):
        own = filled[first : first + MAX_LIGHTS]
        every, light = np.arange(len(own)), np.ones((len(own), 3), np.float32)
        lights = LightSet(layers.ids[own], layers.directions[own], light, layers.covariances[own])
        made.append(_batch(setup, lights, every, own, every, layers.rays[own], len(layers.ids)))
    return tuple(made)


def _batch(
    setup: ShadowSetup, lights: LightSet, lit: np.ndarray, layer: np.ndarray, traced: np.ndarray, rays: np.ndarray, layers: int
) -> Batch:
    """The lights numbered `lit`, the layer that each reads, of `layers`, and which of them are traced by how many rays."""
    light = np.zeros(len(lit), LIGHT_ENTRY.dtype)
    light["direction"] = light["map_direction"] = lights.directions[lit]
    light["irradiance"], light["map"], light["resolution"] = lights.irradiance[lit], layer, 1
    extents = Extents.of(lights)
    light["spread"], light["concentration"] = extents.spreads[lit], extents.concentrations[lit]
    light["direct"], light["number"] = 1.0, lit
    regions = region_rows(setup.regions, lights.directions[lit])
    entries, rows = light_rows(light, [*regions, np.arange(len(lit)), traced, np.zeros(0, np.int64)])
    every, traced_row, drawn_row = rows[-3:]
    packing, own = Packing(np.zeros((layers, 2), np.int64), 1, 1), lit[traced]
    own_lights = LightSet.of(lights.ids[own], lights.directions[own], lights.irradiance[own], _covariances(lights)[own])
    return Batch(entries, tuple(rows[:-3]), every, traced_row, drawn_row, (), packing, False, own_lights, rays)


def _covariances(lights: LightSet) -> np.ndarray:
    """(n, 6) float32, zeros for points."""
    return np.zeros((len(lights.ids), 6), np.float32) if lights.covariances is None else lights.covariances


def _errors(layers: TracedLayers, lights: LightSet) -> np.ndarray:
    """How far each light is from that of each layer, and how much wider or narrower, (n, m) rad; inf from an empty one."""
    light, traced = lights.directions.astype(np.float64), layers.directions.astype(np.float64)
    error = np.sum(light**2, axis=1)[:, None] + np.sum(traced**2, axis=1) - 2 * light @ traced.T
    error = np.sqrt(np.maximum(error, 0, out=error), out=error)
    held = Extents.of(LightSet(layers.ids, np.nan_to_num(layers.directions), layers.directions, layers.covariances))
    error += np.abs(held.spreads - Extents.of(lights).spreads[:, None])
    error[:, ~layers.filled] = np.inf
    return error
