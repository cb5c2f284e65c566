import numpy as np
import pytest

from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer import frame_plan, pass_table
from vemlight.renderer.accumulation import MapLights
from vemlight.renderer.scene.scene import load_scene
from vemlight.runtime.poses import Pose
from vemlight.settings import Renderer as Settings

STEP = 0.5 / 256  # the most that 8 bits are off


def renderer_of(frame_ms: float) -> SceneRenderer:
    return SceneRenderer(load_scene(SHAPES), Settings(width=96, height=72, shadow_map=64, frame_ms=frame_ms))


def lights_at(turn: float, count: int = 20) -> LightSet:
    k = np.arange(count) + 0.5
    directions = direction_from_angles(np.arccos(1 - 0.9 * k / count), k * 2.4 + turn)
    return LightSet.of(np.arange(count), directions, np.full((count, 3), np.pi / count))


@pytest.fixture
def in_time():
    renderer = renderer_of(1e4)
    yield renderer
    renderer.release()


def pictures(renderer: SceneRenderer, turns: list[float]) -> list[np.ndarray]:
    return [renderer.picture(lights_at(turn)).copy() for turn in turns]


def test_still_lights_and_surfaces_give_the_picture_that_lookups_in_the_sum_give(in_time):
    cached, made = [], []
    for _ in range(3):
        made += pictures(in_time, [0.0])
        cached.append(in_time.plan.runs(pass_table.VISIBILITY_CACHE))
    assert cached == [False, True, True]  # with the first picture the surfaces come to their places
    first, second, third = made
    assert np.abs(first - second).max() < 2 * STEP
    assert np.sqrt(np.mean((first - second) ** 2) / np.mean(first**2)) < 1e-4
    assert np.array_equal(second, third)


def test_lights_that_move_are_looked_up_anew(in_time, monkeypatch):
    turns = [0.003 * frame for frame in range(12)]  # a fifth of a texel of 1 / 60 rad
    cached = pictures(in_time, turns)
    monkeypatch.setattr(frame_plan, "MAX_CACHE_BYTES", 0)
    other = renderer_of(1e4)
    summed = pictures(other, turns)
    other.release()
    for a, b in zip(cached, summed, strict=True):
        # A lookup cached for the map's direction lets its plane rise as it did there: edges differ by what a light turned since.
        assert np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2)) < 2e-3
    assert not np.array_equal(cached[0], cached[-1])


def test_what_moved_is_looked_up_anew(in_time):
    pictures(in_time, [0.0, 0.0])
    name = in_time.place(0.0)[1].name
    pose = Pose(name=name, position=(0.3, 0.4, 0.8), rotation=(0.0, 0.0, 0.0, 1.0))
    in_time.place(0.0, [pose])
    moved = pictures(in_time, [0.0, 0.0, 0.0])
    fresh = renderer_of(0.0)
    fresh.place(0.0, [pose])
    (truth,) = pictures(fresh, [0.0])
    fresh.release()
    for picture in moved:
        assert np.mean(np.abs(picture - truth).max(axis=-1) > 0.01) < 0.01


def test_fewer_and_more_lights_than_before(in_time):
    fresh = renderer_of(0.0)
    for count in (20, 5, 40, 0, 40, 1):
        lights = lights_at(0.0, count) if count else LightSet.none()
        for _ in range(2):
            picture = in_time.picture(lights).copy()
        truth = fresh.picture(lights)
        assert np.mean(np.abs(picture - truth).max(axis=-1) > 0.01) < 0.01
    fresh.release()


def test_coarser_maps_are_for_frames_in_time_alone(in_time, monkeypatch):
    monkeypatch.setattr("vemlight.renderer.frame_plan.affordable_maps", lambda *_: 1)
    pictures(in_time, [0.3 * frame for frame in range(40)])  # 20 lights wait for one map a frame
    assert set(in_time.plan.resolutions) == {16}
    light = MapLights(np.ones((8, 32, 3), np.float32), "hemisphere")
    refined = in_time.picture_of_pass(light, 0).copy()
    fresh = renderer_of(0.0)
    truth = fresh.picture_of_pass(light, 0)
    fresh.release()
    assert np.array_equal(refined, truth)
    monkeypatch.undo()
    pictures(in_time, [0.0] * 40)
    assert set(in_time.plan.resolutions) == {64}
