"""What a frame draws into the shadow maps and which map each of its lights reads: values, without GL.

A batch is a set of lights whose maps fit the atlas together. Without a target frame time each frame draws all maps of all its batches;
with one it is a single batch that redraws as many of its maps as there is time for and reads the others as they were drawn before.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.extent import Extents
from vemlight.light.light_set import LightSet
from vemlight.light.reflected_light import ReflectedLight
from vemlight.renderer.frame_budget import map_work
from vemlight.renderer.gl.buffers import LIGHT_ENTRY
from vemlight.renderer.gl.constants import MAX_LIGHTS
from vemlight.renderer.passes.lights.light_regions import Regions, region_rows
from vemlight.renderer.passes.shadow_maps.casters import Casters, PlacedCasters, moved_by_m
from vemlight.renderer.passes.shadow_maps.shadow_map_cache import CacheMatch, Slots, match_lights, update_cache
from vemlight.renderer.passes.shadow_maps.shadow_map_resolution import MapResolutions, Packing, map_halvings, packed

ALIGNED = 16  # frames; 2048 bytes, a multiple of the 256 at which GL drivers let a uniform block begin
MAX_ATLAS_SIDE = 8192  # texels; 256 MB of depth at 4 bytes, and no GL 4.3 driver refuses it
SPARE_SLOTS = 1 / 8  # more slots of a resolution than its lights need, for lights that come


class ShadowSetup(NamedTuple):
    """What all frames of a scene have in common. max_side: texels a side of the largest atlas that this GL makes."""

    casters: Casters
    regions: Regions
    resolutions: MapResolutions
    max_side: int


class LightRow(NamedTuple):
    """A run of light frames in the buffer."""

    first: int
    count: int


class MapDraw(NamedTuple):
    """Maps that are drawn together: with which level of the casters, from which frame of `Batch.redrawn` on, how many.

    from_below: how many of them, the last ones, into which the receiver plane casts too, since their lights shine from below it.
    """

    level: int
    first: int
    count: int
    from_below: int


class Batch(NamedTuple):
    """Lights whose maps are in the atlas together. entries: (m,) LIGHT_ENTRY, row after row.

    rows: the lights of each light region. every: all of them in their order. unknown: one for each map in which lookups are not in the
    visibility cache, or those that are traced. redrawn: those whose maps are drawn now; draws: the same by resolution. packing: where the
    tiles lie; of traced lights, which have none, only how many layers there are. clears_atlas: whether no map drawn before is read again.
    traced: the lights that are traced, those of `unknown`; rays: (k,) int64, of a pixel to each.
    """

    entries: np.ndarray
    rows: tuple[LightRow, ...]
    every: LightRow
    unknown: LightRow
    redrawn: LightRow
    draws: tuple[MapDraw, ...]
    packing: Packing
    clears_atlas: bool
    traced: LightSet = LightSet.none()
    rays: np.ndarray = np.zeros(0, np.int64)

    @property
    def resolutions(self) -> np.ndarray:
        """Texels on a side of the map that each light reads, (n,) int64."""
        return self.of(self.every)["resolution"].astype(np.int64)

    @property
    def slots(self) -> int:
        """How many maps the atlas has room for."""
        return len(self.packing.corners)

    @property
    def work(self) -> float:
        """What drawing its maps costs, as frame_budget.map_work counts."""
        return float(map_work(self.of(self.redrawn)["resolution"]).sum())

    def of(self, row: LightRow) -> np.ndarray:
        """The entries of a row."""
        return self.entries[row.first : row.first + row.count]


class MapCache(NamedTuple):
    """The maps that the atlas holds and where they lie."""

    slots: Slots
    packing: Packing


class CachedBatch(NamedTuple):
    """A batch that redraws some of its maps, and the cache after it. stale_work: (k,) float64, of each map that should be redrawn."""

    batch: Batch
    cache: MapCache
    stale_work: np.ndarray


def max_atlas_side(max_texture_side: int) -> int:
    """Texels a side of the largest atlas on a GL with textures of so many texels a side: a power of two."""
    return min(MAX_ATLAS_SIDE, 1 << (max_texture_side.bit_length() - 1))


def all_batches(setup: ShadowSetup, placed: PlacedCasters, lights: LightSet, resolution: int | None = None) -> tuple[Batch, ...]:
    """The lights that carry power, cut into batches that fit the atlas and draw all their maps; one empty batch where none does.

    resolution: of each map, in place of what the lights deserve.
    """
    lit, power = lit_lights(lights)
    if resolution:
        resolutions = np.full(len(lit), resolution)
    else:
        resolutions = setup.resolutions.largest >> map_halvings(setup.resolutions, lights.directions[lit], power)
    batches, first = [], 0
    while first < len(lit) or not batches:
        packing = _first_that_fit(resolutions[first : first + MAX_LIGHTS], setup.max_side)
        count = len(packing.corners)
        own = lit[first : first + count]
        slots = Slots.empty(resolutions[first : first + count])._replace(directions=lights.directions[own])
        every, none = np.arange(count), np.zeros(0, np.int64)
        batch = _batch(setup, placed, lights, own, every, MapCache(slots, packing), unknown=none, redrawn=every)
        batches.append(batch._replace(clears_atlas=True))
        first += count
    return tuple(batches)


def _first_that_fit(resolutions: np.ndarray, max_side: int) -> Packing:
    """As many of the first tiles as the largest atlas holds; one always fits."""
    if whole := packed(resolutions, max_side):
        return whole
    low, high = 1, len(resolutions) - 1
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if packed(resolutions[:middle], max_side) else (low, middle - 1)
    fitting = packed(resolutions[:low], max_side)
    assert fitting
    return fitting


def halvings_by_id(setup: ShadowSetup, lights: LightSet, coarsening: int, previous: Mapping[int, int]) -> dict[int, int]:
    """How often the map of each light that carries power is halved, by the light's id; previous: the same in the last frame."""
    lit, power = lit_lights(lights)
    ids = lights.ids[lit].tolist()
    before = np.array([previous.get(i, -1) for i in ids], np.int64)
    halvings = map_halvings(setup.resolutions, lights.directions[lit], power, coarsening, before)
    return dict(zip(ids, halvings.tolist(), strict=True))


