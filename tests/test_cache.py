import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.lights import Lights
from services.renderer import renderer as renderer_module
from services.renderer.cache import no_maps, planned_maps
from services.renderer.renderer import Renderer
from services.renderer.scene import load_scene
from services.settings import Renderer as Settings
from services.sphere import direction_from_angles

TEXEL = 1 / 252


def sky(count: int, turn: float = 0.0) -> np.ndarray:
    k = np.arange(count) + 0.5
    return direction_from_angles(np.arccos(k / count), k * 2.4 + turn).astype(np.float32)


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.arccos(np.clip((a * b).sum(axis=-1), -1, 1))


def test_the_first_frame_draws_every_map():
    plan = planned_maps(no_maps(12), sky(8), np.ones(8), 2, TEXEL)
    assert sorted(plan.renewed) == list(range(8))
    assert np.array_equal(plan.drawn[plan.tiles], sky(8))


def test_lights_that_moved_less_than_a_texel_keep_their_maps():
    first = planned_maps(no_maps(12), sky(8), np.ones(8), 4, TEXEL)
    second = planned_maps(first.drawn, sky(8, 0.9 * TEXEL), np.ones(8), 4, TEXEL)
    assert len(second.renewed) == 0
    assert np.array_equal(second.tiles, first.tiles)


def test_the_budget_goes_to_power_times_angle():
    directions, strength = sky(8), np.arange(1.0, 9.0)
    drawn = planned_maps(no_maps(12), directions, strength, 4, TEXEL).drawn
    moved = sky(8, 0.05)
    plan = planned_maps(drawn, moved, strength, 3, TEXEL)
    worth = strength * angle(directions, moved)
    assert set(np.flatnonzero(np.isin(plan.tiles, plan.renewed))) == set(np.argsort(-worth)[:3])


@given(st.integers(1, 20), st.integers(1, 20), st.lists(st.floats(0, 2), min_size=1, max_size=6))
def test_every_light_reads_a_map_and_none_that_another_reads_is_overwritten(count, budget, turns):
    drawn = no_maps(count)
    rng = np.random.default_rng(count)
    for turn in turns:
        before, directions = drawn, sky(count, turn)
        plan = planned_maps(before, directions, rng.uniform(0, 1, count), budget, TEXEL)
        drawn = plan.drawn
        assert not np.isnan(drawn[plan.tiles]).any()
        assert len(plan.renewed) <= (budget if not np.isnan(before).all() else count)
        fresh = np.isin(plan.tiles, plan.renewed)
        assert np.array_equal(drawn[plan.tiles[fresh]], directions[fresh])
        assert np.array_equal(drawn[plan.tiles[~fresh]], before[plan.tiles[~fresh]])
        assert len(np.unique(plan.renewed)) == len(plan.renewed)


def test_lights_that_stand_still_get_their_own_maps_in_the_end():
    drawn, goal = planned_maps(no_maps(30), sky(20), np.ones(20), 3, TEXEL).drawn, sky(20, 1.0)
    for _ in range(7):  # 20 lights, 3 a frame
        plan = planned_maps(drawn, goal, np.ones(20), 3, TEXEL)
        drawn = plan.drawn
    assert angle(drawn[plan.tiles], goal).max() < 1.01 * TEXEL


def test_too_few_tiles_are_refused():
    with pytest.raises(ValueError, match="too few"):
        planned_maps(no_maps(7), sky(8), np.ones(8), 2, TEXEL)


def test_with_time_enough_the_picture_is_the_one_without_a_target():
    scene, pictures = load_scene(None), []
    for frame_ms in (0.0, 1e4):
        renderer = Renderer(scene, Settings(width=64, height=48, shadow_map=64, frame_ms=frame_ms))
        for turn in (0.0, 0.3, 0.6):  # several texels of 1 / 60 rad
            lights = Lights.of(np.arange(9), sky(9, turn), np.full((9, 3), 0.3))
            picture = renderer.render(lights).copy()
        pictures.append(picture)
        renderer.release()
    # maps lie in other tiles, so edges of their triangles may round to the other texel
    assert np.mean(np.abs(pictures[0] - pictures[1]).max(axis=-1) > 1e-4) < 0.005


def test_maps_that_were_not_drawn_anew_err_by_no_more_than_their_angle(monkeypatch):
    monkeypatch.setattr(renderer_module, "affordable_lights", lambda *_: None)
    scene = load_scene(None)
    exact = Renderer(scene, Settings(width=96, height=72, shadow_map=128))
    errors = {}
    for budget in (2, 12):
        monkeypatch.setattr(renderer_module, "affordable_maps", lambda *_, budget=budget: budget)
        lazy = Renderer(scene, Settings(width=96, height=72, shadow_map=128, frame_ms=40.0))
        worst = 0.0
        for frame in range(10):
            lights = Lights.of(np.arange(48), sky(48, 0.01 * frame), np.full((48, 3), 0.1))
            truth, drawn = exact.render(lights).copy(), lazy.render(lights).copy()
            worst = max(worst, float(np.sqrt(np.mean((truth - drawn) ** 2) / np.mean(truth**2))))
        errors[budget] = worst
        lazy.release()
    exact.release()
    # 0.01 rad a frame is 1.2 texels: 12 of 48 maps a frame are at most 4 frames or 5 texels old, 2 of 48 up to 10 frames or 12 texels
    assert errors[12] < errors[2] < 0.03
    assert errors[12] < 0.015
