import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer import frame_plan, near_planning
from vemlight.renderer.passes.shadow_maps.shadow_map_cache import CacheUpdate, Slots, match_lights, update_cache
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

SIZE = 256
TEXEL = 1 / 252  # rad


def sky(count: int, turn: float = 0.0) -> np.ndarray:
    k = np.arange(count) + 0.5
    return direction_from_angles(np.arccos(k / count), k * 2.4 + turn).astype(np.float32)


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.arccos(np.clip((a * b).sum(axis=-1), -1, 1))


def plan_of(slots: Slots, directions: np.ndarray, strength: npt.ArrayLike, budget: int, sizes: npt.ArrayLike = SIZE) -> CacheUpdate:
    count = len(directions)
    wanted = np.broadcast_to(sizes, count)
    match = match_lights(slots, directions, np.broadcast_to(strength, count), wanted)
    return update_cache(slots, match, directions, wanted, budget)


def drawn(count: int, slots: int = 12, turn: float = 0.0) -> CacheUpdate:
    """All maps of a sky drawn."""
    return plan_of(Slots.empty(np.full(slots, SIZE)), sky(count, turn), 1.0, count)


def test_a_plan_draws_all_that_is_missing_and_allowed():
    plan = drawn(8)
    assert sorted(plan.redrawn) == list(range(8))
    assert np.array_equal(plan.slots.directions[plan.slot], sky(8))


def test_lights_that_moved_less_than_a_texel_keep_their_maps():
    first = drawn(8)
    second = plan_of(first.slots, sky(8, 0.9 * TEXEL), 1.0, 4)
    assert len(second.redrawn) == 0
    assert np.array_equal(second.slot, first.slot)


def test_a_texel_of_a_coarse_map_is_larger():
    sizes = np.array([1024, 64])
    slots = Slots.empty(sizes)
    both = sky(2)
    slots = plan_of(slots, both, 1.0, 2, sizes).slots
    turned = sky(2, 0.005)  # 5 texels of 1 / 1020 rad, a third of one of 1 / 60
    assert plan_of(slots, turned, 1.0, 2, sizes).redrawn.tolist() == [0]


def test_a_light_whose_resolution_changes_gets_a_map_of_that_resolution():
    sizes = np.array([512, 64, 64])
    slots = plan_of(Slots.empty(np.array([512, 512, 64, 64, 64])), sky(3), 1.0, 3, sizes).slots
    assert len(plan_of(slots, sky(3), 1.0, 3, sizes).redrawn) == 0
    for grown in (np.array([512, 512, 64]), np.array([64, 64, 64])):
        plan = plan_of(slots, sky(3), 1.0, 3, grown)
        assert len(plan.redrawn) == 1
        assert np.array_equal(plan.slots.resolutions[plan.slot], grown)
        waiting = plan_of(slots, sky(3), 1.0, 0, grown)
        assert np.array_equal(waiting.slots.directions[waiting.slot], sky(3))  # it reads its own map of another size


def test_a_map_of_another_resolution_nearby_does_not_replace_a_lights_own():
    slots = Slots.empty(np.array([1024, 64]))._replace(directions=np.stack([sky(1)[0], sky(1, 0.5 / 60)[0]]))
    assert match_lights(slots, sky(1), np.ones(1), np.array([64])).slot.tolist() == [1]


def test_the_budget_goes_to_power_times_angle():
    directions, strength = sky(8), np.arange(1.0, 9.0)
    moved = sky(8, 0.05)
    plan = plan_of(drawn(8).slots, moved, strength, 3)
    worth = strength * angle(directions, moved)
    assert set(np.flatnonzero(np.isin(plan.slot, plan.redrawn))) == set(np.argsort(-worth)[:3])


