from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vemlight.light.light_set import LightSet
from vemlight.renderer.frame_budget import (
    FEWEST,
    CostModel,
    Spent,
    affordable_lights,
    affordable_maps,
    first_lights,
    halvings,
    learnt,
    least_ms,
    map_work,
    waited,
    with_weak,
)


def spent(fixed_ms: float, maps: int, map_ms: float, lookups: int | None, lookup_ms: float, lights: int, light_ms: float) -> Spent:
    """A frame on a machine with these costs."""
    lights_ms = lights * (light_ms if lookups is not None else light_ms + lookup_ms)
    lookups_ms = (lookups or 0) * lookup_ms
    return Spent(fixed_ms + maps * map_ms + lookups_ms + lights_ms, maps, maps * map_ms, lookups, lookups_ms, lights, lights_ms)


def frame_ms(pace: CostModel, work: np.ndarray, lights: int, moved: bool) -> float:
    """What a frame that draws maps of this work takes on a machine that costs what `pace` says."""
    lookups = lights if moved or len(work) > 0.75 * lights else len(work)
    return pace.always_ms + work.sum() * (pace.map_ms or 0) + lookups * pace.lookup_ms + lights * (pace.light_ms or 0)


def test_nothing_is_promised_before_anything_is_known():
    assert affordable_lights(CostModel(), 40.0) is None
    assert affordable_maps(CostModel(), 40.0, 7, False, np.ones(7)) == 7


def test_lights_that_stand_still_are_counted_without_their_maps():
    pace = learnt(CostModel(), spent(4.0, 0, 0.1, 0, 0.0, 72, 0.5))
    assert affordable_lights(pace, 40.0) == 72
    assert affordable_maps(pace, 40.0, 7, False, np.ones(7)) == 7


def test_a_steady_machine_is_learnt_at_once_and_kept():
    pace = CostModel()
    for _ in range(5):
        pace = learnt(pace, spent(4.0, 10, 0.9, 10, 0.3, 72, 0.5))
    assert (pace.fixed_ms, pace.map_ms, pace.light_ms, pace.lookup_ms) == pytest.approx((4.0, 0.9, 0.5, 0.3))
    still = learnt(pace, spent(4.0, 0, 0.9, 0, 0.3, 72, 0.5))
    assert still[:4] == pytest.approx(pace[:4])  # a frame without maps tells nothing about maps, and none without lookups about them


def test_lights_looked_up_in_the_sum_cost_what_both_cost():
    pace = CostModel()
    for _ in range(5):
        pace = learnt(pace, spent(4.0, 72, 0.9, None, 0.6, 72, 0.3))
    assert pace.light_ms is not None
    assert pace.light_ms + pace.lookup_ms == pytest.approx(0.9)
    for _ in range(40):
        pace = learnt(pace, spent(4.0, 4, 0.9, 4, 0.6, 72, 0.3))
    assert (pace.light_ms, pace.lookup_ms) == pytest.approx((0.3, 0.6), rel=0.01)


@given(
    st.floats(0, 10),
    st.floats(0.01, 5),
    st.floats(0.01, 5),
    st.floats(0, 5),
    st.floats(0, 1),
    st.floats(1, 100),
    st.lists(st.sampled_from([1.5, 2.6, 7.5, 27.0, 100.0]), min_size=1, max_size=500),
    st.booleans(),
    st.booleans(),
)
def test_what_is_promised_fits(fixed, map_ms, light_ms, lookup_ms, off, target_ms, work, moved, weak):
    pace, work, lights = CostModel(fixed, map_ms, light_ms, lookup_ms, 3.0, weak, float(np.mean(work)), off=off), np.array(work), len(work)
    fixed += 3.0 * weak
    most = affordable_lights(pace, target_ms, moved)
    assert most is not None
    each = light_ms + (1 if moved else pace.renewed) * lookup_ms + pace.renewed * map_ms * pace.work
    assert most == FEWEST or fixed + most * each <= target_ms * (1 + 1e-9)
    assert fixed + (most + 1) * each > target_ms * (1 - 1e-9)
    maps = affordable_maps(pace, target_ms, lights, moved, work)
    least = int(np.ceil(lights * pace.renewed))
    assert least <= maps <= lights
    assert maps == least or frame_ms(pace, work[:maps], lights, moved) <= target_ms * (1 + 1e-9)
    # one more would not fit, but where all lookups fall due at once
    assert maps == lights or frame_ms(pace, work[: maps + 1], lights, moved) > target_ms * (1 - 1e-9)


