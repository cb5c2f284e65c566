"""Which lights are traced: values, without GL.

What arrives of a light is kept, a layer of 8 bits a pixel, until the light moves or anything else does. A frame's budget traces those anew
that are worst off; the others read the layer that fits them best.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vemlight.light.light_set import LightSet
from vemlight.renderer.gl.buffers import LIGHT_ENTRY
from vemlight.renderer.gl.constants import MAX_LIGHTS
from vemlight.renderer.passes.lights.light_regions import region_rows
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import SPARE_SLOTS, Batch, ShadowSetup, light_rows, lit_lights
from vemlight.renderer.passes.shadow_maps.shadow_map_resolution import Packing

KEPT_RAD = np.radians(0.1)  # by which a light may turn before it is traced again: at 10 m its shadows move by 17 mm, at 1 m by 1.7


class TracedLayers(NamedTuple):
    """directions: (m, 3) float32, of the light that each layer was traced for; nan in an empty one."""

    directions: np.ndarray

    @staticmethod
    def empty(count: int) -> "TracedLayers":
        return TracedLayers(np.full((count, 3), np.nan, np.float32))

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
    return tuple(_batch(setup, lights, own, np.arange(len(own)), np.arange(len(own)), len(own)) for own in parts)


def traced_batch(
    setup: ShadowSetup, layers: TracedLayers | None, lights: LightSet, most: int, affordable: Callable[[int], int]
) -> TracedBatch | None:
    """The lights that carry power as one batch that traces as many of those that should be as are `affordable`, one at least.

    most: how many layers there can be. None where that is too few.
    """
    lit, power = lit_lights(lights)
    if len(lit) > min(most, MAX_LIGHTS):
        return None
    if layers is None or len(layers.directions) < len(lit):
        layers = TracedLayers.empty(min(len(lit) + int(np.ceil(SPARE_SLOTS * len(lit))), most))
    directions = lights.directions[lit]
    error = _errors(layers, directions)
    layer = error.argmin(axis=1) if len(layers.directions) else np.zeros(len(lit), np.int64)
    least = np.min(error, axis=1, initial=np.inf)
    stale = np.flatnonzero(least > KEPT_RAD)
    stale = stale[np.argsort(-(power * np.minimum(least, np.pi))[stale], kind="stable")]  # no layer counts as one behind the light
    count = len(stale) if not layers.filled.any() else min(max(affordable(len(stale)), 1), len(stale))
    chosen, waiting = stale[:count], stale[count:]
    needed, read = np.zeros(len(layers.directions), bool), np.zeros(len(layers.directions), bool)
    needed[np.delete(layer, stale)] = True
    read[layer[waiting]] = True
    free = np.flatnonzero(~needed)
    loss = np.where(layers.filled, 1 + read, 0)  # of overwriting a layer: nothing, a light, a light that another one reads
    layer[chosen] = free[np.argsort(loss[free], kind="stable")][: len(chosen)]
    kept = layers.directions.copy()
    kept[layer[chosen]] = directions[chosen]
    layers = TracedLayers(kept)
    if len(waiting):
        layer[waiting] = _errors(layers, directions[waiting]).argmin(axis=1)
    return TracedBatch(_batch(setup, lights, lit, layer, np.sort(chosen), len(kept)), layers, len(stale))


def restoring_batches(setup: ShadowSetup, layers: TracedLayers) -> tuple[Batch, ...]:
    """Batches that trace again what the layers hold."""
    filled = np.flatnonzero(layers.filled)
    made = []
    for first in range(0, len(filled), MAX_LIGHTS):
        own = filled[first : first + MAX_LIGHTS]
        lights, every = LightSet.of(own, layers.directions[own], np.ones((len(own), 3))), np.arange(len(own))
        made.append(_batch(setup, lights, every, own, every, len(layers.directions)))
    return tuple(made)


def _batch(setup: ShadowSetup, lights: LightSet, lit: np.ndarray, layer: np.ndarray, traced: np.ndarray, layers: int) -> Batch:
    """The lights numbered `lit`, the layer that each reads, of `layers`, and which of them are traced."""
    light = np.zeros(len(lit), LIGHT_ENTRY.dtype)
    light["direction"] = light["map_direction"] = lights.directions[lit]
    light["irradiance"], light["map"], light["resolution"] = lights.irradiance[lit], layer, 1
    regions = region_rows(setup.regions, lights.directions[lit])
    entries, rows = light_rows(light, [*regions, np.arange(len(lit)), traced, np.zeros(0, np.int64)])
    every, traced_row, drawn_row = rows[-3:]
    return Batch(entries, tuple(rows[:-3]), every, traced_row, drawn_row, (), Packing(np.zeros((layers, 2), np.int64), 1, 1), False)


def _errors(layers: TracedLayers, directions: np.ndarray) -> np.ndarray:
    """How far each light is from that of each layer, (n, m) rad; inf from an empty one."""
    light, traced = directions.astype(np.float64), layers.directions.astype(np.float64)
    error = np.sum(light**2, axis=1)[:, None] + np.sum(traced**2, axis=1) - 2 * light @ traced.T
    error = np.sqrt(np.maximum(error, 0, out=error), out=error)
    error[:, ~layers.filled] = np.inf
    return error