@given(st.integers(1, 20), st.integers(1, 20), st.lists(st.floats(0, 2), min_size=1, max_size=6), st.integers(0, 2**32 - 1))
def test_every_light_reads_a_map_and_those_served_keep_theirs(count, budget, turns, seed):
    rng = np.random.default_rng(seed)
    slots = Slots.empty(np.repeat([256, 128, 64], count))
    plan = plan_of(slots, sky(count), 1.0, count, rng.choice([256, 128, 64], count))
    for turn in turns:
        before, directions, sizes = plan, sky(count, turn), rng.choice([256, 128, 64], count)
        plan = plan_of(before.slots, directions, rng.uniform(0, 1, count), budget, sizes)
        assert not np.isnan(plan.slots.directions[plan.slot]).any()
        assert len(plan.redrawn) <= budget
        assert len(np.unique(plan.redrawn)) == len(plan.redrawn)
        fresh = np.isin(plan.slot, plan.redrawn)
        own = np.flatnonzero(fresh & (plan.slots.directions[plan.slot] == directions).all(axis=1))
        assert len(own) == len(plan.redrawn)
        assert np.array_equal(plan.slots.resolutions[plan.slot[own]], sizes[own])
        match = match_lights(before.slots, directions, np.ones(count), sizes)
        served = np.setdiff1d(np.arange(count), match.stale)
        assert np.array_equal(plan.slot[served], match.slot[served])
        assert np.array_equal(plan.slots.directions[plan.slot[served]], before.slots.directions[plan.slot[served]])


def test_lights_that_stand_still_get_their_own_maps_in_the_end():
    plan, goal = drawn(20, 30), sky(20, 1.0)
    for _ in range(7):  # 20 lights, 3 a frame
        plan = plan_of(plan.slots, goal, 1.0, 3)
    assert angle(plan.slots.directions[plan.slot], goal).max() < 1.01 * TEXEL
    assert len(match_lights(plan.slots, goal, np.ones(20), np.full(20, SIZE)).stale) == 0


def test_maps_age_as_what_casts_moves():
    slots = drawn(8).slots
    for age, stale in ((0.9 * TEXEL, 0), (1.1 * TEXEL, 8)):
        aged = slots._replace(drift_rad=np.full(12, age))
        assert len(match_lights(aged, sky(8), np.ones(8), np.full(8, SIZE)).stale) == stale


@pytest.mark.parametrize(("turn", "stale"), [(0.9, 0), (1.1, 8)])
def test_a_map_serves_a_light_within_a_texel(turn, stale):
    slots = drawn(8).slots
    turned = slots.directions[:8] + 0  # chords: a turn by a small angle about any axis
    side = np.cross(turned, [0.3, 0.5, 0.8])
    turned += turn * TEXEL * side / np.linalg.norm(side, axis=1, keepdims=True)
    assert len(match_lights(slots, turned.astype(np.float32), np.ones(8), np.full(8, SIZE)).stale) == stale


def own_and_other(own_rad: float, drift_rad: float = 0.0) -> int:
    """Which map a light of 128 texels waits with: its own direction's of 64 texels, or one of 128 that is off by an angle and a drift.

    A map of 64 texels errs by the difference of two texels, 1 / 60 - 1 / 124 = 0.0086; from 1 / 124 = 0.0081 on one of 128 is stale.
    """
    light = sky(1)
    side = np.cross(light, [0.3, 0.5, 0.8])
    other = light + own_rad * side / np.linalg.norm(side)
    slots = Slots.empty(np.array([64, 128]))._replace(directions=np.concatenate([light, other]), drift_rad=np.array([0.0, drift_rad]))
    plan = plan_of(slots, light, 1.0, 0, 128)
    assert len(plan.redrawn) == 0
    return int(plan.slot[0])


def test_a_waiting_light_weighs_direction_drift_and_resolution_alike():
    assert [own_and_other(error) for error in (0.0083, 0.0095)] == [1, 0]
    assert [own_and_other(0.0, error) for error in (0.0083, 0.0095)] == [1, 0]
    assert [own_and_other(0.004, 0.0043), own_and_other(0.005, 0.0045)] == [1, 0]


def test_of_two_resolutions_a_waiting_light_reads_the_one_with_the_nearer_texel():
    slots = Slots.empty(np.array([64, 1024]))._replace(directions=np.repeat(sky(1), 2, axis=0))
    assert plan_of(slots, sky(1), 1.0, 0, 128).slot.tolist() == [1]  # 0.0086 and 0.0071 rad


def test_a_map_is_drawn_where_the_least_is_lost():
    """Into an empty slot rather than over a map, and over a map that no light reads rather than over one that a light waits with."""
    two = drawn(2, 4).slots  # lights 0 and 1 in two of four slots
    assert plan_of(two, sky(2, 1.0), 1.0, 1).redrawn.tolist() == [2]
    four = drawn(4, 4).slots
    turned = plan_of(four, sky(4, 0.02)[:2], [1.0, 2.0], 1)  # the second light's is drawn, the first waits with its own
    assert (turned.redrawn.tolist(), turned.slot.tolist()) == ([1], [0, 1])