def test_maps_that_wait_become_coarser_and_those_that_do_not_finer_again():
    pace, one = CostModel(), np.ones(72)
    for _ in range(20):
        pace = waited(pace, one, 72, 72.0, 3.0)
    assert [halvings(pace, before, 2) for before in (0, 1, 2)] == [1, 2, 2]
    for _ in range(40):
        pace = waited(pace, one, 0, 0.0, 0.0)
    assert [halvings(pace, before, 2) for before in (0, 1, 2)] == [0, 0, 1]


def test_a_sun_whose_map_is_drawn_in_every_frame_makes_no_other_coarser():
    work, pace = map_work(np.array([1024, *[64] * 20])), CostModel()
    for _ in range(40):
        pace = waited(pace, work, 21, float(work.sum()), float(work[:3].sum()))  # it and two of the others
    assert halvings(pace, 0, 2) == 0


def test_a_large_map_drawn_alone_makes_no_other_look_dear():
    sizes, pace = np.array([1024, *[64] * 20]), CostModel()
    for drawn in (sizes, sizes[:1], sizes[:1], sizes[1:5]):
        work = float(map_work(drawn).sum())
        pace = learnt(pace, Spent(5.0 + 0.05 * work, work, 0.05 * work, 0, 0.0, 21, 0.0))
    assert pace.map_ms == pytest.approx(0.05)


def test_work_grows_with_the_texels():
    work = map_work(np.array([64, 128, 256, 512, 1024]))
    assert np.all(np.diff(work) > 0)
    assert work[-1] / work[-2] == pytest.approx(4, rel=0.05)
    assert work[1] / work[0] < 2  # a small map is its triangles


@given(st.floats(0.0, 30.0), st.integers(0, 2))
def test_no_size_is_left_to_come_back_to_at_once(backlog, before):
    now = halvings(CostModel(backlog=backlog), before, 2)
    # Of half the size a map moves half as many texels and costs a third or more; of twice the size the other way round.
    after = backlog / 2 if now > before else backlog * 6 if now < before else backlog
    if now > before:
        assert halvings(CostModel(backlog=after), now, 2) >= now
    elif now < before:
        assert halvings(CostModel(backlog=after), now, 2) <= now


def test_the_second_set_is_left_out_before_a_sky_becomes_a_few_hard_shadows():
    pace = learnt(CostModel(), Spent(30.0, 0.0, 0.0, 0, 0.0, 20, 10.0, 15.0))
    assert (pace.fixed_ms, pace.weak_ms, pace.light_ms) == (5.0, 15.0, 0.5)
    assert affordable_lights(pace, 40.0) == 40
    assert with_weak(pace, 25.0).weak  # 5 + 15 + 8 * 0.5 ms
    left_out = with_weak(pace, 20.0)
    assert not left_out.weak
    assert affordable_lights(left_out, 20.0) == 30
    without = learnt(left_out, Spent(15.0, 0.0, 0.0, 0, 0.0, 20, 10.0, None))
    assert without.weak_ms == 15.0  # what it would cost is not forgotten
    assert not with_weak(without, 23.0).weak
    assert with_weak(without, 24.0).weak


def test_the_second_set_does_not_come_and_go_while_its_cost_wavers():
    rng, pace, told = np.random.default_rng(3), CostModel(), []
    for _ in range(200):
        fixed, weak = np.array([5.0, 15.0]) * rng.uniform(0.95, 1.05, 2)
        spent_ms = weak if pace.weak else None
        pace = with_weak(learnt(pace, Spent(fixed + 10.0 + (spent_ms or 0.0), 0.0, 0.0, 0, 0.0, 20, 10.0, spent_ms)), 24.0)
        told.append(pace.weak)
    assert sum(a != b for a, b in pairwise(told)) <= 1


