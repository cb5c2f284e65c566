"""What a frame draws, planned without GL: the passes in an order that gives each what it reads, the cached lookups, the batches."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.light_sets import lights_from
from tests.support.scenes import SHAPES
from vemlight import settings
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer import pass_table
from vemlight.renderer.accumulation import MapLights
from vemlight.renderer.frame import AccumulationPass, FrameInput, FramePlan, FrameSetup, FrameState, ToneRequest
from vemlight.renderer.frame_budget import CostModel
from vemlight.renderer.frame_plan import frame_setup, initial_state, plan, plan_upload
from vemlight.renderer.pass_table import CACHED, INPUTS, PASSES
from vemlight.renderer.passes.shadow_maps.shadow_map_cache import texel_rad
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import load_scene
from vemlight.renderer.scene.scene_pose import scene_pose
from vemlight.runtime.poses import Pose

ROOT = Path(__file__).parents[1]
COSTS = CostModel()
MOVED = Pose(name="box", position=(0.5, 0.5, 0.6))


def setup_of(frame_ms: float = 1e4, samples: int = 1, **changes) -> FrameSetup:
    wanted = settings.Renderer(**{"width": 64, "height": 48, "shadow_map": 64, "frame_ms": frame_ms, **changes})
    return frame_setup(load_scene(SHAPES), wanted, samples, max_texture_side=16384)


def planned(setup: FrameSetup, *frames: FrameInput) -> tuple[list[FramePlan], FrameState]:
    state, plans = initial_state(setup), []
    for shown in frames:
        made, state = plan(setup, state, shown, COSTS)
        plans.append(made)
    return plans, state


def names(made: FramePlan) -> list[str]:
    return [run.row.name for run in made.passes] + [row.name for row in made.outputs]


def sky(count: int, moved: int = 0) -> LightSet:
    """Lights far apart, of which the first `moved` have turned by several texels."""
    k = np.arange(count) + 0.5
    return lights_from(direction_from_angles(np.arccos(1 - 0.9 * k / count), 2.4 * k + 0.1 * (k < moved)))


def test_a_plan_follows_from_what_is_given():
    setup = setup_of()
    state = planned(setup, FrameInput(sky(9), setup.rest))[1]
    shown = FrameInput(sky(9, 2), setup.rest, tone=ToneRequest(None, 0.0, 0.04))
    (one, _), (other, _) = (plan(setup, state, shown, COSTS) for _ in range(2))
    assert one.passes == other.passes
    assert np.array_equal(one.batches[0].entries, other.batches[0].entries)
    assert one.before is other.before is state


@pytest.mark.parametrize("frame_ms", [0.0, 1e4])
@pytest.mark.parametrize("samples", [1, 4])
def test_each_pass_reads_what_a_pass_before_it_wrote(frame_ms, samples):
    setup = setup_of(frame_ms, samples)
    setup = setup._replace(emissive=True)
    background, tone = EnvironmentMap(np.ones((4, 8, 3), np.float32), "sphere"), ToneRequest(None, 0.0, 0.04)
    light = MapLights(np.ones((4, 8, 3), np.float32), "sphere")
    shown = FrameInput(sky(30), setup.rest, background, background, tone=tone)
    moved = shown._replace(pose=scene_pose(setup.scene, 0.0, [MOVED]))
    accumulated = shown._replace(lights=AccumulationPass(light, 3))
    plans, state = planned(setup, shown, shown, moved, accumulated, shown, shown._replace(lights=sky(600)), shown)
    plans.append(plan_upload(state, np.zeros((48, 64, 4), np.float32), shown))
    for made in plans:
        written = set(INPUTS)
        written |= set(CACHED) if made.before.g_buffer else {"shadow maps", "cached visibility"}
        if not made.runs(pass_table.WEAK_LIGHTS):  # only beside coarse pixels are they read
            written |= {"coarse surfaces", "coarse light", "coarse gloss"}
        written |= {"edges"}  # none, before a frame finds some
        if not setup.bounces:  # gloss has the visibility of the lights then
            written |= {"mirrored scene"}
        for row in [*(run.row for run in made.passes), *made.outputs]:
            assert set(row.reads) <= written | {"catcher coverage"}, row.name
            written |= set(row.writes)
        assert "picture" in written


def test_a_still_frame_draws_nothing_that_is_cached():
    setup = setup_of()
    shown = FrameInput(sky(9), setup.rest)
    (first, second, third), _ = planned(setup, shown, shown, shown._replace(pose=scene_pose(setup.scene, 0.0, [MOVED])))
    assert names(first) == ["shadow maps", "G-buffer", "classes", "lights", "read-back"]
    assert names(second) == ["shadow maps", "visibility cache", "lights", "read-back"]
    assert (first.batches[0].redrawn.count, second.batches[0].redrawn.count) == (9, 0)
    assert names(third) == names(first)  # surfaces moved, and with them what lookups are for
    assert third.batches[0].redrawn.count == 9


def test_what_is_not_asked_for_is_not_brought_back():
    setup = setup_of()
    shown = FrameInput(sky(3), setup.rest, linear=False)
    tones = (None, ToneRequest(None, 0.0, 0.04), ToneRequest(None, 0.0, None))
    made = planned(setup, *(shown._replace(tone=tone) for tone in tones))[0]
    assert [[row.name for row in each.outputs] for each in made] == [[], ["adaptation", "tone mapping"], ["tone mapping"]]


@pytest.mark.parametrize(("moved", "cached"), [(14, True), (15, True), (16, False)])
def test_lookups_are_cached_unless_most_maps_are_redrawn(moved, cached):
    """A lookup for the cache takes 4/3 of one in the sum: of 20 lights it pays while up to 15 have new maps."""
    setup = setup_of()
    last = planned(setup, FrameInput(sky(20), setup.rest), FrameInput(sky(20, moved), setup.rest))[0][-1]
    assert last.batches[0].redrawn.count == moved
    assert last.runs(pass_table.VISIBILITY_CACHE) == cached
    assert last.work is not None
    assert last.work.lookups == (20 if cached else None)  # none was known before


@pytest.mark.parametrize(("lights", "cached"), [(220, True), (240, False)])
def test_cached_lookups_take_half_a_gigabyte_at_most(lights, cached):
    """A byte a pixel for each of 9/8 as many maps: at 1920 x 1080 those of 227 lights."""
    setup = setup_of(width=1920, height=1080)
    shown = FrameInput(sky(lights), setup.rest)
    assert planned(setup, shown, shown)[0][-1].runs(pass_table.VISIBILITY_CACHE) == cached


@pytest.mark.parametrize(("frame_ms", "samples"), [(0.0, 1), (1e4, 4)])
def test_lookups_are_cached_for_a_target_and_one_sample_alone(frame_ms, samples):
    setup = setup_of(frame_ms, samples)
    shown = FrameInput(sky(9), setup.rest)
    assert not planned(setup, shown, shown, shown)[0][-1].runs(pass_table.VISIBILITY_CACHE)


def test_maps_of_a_pass_resolve_a_cell_of_the_polar_map():
    """A cell is a degree wide: with less than four texels for it shadows are coarser than the map, more cost time alone."""
    light = AccumulationPass(MapLights(np.ones((90, 360, 3), np.float32), "hemisphere"), 0)
    for given, expected in ((None, 256), (64, 64)):
        setup = setup_of(shadow_map=given)
        (made,), _ = planned(setup, FrameInput(light, setup.rest))
        assert set(made.resolutions) == {expected}
    assert 4 < np.radians(1.0) / texel_rad(np.array([256]))[0] < 5


@pytest.mark.parametrize(("frames", "stale_fraction"), [(1, 0.0), (2, 0.2)])
def test_what_maps_the_lights_need_counts_from_when_costs_are_measured(frames, stale_fraction):
    """The first frames draw all maps because they are the first: that says nothing about the lights."""
    setup = setup_of()
    _, after = plan(setup, initial_state(setup), FrameInput(sky(20), setup.rest), CostModel(frames=frames))
    assert after.demand.stale_fraction == pytest.approx(stale_fraction)


def test_a_slow_machine_draws_fewer_lights_and_the_same_reflections():
    setup = setup_of(100.0)
    state = initial_state(setup)
    shown = FrameInput(sky(72), setup.rest, EnvironmentMap(np.ones((4, 8, 3), np.float32), "sphere"))
    for fixed_ms, lights in ((20.0, 72), (50.0, 50), (200.0, 8)):
        costs = CostModel(5, fixed_ms, 0.1, 1.0)
        made, _ = plan(setup, state._replace(lookup_pose=setup.rest), shown, costs)
        assert len(made.lights.ids) == pytest.approx(lights, abs=1)
        assert made.runs(pass_table.GLOSS)
        assert made.runs(pass_table.PREFILTER)
        assert made.lights.irradiance.sum() == pytest.approx(shown.lights.irradiance.sum(), rel=1e-5)  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(("fixed_ms", "bounce"), [(20.0, True), (200.0, False)])
def test_mirrors_outlive_the_bounce(fixed_ms, bounce):
    """Without rays of its own half of a mirror would be black under a hemisphere; their time is no part of the bounce's."""
    setup = setup_of(100.0)._replace(traced=True, bounces=True)
    environment = EnvironmentMap(np.ones((4, 8, 3), np.float32), "hemisphere")
    made, _ = plan(setup, initial_state(setup), FrameInput(sky(30), setup.rest, environment), CostModel(5, fixed_ms, 0.1, 1.0, 0.0, 15.0))
    assert (made.runs(pass_table.BOUNCE), made.runs(pass_table.MIRRORS)) == (bounce, True)
    assert pass_table.MIRRORS.timer != pass_table.BOUNCE.timer


def test_the_table_names_each_pass_once_and_where_it_is_drawn():
    assert len({row.name for row in PASSES}) == len(PASSES)
    for row in PASSES:
        assert (ROOT / "services" / "renderer" / row.module).exists(), row
        assert set(row.reads) <= set(INPUTS) | {name for each in PASSES for name in each.writes}, row
        assert row.writes, row
    assert set(CACHED) <= {name for row in PASSES for name in row.writes}


def test_the_renderer_runs_every_pass_of_the_table():
    renderer = Renderer(load_scene(SHAPES), settings.Renderer(width=8, height=8))
    outputs = {pass_table.READ_BACK, pass_table.ADAPTATION, pass_table.TONE_MAPPING}
    assert set(renderer._run_pass) | outputs == set(PASSES)
    renderer.release()
