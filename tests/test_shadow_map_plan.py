"""Batches of lights and the cache of their maps: how many fit, how many slots there are, where rows begin."""

import numpy as np
import pytest

from tests.support.light_sets import lights_from
from tests.support.scenes import SHAPES
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.gl.buffers import LIGHT_FRAME
from vemlight.renderer.gl.constants import MAX_LIGHTS
from vemlight.renderer.passes.lights.light_regions import light_regions
from vemlight.renderer.passes.shadow_maps.casters import placed_casters, scene_casters
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import (
    ALIGNED,
    MAX_ATLAS_SIDE,
    Batch,
    CachedBatch,
    MapCache,
    ShadowSetup,
    all_batches,
    cached_batch,
    halvings_by_id,
    max_atlas_side,
    restoring_batches,
    with_lookups,
    with_moved_casters,
    without_lookups,
)
from vemlight.renderer.passes.shadow_maps.shadow_map_resolution import map_resolutions
from vemlight.renderer.scene.scene import load_scene

SCENE = load_scene(SHAPES)
RESOLUTIONS = map_resolutions(64)
SETUP = ShadowSetup(scene_casters(SCENE, RESOLUTIONS.choices), light_regions(24), RESOLUTIONS, 8192)
PLACED = placed_casters(SETUP.casters, np.tile(np.eye(4), (len(SCENE.meshes), 1, 1)))


def sky(count: int, turn: float = 0.0) -> LightSet:
    k = np.arange(count) + 0.5
    return lights_from(direction_from_angles(np.arccos(1 - 1.8 * k / count), 2.4 * k + turn))


def cached(lights: LightSet, cache: MapCache | None = None, affordable: int = 1000) -> CachedBatch:
    halvings = halvings_by_id(SETUP, lights, 0, {})
    made = cached_batch(SETUP, PLACED, cache, lights, halvings, lambda work: min(affordable, len(work)))
    assert made
    return made


def directions_of(batches: tuple[Batch, ...]) -> np.ndarray:
    return np.concatenate([batch.of(batch.every)["direction"] for batch in batches])


@pytest.mark.parametrize(("count", "sizes"), [(MAX_LIGHTS, [MAX_LIGHTS]), (MAX_LIGHTS + 1, [MAX_LIGHTS, 1]), (0, [0])])
def test_every_light_is_in_one_batch(count, sizes):
    lights = sky(count) if count else LightSet.none()
    batches = all_batches(SETUP, PLACED, lights)
    assert [batch.every.count for batch in batches] == sizes
    assert np.array_equal(directions_of(batches), lights.directions)
    assert all(batch.redrawn.count == batch.every.count and batch.clears_atlas for batch in batches)
    assert all(batch.unknown.count == 0 for batch in batches)  # nobody looks into a cache


def test_a_batch_fits_the_uniform_blocks_of_drivers_in_use():
    assert MAX_LIGHTS * LIGHT_FRAME.dtype.itemsize <= 65536 < 2 * MAX_LIGHTS * LIGHT_FRAME.dtype.itemsize


def test_rows_begin_where_drivers_let_a_uniform_block_begin():
    """At a multiple of 256 bytes: 16 frames or, with more left empty, 32."""
    batch = all_batches(SETUP, PLACED, sky(50))[0]
    assert ALIGNED <= 32
    for row in (*batch.rows, batch.every, batch.redrawn):
        assert row.first * LIGHT_FRAME.dtype.itemsize % 256 == 0


def test_the_atlas_takes_a_quarter_of_a_gigabyte_at_most():
    assert max_atlas_side(16384) ** 2 * 4 == 2**28
    assert max_atlas_side(4096 + 5) == 4096
    assert MAX_ATLAS_SIDE == 8192