def test_a_target_too_short_is_missed_with_the_fewest_lights():
    pace = learnt(CostModel(), spent(20.0, 0, 0.1, 0, 0.0, 72, 0.5))
    assert affordable_lights(pace, 10.0) == FEWEST
    assert least_ms(pace) == pytest.approx(20.0 + 0.5 * FEWEST)


@pytest.mark.parametrize("moving", [0.0, 0.1, 0.4, 1.0])
@pytest.mark.parametrize("target_ms", [15.0, 40.0, 100.0])
@pytest.mark.parametrize("moved", [False, True])
def test_the_target_is_held_on_a_machine_that_wavers(moving, target_ms, moved):
    """A machine like the one that draws on two cores, each cost 10 % up or down, where a share of 300 lights moves a texel a frame."""
    rng, pace, halved, took, off = np.random.default_rng(0), CostModel(), 0, [], 300.0
    for _ in range(300):
        lights = min(affordable_lights(pace, target_ms, moved) or 300, 300)
        if (wanted := halvings(pace, halved, 2)) != halved:
            halved, pace = wanted, pace._replace(backlog=1.0)
        size = 256 >> halved
        off = min(off + moving * size / 256 * lights, lights)
        work = map_work(np.full(lights, size))
        maps = affordable_maps(pace, target_ms, lights, moved, work[: int(off)])
        summed = moved or maps > 0.75 * lights
        fixed, map_ms, lookup_ms, light_ms = np.array([3.0, 0.17 * (size / 256) ** 1.5, 0.54, 0.18]) * rng.uniform(0.9, 1.1, 4)
        done = spent(fixed, maps, map_ms, None if summed else maps, lookup_ms, lights, light_ms)._replace(work=work[:maps].sum())
        pace = waited(learnt(pace, done), work, int(off), work[: int(off)].sum(), work[:maps].sum())
        off -= maps
        took.append(done.frame_ms)
    settled = np.array(took[100:])
    assert np.median(settled) <= 1.05 * target_ms
    assert np.mean(settled > 1.15 * target_ms) < 0.02
    needed = 3 + 300 * (0.18 + 0.54 * (moved or moving) + 0.17 * moving)
    assert np.median(settled) >= min(0.85 * target_ms, 0.5 * needed)


@given(st.integers(1, 30), st.integers(0, 40))
def test_fewer_lights_keep_the_power_in_each_channel(n, count):
    rng = np.random.default_rng(n)
    irradiance = rng.uniform(0, 1, (n, 3)) * (rng.uniform(0, 1, (n, 3)) > 0.3)
    lights = LightSet.of(np.arange(n), rng.normal(size=(n, 3)), irradiance)
    chosen = first_lights(lights, count)
    assert len(chosen.ids) == min(max(count, 1), n)
    left = np.setdiff1d(lights.ids, chosen.ids)
    power = lights.irradiance.max(axis=1)
    assert left.size == 0 or power[left].max() < 2 * power[chosen.ids].min() + 1e-6 * power.mean()
    assert np.allclose(chosen.irradiance.sum(axis=0), lights.irradiance.sum(axis=0), rtol=1e-5)


def test_of_lights_alike_the_first_stay_and_a_sun_stays_wherever_it_is():
    irradiance = np.random.default_rng(1).uniform(0.8, 1.2, (40, 1)) * np.ones(3)
    lights = LightSet.of(np.arange(40), np.random.default_rng(2).normal(size=(40, 3)), irradiance)
    assert first_lights(lights, 12).ids.tolist() == list(range(12))
    irradiance[33] *= 50
    assert first_lights(lights._replace(irradiance=irradiance.astype(np.float32)), 3).ids.tolist() == [0, 1, 33]


def test_a_learnt_cost_follows_the_machine():
    pace = learnt(CostModel(), spent(1.0, 10, 1.0, 0, 0.0, 10, 1.0))
    for _ in range(30):
        pace = learnt(pace, spent(1.0, 10, 4.0, 0, 0.0, 10, 1.0))
    assert pace.map_ms == pytest.approx(4.0, rel=0.01)