def cached_batch(
    setup: ShadowSetup,
    placed: PlacedCasters,
    cache: MapCache | None,
    lights: LightSet,
    halvings: Mapping[int, int],
    affordable: Callable[[np.ndarray], int],
) -> CachedBatch | None:
    """The lights that carry power as one batch that redraws the maps for which there is time, and reads the others as they were drawn.

    halvings: of each light's map, by its id. affordable: how many maps are redrawn of those that should be, by the work (k,) that each
    costs, the worst first. None when the atlas cannot hold them all.
    """
    lit, power = lit_lights(lights)
    halved = np.array([halvings[i] for i in lights.ids[lit].tolist()], np.int64)
    if len(lit) > MAX_LIGHTS or (cache := _with_room(setup, cache, halved)) is None:
        return None
    slots, directions, resolutions = cache.slots, lights.directions[lit], setup.resolutions.largest >> halved
    empty = not slots.filled.any()
    match = CacheMatch(np.zeros(len(lit), np.int64), np.arange(len(lit)))
    if not empty:
        match = match_lights(slots, directions, power, resolutions)
    work = map_work(resolutions[match.stale])
    budget = len(lit) if empty else max(affordable(work), 1)
    update = update_cache(slots, match, directions, resolutions, budget, placed)
    cache = MapCache(update.slots, cache.packing)
    redrawn = np.sort(match.stale[:budget])  # another light may read such a map, too
    unknown = np.unique(update.slot, return_index=True)[1]
    unknown = unknown[np.isnan(cache.slots.lookups[update.slot[unknown], 0])]
    return CachedBatch(_batch(setup, placed, lights, lit, update.slot, cache, unknown, redrawn), cache, work)


def _with_room(setup: ShadowSetup, cache: MapCache | None, halvings: np.ndarray) -> MapCache | None:
    """The cache if it has a slot of its resolution for each light, else an empty one; None if the atlas cannot hold so many maps."""
    resolutions = np.array(setup.resolutions.choices)
    needed = np.bincount(halvings, minlength=len(resolutions))
    present = np.count_nonzero(cache.slots.resolutions == resolutions[:, None], axis=1) if cache else np.zeros_like(needed)
    if cache and np.all(present >= needed):
        return cache
    roomy = needed + np.ceil(SPARE_SLOTS * needed).astype(np.int64)
    grown = np.maximum(roomy, present)
    # What was there before stays, unless slots would be twice as many as the lights need (3/2 or 4 times do, too).
    for counts in (grown if grown.sum() <= 2 * roomy.sum() else roomy, needed):
        wanted = np.repeat(resolutions, counts)
        if packing := packed(wanted, setup.max_side):
            return MapCache(Slots.empty(wanted), packing)
    return None