def test_lights_without_any_map_come_by_their_strength():
    match = match_lights(Slots.empty(np.full(4, SIZE)), sky(3), np.array([1.0, 3.0, 2.0]), np.full(3, SIZE))
    assert match.stale.tolist() == [1, 2, 0]


def test_with_time_enough_the_picture_is_the_one_without_a_target():
    scene, pictures = load_scene(SHAPES), []
    for frame_ms in (0.0, 1e4):
        renderer = SceneRenderer(scene, Settings(width=64, height=48, shadow_map=64, frame_ms=frame_ms))
        for turn in (0.0, 0.3, 0.6):  # several texels of 1 / 60 rad
            lights = LightSet.of(np.arange(9), sky(9, turn), np.full((9, 3), 0.3))
            picture = renderer.picture(lights).copy()
        pictures.append(picture)
        renderer.release()
    # maps lie in other tiles, so edges of their triangles may round to the other texel
    assert np.mean(np.abs(pictures[0] - pictures[1]).max(axis=-1) > 1e-4) < 0.005


def test_maps_that_were_not_drawn_anew_err_by_no_more_than_their_angle(monkeypatch):
    monkeypatch.setattr(near_planning, "affordable_lights", lambda *_: None)
    scene = load_scene(SHAPES)
    exact = SceneRenderer(scene, Settings(width=96, height=72, shadow_map=128))
    errors = {}
    for budget in (2, 12):
        monkeypatch.setattr(frame_plan, "affordable_maps", lambda *_, budget=budget: budget)
        lazy = SceneRenderer(scene, Settings(width=96, height=72, shadow_map=128, frame_ms=40.0))
        worst = 0.0
        for frame in range(10):
            lights = LightSet.of(np.arange(48), sky(48, 0.01 * frame), np.full((48, 3), 0.1))
            truth, drawn = exact.picture(lights).copy(), lazy.picture(lights).copy()
            worst = max(worst, float(np.sqrt(np.mean((truth - drawn) ** 2) / np.mean(truth**2))))
        errors[budget] = worst
        lazy.release()
    exact.release()
    # 0.01 rad a frame is 1.2 texels: 12 of 48 maps a frame are at most 4 frames or 5 texels old, 2 of 48 up to 10 frames or 12 texels
    assert errors[12] < errors[2] < 0.03
    assert errors[12] < 0.015


def test_power_that_varies_a_little_redraws_no_map():
    renderer = SceneRenderer(load_scene(SHAPES), Settings(width=32, height=24, frame_ms=1e4, shadows="maps"))
    drawn_maps = []
    for frame in range(8):
        power = np.full(80, 1.0)
        power[:2] = 3.36 * (1.1 if frame % 2 else 0.9)  # a share of 0.04, where a map of 128 texels becomes one of 256
        renderer.picture(LightSet.of(np.arange(80), sky(80), power[:, None] * np.ones(3)))
        drawn_maps.append(renderer.plan.batches[0].redrawn.count)
    assert drawn_maps == [80, *[0] * 7]
    assert renderer.plan.resolutions[0] > renderer.plan.resolutions[79] == 64
    renderer.release()


def test_lights_that_become_stronger_get_larger_maps_and_the_others_keep_theirs():
    renderer = SceneRenderer(load_scene(SHAPES), Settings(width=32, height=24, frame_ms=1e4, shadows="maps"))
    sizes, drawn_maps = [], []
    for power in (1.0, 20.0, 20.0, 1.0, 20.0):
        irradiance = np.ones((80, 3))
        irradiance[7] = power
        renderer.picture(LightSet.of(np.arange(80), sky(80), irradiance))
        sizes.append(renderer.plan.resolutions.tolist())
        drawn_maps.append(renderer.plan.batches[0].redrawn.count)
    assert [row[7] for row in sizes] == [64, 512, 512, 64, 512]
    assert {size for row in sizes for k, size in enumerate(row) if k != 7} == {64}
    # Once there is room for a map of either size, each is drawn when it is first needed and then stays.
    assert drawn_maps == [80, 80, 0, 1, 0]
    renderer.release()