def test_each_light_region_holds_the_lights_that_reach_it():
    batch = all_batches(SETUP, PLACED, sky(50))[0]
    assert len(batch.rows) == 24
    for region, row in zip(SETUP.regions.centres, batch.rows, strict=True):
        facing = batch.of(batch.every)["direction"] @ region > 0
        own = {tuple(direction) for direction in batch.of(row)["direction"].tolist()}
        assert {tuple(direction) for direction in batch.of(batch.every)["direction"][facing].tolist()} <= own


@pytest.mark.parametrize(("more", "redrawn"), [(9, 9), (10, 10), (11, 91), (20, 100)])
def test_an_eighth_more_lights_find_empty_slots(more, redrawn):
    """80 lights have 90 slots: ten more are drawn beside them, and for eleven all are drawn anew."""
    first = cached(sky(80))
    grown = LightSet(*(np.concatenate(pair) for pair in zip(sky(80)[:3], sky(more, 1.0)[:3], strict=True)))
    grown = grown._replace(ids=np.arange(80 + more))
    assert first.batch.slots == 90
    assert cached(grown, first.cache).batch.redrawn.count == redrawn


def test_more_lights_than_a_batch_holds_are_not_cached():
    lights = sky(MAX_LIGHTS + 1)
    assert cached_batch(SETUP, PLACED, None, lights, halvings_by_id(SETUP, lights, 0, {}), len) is None


def test_each_map_is_looked_up_once_until_it_is_drawn_again():
    first = cached(sky(20))
    assert first.batch.unknown.count == 20
    known = with_lookups(first)
    assert cached(sky(20), known).batch.unknown.count == 0
    turned = cached(sky(20, 0.2), known, affordable=4)
    assert (turned.batch.redrawn.count, len(turned.stale_work)) == (4, 20)
    drawn_again = {int(slot) for slot in turned.batch.of(turned.batch.redrawn)["map"]}
    assert {int(slot) for slot in turned.batch.of(turned.batch.unknown)["map"]} == drawn_again
    assert cached(sky(20), without_lookups(known)).batch.unknown.count == 20


def test_a_cache_is_drawn_again_as_it_was():
    """Each map once, with its own casters, and the lookups from the lights that looked."""
    known = with_lookups(cached(sky(20)))
    other = placed_casters(SETUP.casters, PLACED.matrices, PLACED)
    halvings = halvings_by_id(SETUP, sky(20), 0, {})
    turned = cached_batch(SETUP, other, known, sky(20, 0.2), halvings, lambda _: 4)
    assert turned
    restored = restoring_batches(SETUP, turned.cache)
    assert {id(casters): batch.redrawn.count for casters, batch in restored} == {id(PLACED): 19, id(other): 4}  # of 23 slots
    slots = turned.cache.slots
    for _, batch in restored:
        drawn, looked = batch.of(batch.redrawn), batch.of(batch.unknown)
        assert np.array_equal(drawn["map_direction"], slots.directions[drawn["map"].astype(int)])
        assert np.array_equal(looked["direction"], slots.lookups[looked["map"].astype(int)])
    assert sum(batch.unknown.count for _, batch in restored) == np.count_nonzero(~np.isnan(slots.lookups[:, 0]))


def test_maps_drift_by_what_their_casters_moved_in_the_box():
    """A shadow falls as far as the box is wide: a caster that moves a hundredth of that moves its shadow as a light does by 0.01 rad."""
    cache = cached(sky(5)).cache
    k = max(member.mesh for member in SETUP.casters.members)
    matrices = PLACED.matrices.copy()
    matrices[k, 0, 3] = 0.01 * 2 * float(PLACED.box_half.max())
    after = placed_casters(SETUP.casters, matrices, PLACED)
    drifted = with_moved_casters(SETUP, cache, PLACED, after._replace(box_centre=PLACED.box_centre, box_half=PLACED.box_half))
    assert drifted
    assert np.allclose(drifted.slots.drift_rad, 0.01, rtol=1e-3)
    assert with_moved_casters(SETUP, cache, PLACED, after._replace(box_half=PLACED.box_half * 1.1)) is None
