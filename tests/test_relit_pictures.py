"""The browser's pictures beside the renderer's, under the same lights: the same numbers but at edges, where a rasteriser decides."""

import numpy as np
import pytest

from tests.support.browser import CHROMIUM
from tests.support.relit_comparison import lights_of, relative_error, sky_and_lights
from tests.support.relit_page import RelitPage
from tests.support.rendering import SceneRenderer
from vemlight.light.colour import LUMINANCE_WEIGHTS, srgb_from_linear
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.light.reflected_light import ReflectedLight
from vemlight.renderer import frame_plan
from vemlight.renderer.scene.scene import BUNDLED_SCENE, Scene, load_scene
from vemlight.renderer.scene.scene_pose import scene_pose
from vemlight.runtime.poses import Pose, View
from vemlight.settings import Renderer

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")
DRAWING = Renderer(width=240, height=180, shadows="maps", bounces=0, frame_ms=0.0, background="map")
LIMIT = 0.01


def server_picture(
    scene: Scene,
    lights: LightSet,
    view: View | None = None,
    poses: tuple[Pose, ...] = (),
    near: NearLightSet | None = None,
    environment: EnvironmentMap | None = None,
) -> np.ndarray:
    renderer = SceneRenderer(scene, DRAWING)
    renderer.near = near or NearLightSet.empty()
    renderer.pose = scene_pose(scene, 0.0, poses, view)
    renderer.background = environment
    picture = np.ascontiguousarray(renderer.picture(renderer.renderer.drawable(lights), environment)[..., :3])
    renderer.renderer.release()
    return picture


@pytest.fixture(scope="module", params=["terrace.toml", "headlights.toml"])
def drawn(request, software_gl_browser):
    """A bundled scene, without its lamps, and its page."""
    scene = load_scene(BUNDLED_SCENE.parent / request.param)._replace(luminaires=())
    page = software_gl_browser.new_page()
    yield scene, RelitPage(page, scene, DRAWING)
    page.close()


def test_both_pictures_are_the_same_off_edges(drawn):
    scene, page = drawn
    lights = lights_of(72)
    error = relative_error(page.picture(lights), server_picture(scene, lights))
    print("relative RMSE", error)
    assert page.drawn["points"] == 72
    assert error < LIMIT


def test_soft_lights_are_the_same(drawn, monkeypatch):
    """Lobes are as wide as each point's light, which the renderer's points alone do not tell."""
    scene, page = drawn
    wide = ReflectedLight(None, "hemisphere", np.ones(3), np.ones(24), np.full(24, 0.03), np.zeros(24))
    monkeypatch.setattr(frame_plan, "reflected_light", lambda *_: wide)
    lights = lights_of(6)
    across = np.eye(3) - lights.directions[:, :, None] * lights.directions[:, None, :]
    covariances = (0.03 * across).reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]].astype(np.float32)
    soft = lights._replace(covariances=covariances)
    error = relative_error(page.picture(soft), server_picture(scene, soft))
    print("relative RMSE", error)
    assert page.drawn["points"] == 24
    assert error < LIMIT


def test_moved_objects_from_a_turned_camera_are_the_same(drawn):
    scene, page = drawn
    lights = lights_of(12)
    view = View(eye=(-2.6, -4.1, 2.4), at=(0.3, 0.1, 0.5), fov_y=38.0)
    ball = next(pose for pose in scene.objects if pose.name == "ball")
    x, y, z = ball.position
    poses = (Pose(name="ball", position=(x - 0.9, y - 0.4, z + 0.2), rotation=(0.0, 0.6, 0.0, 0.8), scale=1.5),)
    error = relative_error(page.picture(lights, view, poses), server_picture(scene, lights, view, poses))
    print("relative RMSE", error)
    assert error < LIMIT


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
def test_the_sky_is_the_same_behind_the_scene_and_in_what_is_polished(drawn, coverage):
    scene, page = drawn
    environment, lights = sky_and_lights(coverage)
    view = View(eye=(0.4, -5.0, 1.1), at=(0.1, 0.0, 1.2), fov_y=45.0)  # with much of the sky
    browser = page.picture(lights, view, environment=environment)
    server = server_picture(scene, lights, view, environment=environment)
    error = relative_error(browser, server)
    print("relative RMSE", error)
    assert error < LIMIT
    assert relative_error(page.picture(lights, view), server) > 10 * LIMIT, "the sky is much of the picture"