def _batch(
    setup: ShadowSetup,
    placed: PlacedCasters,
    lights: LightSet,
    lit: np.ndarray,
    slot: np.ndarray,
    cache: MapCache,
    unknown: np.ndarray,
    redrawn: np.ndarray,
) -> Batch:
    """The lights numbered `lit` with the slot that each reads, which of them are looked up in it, and which redraw it."""
    directions, resolutions = cache.slots.directions[slot], cache.slots.resolutions[slot]
    below = directions @ placed.plane_normal < 0
    light = np.zeros(len(lit), LIGHT_ENTRY.dtype)
    light["direction"], light["irradiance"], light["map_direction"] = lights.directions[lit], lights.irradiance[lit], directions
    light["corner"], light["resolution"], light["map"] = cache.packing.corners[slot], resolutions, slot
    extents = Extents.of(lights)
    light["spread"], light["concentration"] = extents.spreads[lit], extents.concentrations[lit]
    light["direct"], light["number"] = 1.0, lit
    choice = np.searchsorted(-np.array(setup.resolutions.choices), -resolutions).clip(0, setup.resolutions.halvings)
    level = np.array(setup.casters.levels)[choice]
    redrawn = redrawn[np.lexsort((below[redrawn], level[redrawn]))]
    entries, rows = light_rows(light, [*region_rows(setup.regions, lights.directions[lit]), np.arange(len(lit)), unknown, redrawn])
    draws = []
    for own in np.unique(level[redrawn]).tolist():
        members = np.flatnonzero(level[redrawn] == own)
        draws.append(MapDraw(own, int(members[0]), len(members), int(np.count_nonzero(below[redrawn[members]]))))
    draws_all = len(redrawn) == len(cache.packing.corners)
    every, unknown_row, redrawn_row = rows[-3:]
    return Batch(entries, tuple(rows[:-3]), every, unknown_row, redrawn_row, tuple(draws), cache.packing, draws_all)


def light_rows(entries: np.ndarray, parts: Sequence[np.ndarray]) -> tuple[np.ndarray, list[LightRow]]:
    """The entries of each part, by number, one part after the other, each from a multiple of ALIGNED on."""
    rows, padded, first = [], [], 0
    for part in parts:
        rows.append(LightRow(first, len(part)))
        aligned_count = -(-len(part) // ALIGNED) * ALIGNED
        padded.append(np.resize(part, aligned_count))
        first += aligned_count
    return entries[np.concatenate(padded).astype(np.int64)], rows


def with_lookups(cached: CachedBatch) -> MapCache:
    """The cache once the lookups that the batch lacks are in the visibility cache."""
    unknown = cached.batch.of(cached.batch.unknown)
    lookups = cached.cache.slots.lookups.copy()
    lookups[unknown["map"].astype(int)] = unknown["direction"]
    return cached.cache._replace(slots=cached.cache.slots._replace(lookups=lookups))


def without_lookups(cache: MapCache) -> MapCache:
    """The cache after the surfaces moved on which lookups were made."""
    return cache._replace(slots=cache.slots._replace(lookups=np.full_like(cache.slots.lookups, np.nan)))


def with_moved_casters(setup: ShadowSetup, cache: MapCache, before: PlacedCasters, after: PlacedCasters) -> MapCache | None:
    """The cache after its casters moved: its maps drift by as much; None where all maps have to be drawn for another box or floor."""
    if not all(np.array_equal(getattr(before, name), getattr(after, name)) for name in ("box_centre", "box_half", "plane_normal")):
        return None
    drift_rad = moved_by_m(setup.casters, before.matrices, after.matrices) / (2 * float(after.box_half.max()))
    return cache._replace(slots=cache.slots._replace(drift_rad=cache.slots.drift_rad + drift_rad))


def restoring_batches(setup: ShadowSetup, cache: MapCache) -> tuple[tuple[PlacedCasters, Batch], ...]:
    """Batches that draw all maps of a cache again, as they were, each with its casters, and repeat the lookups that it holds."""
    made = []
    for casters in {id(placed): placed for placed in cache.slots.casters if placed}.values():
        own = np.array([k for k, placed in enumerate(cache.slots.casters) if placed is casters])
        for first in range(0, len(own), MAX_LIGHTS):
            slot = own[first : first + MAX_LIGHTS]
            lookups = cache.slots.lookups[slot]
            directions = np.where(np.isnan(lookups), cache.slots.directions[slot], lookups)
            lights, every = LightSet(slot, directions, np.ones_like(directions)), np.arange(len(slot))
            known = np.flatnonzero(~np.isnan(lookups[:, 0]))
            made.append((casters, _batch(setup, casters, lights, every, slot, cache, unknown=known, redrawn=every)))
    return tuple(made)


def lit_lights(lights: LightSet) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of the lights that carry power, and that power, luminance."""
    lit = np.flatnonzero(np.any(lights.irradiance != 0, axis=1))
    return lit, luminance_from_rgb(lights.irradiance[lit].astype(np.float64))


def with_reflection(batch: Batch, light: ReflectedLight) -> Batch:
    """The batch with what lobes reflect of each of its lights."""
    entries, number = batch.entries.copy(), batch.entries["number"].astype(np.int64)
    for name, values in {"direct": light.direct, "lobe_spread": light.spread, "least_width": light.least_width}.items():
        entries[name] = values[number]
    return batch._replace(entries=entries)
