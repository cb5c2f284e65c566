"""Weak lights on coarse pixels: as on all pixels but for what is finer than two, strong lights with their edges, kept and drawn again."""

import numpy as np
import pytest

from tests.support.light_sets import sky_and_sun, uniform_lights
from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.near_lights import NearLightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer import frame_plan, pass_table
from vemlight.renderer.frame_plan import with_newest
from vemlight.renderer.passes.lights.traced_lights import live_rays
from vemlight.renderer.passes.lights.weak_lights import LEAST_BY_NORMAL, light_by_normal
from vemlight.renderer.passes.near_lights.near_light_plan import LitBy
from vemlight.renderer.rays.soft_pattern import POINT, STRATA, soft_pattern
from vemlight.renderer.rays.tracing import TracedLights
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings


@pytest.fixture(autouse=True)
def rough_edges(monkeypatch):
    monkeypatch.setattr("vemlight.renderer.frame.EDGE_SAMPLES", 0)


def renderer_of(coarse: bool, monkeypatch, bounces: int = 0, size: tuple[int, int] = (97, 73)) -> SceneRenderer:
    monkeypatch.setattr(frame_plan, "COARSE_FROM", 0 if coarse else 10**9)
    return SceneRenderer(load_scene(SHAPES), Settings(width=size[0], height=size[1], frame_ms=1e4, bounces=bounces, light_regions=0))


@pytest.mark.parametrize("bounces", [0, 1])
def test_a_quarter_of_the_pixels_stands_for_all(monkeypatch, bounces):
    lights, pictures = sky_and_sun(), []
    environment = EnvironmentMap(np.ones((9, 36, 3), np.float32), "hemisphere")
    for coarse in (False, True):
        renderer = renderer_of(coarse, monkeypatch, bounces)
        pictures.append(renderer.picture(lights, environment).copy())
        assert renderer.plan.runs(pass_table.WEAK_LIGHTS) == coarse
        renderer.release()
    whole, quarter = (picture[..., :3] for picture in pictures)
    assert np.array_equal(pictures[0][..., 3], pictures[1][..., 3])
    assert quarter.mean() == pytest.approx(whole.mean(), rel=0.01)
    error = np.sqrt(np.mean((quarter - whole) ** 2) / np.mean(whole**2))
    assert error < 0.06  # contacts are as wide as a few of these pixels


def test_strong_lights_and_points_are_summed_on_all_pixels(monkeypatch):
    lights = sky_and_sun()
    assert live_rays(lights)[8] == STRATA
    assert (np.delete(live_rays(lights), 8) == 1).all()
    renderer = renderer_of(True, monkeypatch)
    renderer.picture(lights)
    strong, weak = renderer.plan.batches
    assert strong.of(strong.every)["number"].tolist() == [8]
    assert sorted(weak.of(weak.every)["number"].tolist()) == [k for k in range(21) if k != 8]
    points = uniform_lights(9, 0.1)
    assert (live_rays(points) == POINT).all()
    renderer.picture(points)
    assert len(renderer.plan.batches) == 1
    assert not renderer.plan.runs(pass_table.WEAK_LIGHTS)
    renderer.release()


def test_coarse_layers_are_kept_traced_again_when_lights_turn_and_drawn_again(monkeypatch):
    renderer = renderer_of(True, monkeypatch, bounces=1)
    renderer.picture(sky_and_sun())
    assert [batch.unknown.count for batch in renderer.plan.batches] == [1, 20]
    state = renderer.state
    renderer.picture(sky_and_sun())
    assert [batch.unknown.count for batch in renderer.plan.batches] == [0, 0]
    expected = renderer.picture(sky_and_sun(0.006)).copy()
    assert [batch.unknown.count for batch in renderer.plan.batches] == [1, 0]  # an eighth of a spread for the others
    renderer.picture(sky_and_sun(1.0))
    assert [batch.unknown.count for batch in renderer.plan.batches] == [1, 20]
    renderer.state = state
    renderer.picture(sky_and_sun())
    assert np.array_equal(renderer.picture(sky_and_sun(0.006)), expected)
    renderer.release()


@pytest.mark.parametrize("spread", [0.004, 0.1])
def test_rays_that_agree_stand_for_all_of_a_strong_light(monkeypatch, spread):
    renderer = renderer_of(False, monkeypatch, size=(160, 120))
    renderer.picture(sky_and_sun())
    tracer = renderer.renderer._rays._tracer  # type: ignore[union-attr]
    axes = np.array([[[spread, 0, 0], [0, 0.8 * spread, -0.6 * spread]]], np.float32)
    light = TracedLights(np.array([[0.0, 0.6, 0.8]], np.float32), axes, np.array([STRATA]))
    whole, part = (tracer.trace(light, soft_pattern(0, 1), each).astype(int) for each in (True, False))
    partly = (whole > 0) & (whole < 255)
    assert partly.mean() > 0.005  # there are penumbrae
    assert np.abs(part - whole).mean() < 255 * 0.002
    assert np.abs(part - whole)[partly].mean() < 255 * 0.06
    renderer.release()


def test_light_by_normal_is_the_irradiance_of_a_wide_sky():
    directions = direction_from_angles(np.arccos(1 - (np.arange(4000) + 0.5) / 4000), np.arange(4000) * 2.4)
    c = light_by_normal(directions, np.full((4000, 3), np.pi / 2000))  # a hemisphere of radiance 1 above: pi (1 + n.z) / 2
    normals = direction_from_angles(np.linspace(0, np.pi, 9), np.arange(9.0))
    x, y, z = normals.T
    found = np.stack([np.ones(9), y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y], axis=-1) @ c
    assert found == pytest.approx(np.pi * (1 + z) / 2, abs=0.03)
    assert LEAST_BY_NORMAL * c[0] == pytest.approx(0.25 * np.pi / 2, rel=0.01)


def test_sets_of_the_bounce_are_gathered_in_turn_until_all_are_under_the_same_lights():
    one, other, again = (LitBy(lights, NearLightSet.empty()) for lights in (sky_and_sun(), sky_and_sun(1.0), sky_and_sun()))
    gathered = {}
    for k in range(4):
        gathered = with_newest(gathered, one, 4)
        assert list(gathered) == list(range(k + 1))
    assert with_newest(gathered, again, 4) is gathered
    gathered = with_newest(with_newest(gathered, other, 4), other, 4)
    assert list(gathered) == [2, 3, 0, 1]
    assert [gathered[k] is other for k in range(4)] == [True, True, False, False]
    assert with_newest({}, one, 4, first=3) == {3: one}
    lamp = NearLightSet.of(np.zeros(1), np.ones((1, 3)), np.ones((1, 3)), np.zeros(1), np.zeros(1))
    assert with_newest(gathered, other._replace(near=lamp), 4) is not gathered