def near_lights(scene: Scene, count: int) -> NearLightSet:
    """Lamps around what the camera looks at, with radii of .02 to .2 m, among the things that stand there."""
    random, turn = np.random.default_rng(3), np.arange(count) * 2 * np.pi / count
    around = np.stack([1.6 * np.cos(turn), 1.6 * np.sin(turn), random.uniform(0.6, 1.8, count)], axis=-1)
    intensity = np.geomspace(0.3, 3, count)[:, None] / count * [[1.0, 0.8, 0.5]]
    at = np.append(scene.camera.at[:2], 0.0) + around
    return NearLightSet.of(np.arange(count) + 7, at, random.permutation(intensity), np.linspace(0.02, 0.2, count), np.zeros(count))


@pytest.mark.parametrize(("near_count", "count"), [(8, 16), (8, 0), (0, 0)])
def test_near_lights_stand_where_they_are(drawn, near_count, count):
    scene, page = drawn
    lights, near = lights_of(count) if count else LightSet.none(), near_lights(scene, near_count)
    browser, server = page.picture(lights, near=near), server_picture(scene, lights, near=near)
    assert page.drawn["near"] == near_count
    assert page.drawn["lights"] == near_count + count
    if not near_count:
        assert not browser.any()
        return
    least = 0.4 if count else 0.2  # a lamp leaves much in the dark, where no level has a tenth of itself
    error = relative_error(browser, server, least)
    print("relative RMSE", error)
    assert error < LIMIT
    assert relative_error(page.picture(lights), server, least) > 10 * LIMIT, "they are much of the light"


def test_shadow_maps_of_near_lights_are_drawn_when_something_moves(drawn):
    scene, page = drawn
    near, drawn_maps = near_lights(scene, 5), []
    near = NearLightSet(near.ids + 100, *near.arrays()[1:])  # no test before had them
    moved = NearLightSet.of(near.ids, near.at + np.array([[0.3, 0, 0]] + [[0, 0, 0]] * 4), near.intensity, near.radius, near.sigma)
    poses = (Pose(name="ball", position=(0.5, 0.4, 0.9)),)
    fewer = NearLightSet(*(array[1:] for array in moved.arrays()))
    for each, placed in ((near, ()), (near, ()), (moved, ()), (fewer, ()), (moved, ()), (moved, poses)):
        page.picture(LightSet.none(), poses=placed, near=each)
        drawn_maps.append(page.drawn["maps"])
    assert drawn_maps == [5, 0, 1, 0, 0, 5]
    assert relative_error(page.picture(LightSet.none(), near=moved), server_picture(scene, LightSet.none(), near=moved), 0.2) < LIMIT


def test_more_lights_than_there_is_room_for_are_said(drawn):
    """10,000 lights: the strongest 512 are drawn."""
    _, page = drawn
    many = lights_of(10_000)
    strongest = np.argsort(-(many.irradiance @ LUMINANCE_WEIGHTS), kind="stable")[:512]
    whole, _ = page.shown(many, 24, 18)
    assert (page.drawn["lights"], page.drawn["left"]) == (512, 9488)
    few, _ = page.shown(LightSet.of(many.ids[strongest], many.directions[strongest], many.irradiance[strongest]), 24, 18)
    assert page.drawn["left"] == 0
    np.testing.assert_allclose(whole, few, rtol=1e-3, atol=1e-5)


def test_the_canvas_shows_the_picture_tone_mapped_at_any_size(drawn):
    _, page = drawn
    for width, height in ((240, 180), (60, 45), (120, 90), (240, 180)):
        linear, codes = page.shown(lights_of(4), width, height)
        level = np.maximum(linear @ LUMINANCE_WEIGHTS, 1e-3)[..., None]
        wanted = 255 * srgb_from_linear(np.clip(linear * (1 - np.exp(-level)) / level, 0, 1))
        covered = (codes[..., 3] == 255) & (linear @ LUMINANCE_WEIGHTS > 1e-3)
        assert covered.mean() > 0.3
        assert np.abs(wanted - codes[..., :3])[covered].max() < 1.5
