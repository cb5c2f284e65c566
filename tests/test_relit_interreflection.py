"""What surfaces show of and send to each other in the browser's pictures, beside the renderer's, which follow rays of their own."""

import numpy as np
import pytest
from msgspec import structs

from tests.support.browser import CHROMIUM
from tests.support.relit_comparison import lights_of, off_edges, relative_error, sky_and_lights
from tests.support.relit_page import RelitPage, frame_bytes
from tests.support.rendering import SceneRenderer
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.browser.es_shaders import SURFEL_RAYS
from vemlight.renderer.rays.embree import library
from vemlight.renderer.scene.scene import BUNDLED_SCENE, Scene, load_scene
from vemlight.renderer.scene.scene_pose import scene_pose
from vemlight.runtime.poses import Pose, View
from vemlight.settings import Renderer

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine: the page is not tested in a browser")
DRAWING = Renderer(width=160, height=120, shadows="maps", bounces=1, frame_ms=0.0)
LARGE = structs.replace(DRAWING, width=240, height=180, background="map")
SETTLED = SURFEL_RAYS  # pictures, each with a ray more of each surfel: then all are known
RED_FLOOR = """
[camera]
from = [0.0, -4.0, 1.0]
at = [0.0, 0.0, 1.0]
fov_y = 40.0

[[mesh]]
name = "floor"
shape = "plane"
scale = 4.0
material = {diffuse = [0.6, 0.02, 0.02]}

[[mesh]]
name = "ball"
shape = "sphere"
at = [0.0, 0.0, 1.0]
material = {base_color = [1.0, 1.0, 1.0], metallic = 1.0, roughness = 0.05}
"""

# Of pictures of the same lights, of the same anew, and without time for a bounce: how often surfels are lit for each, and the last.
GATHERED = """({ bytes, width, height }) => {
    const lights = () => lightsFromBytes(Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0)).buffer).directional;
    const frame = { view: scene.cameras[0], near: [], poses: [], tone: { scale: 1, white: 0 }, width, height }, { lightPoints } = drawing;
    let count = 0;
    drawing.lightPoints = (values, area) => { // an area: of surfels
        count += area !== undefined;
        lightPoints.call(drawing, values, area);
    };
    const counted = (lights, bounces) => {
        count = 0;
        drawing.draw({ ...frame, lights, bounces });
        return count;
    };
    const same = lights(), counts = [same, same, same, lights()].map((now) => counted(now, true));
    return { counts: [...counts, counted(lights(), false)], pixels: [...drawing.readLinear()] };
}"""


@pytest.fixture
def opened(tmp_path, software_gl_browser):
    """Opens a scene of a text in a page."""
    page = software_gl_browser.new_page()

    def open_scene(text: str, drawing: Renderer = DRAWING):
        (tmp_path / "scene.toml").write_text(text)
        scene = load_scene(tmp_path / "scene.toml")
        return scene, RelitPage(page, scene, drawing)

    yield open_scene
    page.close()


def test_a_mirror_over_a_red_floor_is_red_below(opened):
    _, page = opened(RED_FLOOR)
    picture = page.picture(lights_of(24))
    ball = picture[66:84, 70:90].reshape(-1, 3)  # below the horizon that it mirrors, above its contact
    assert (ball[:, 0] > 0).all()
    # Red over green of the floor is 30; each lamp's own image in the ball adds white.
    assert np.median(ball[:, 0] / np.maximum(ball[:, 1], 1e-9)) > 15


@pytest.mark.skipif(library() is None, reason="Embree is not installed")
def test_no_ray_of_a_round_mirror_meets_the_mirror(opened):
    """On a ground that sends nothing up such rays are black dots in the mirrored sky."""
    text = RED_FLOOR.replace("diffuse = [0.6, 0.02, 0.02]", "catcher = true").replace("from = [0.0, -4.0, 1.0]", "from = [0.0, -4.0, 2.0]")
    scene, page = opened(text, LARGE)
    environment, lights = sky_and_lights("hemisphere")
    _, server = interreflected(scene, lights, None, environment)
    browser = page.picture(lights, environment=environment)
    where = off_edges(server) & (server.min(axis=2) > 0)
    assert where[60:90, 90:150].mean() > 0.5, "much of the ball's upper half"
    assert (browser > 0.5 * server)[where].all()


def test_a_closed_sphere_receives_of_itself_what_it_reflects(opened):
    """The law of integrating spheres: each point receives of the first bounce the albedo times what a lamp in the middle gives."""
    albedo = 0.6
    text = f"""
[camera]
from = [0.0, -0.6, 0.1]
at = [0.0, 0.6, 0.0]
fov_y = 60.0

[[mesh]]
name = "sphere"
shape = "sphere"
material = {{diffuse = [{albedo}, {albedo}, {albedo}]}}
"""
    lamp = NearLightSet.of(np.array([3]), np.zeros((1, 3)), np.ones((1, 3)), np.array([0.02]), np.zeros(1))
    pictures = [
        opened(text, structs.replace(DRAWING, bounces=bounces))[1].picture(LightSet.none(), near=lamp, times=SETTLED) for bounces in (0, 1)
    ]
    ratio = pictures[1] / pictures[0]
    assert np.isfinite(ratio).all()
    np.testing.assert_allclose(ratio.mean(), 1 + albedo, rtol=0.01)  # 0.2 % of the rays pass between the facets' corners
    np.testing.assert_allclose(ratio, 1 + albedo, rtol=0.06)


def interreflected(scene: Scene, lights: LightSet, view: View | None, environment: EnvironmentMap) -> list[np.ndarray]:
    """The server's pictures without and with a bounce, whose shadows are by rays."""
    made = []
    for bounces in (0, 1):
        renderer = SceneRenderer(scene, structs.replace(LARGE, shadows="rays", bounces=bounces))
        renderer.pose, renderer.background = scene_pose(scene, 0.0, (), view), environment
        made.append(np.ascontiguousarray(renderer.picture(renderer.renderer.drawable(lights), environment)[..., :3]))
        renderer.renderer.release()
    return made


@pytest.mark.skipif(library() is None, reason="Embree is not installed")
@pytest.mark.parametrize("view", [None, View(eye=(2.2, -3.2, 1.0), at=(0.9, -0.5, 0.35), fov_y=28.0)])
def test_what_surfaces_send_to_each_other_is_the_servers(software_gl_browser, view):
    """Off edges the browser's picture is as near to the server's with a bounce as it is without one, where shadows by
    rays and by maps differ: by .011 and .016 in these views."""
    scene = load_scene(BUNDLED_SCENE)
    environment, lights = sky_and_lights("hemisphere")
    dull, lit = interreflected(scene, lights, view, environment)
    page = software_gl_browser.new_page()
    browser = RelitPage(page, scene, LARGE).picture(lights, view, environment=environment, times=SETTLED)
    page.close()
    error, brought = relative_error(browser, lit), relative_error(dull, lit)
    print("relative RMSE", error, "of", brought)
    assert error < 0.03
    assert error < brought / 4
    assert browser.mean() == pytest.approx(lit.mean(), rel=0.01)


def test_what_moved_is_found_where_it_is(opened):
    """A box that came down to a red floor is lit by it as one that stood there from the start."""
    text = RED_FLOOR.replace('shape = "sphere"\nat = [0.0, 0.0, 1.0]', 'shape = "box"\nscale = 0.5\nat = [0.0, 0.0, HEIGHT]')
    text = text.replace("base_color = [1.0, 1.0, 1.0], metallic = 1.0, roughness = 0.05", "diffuse = [0.8, 0.8, 0.8]")
    lights = lights_of(24)
    _, page = opened(text.replace("HEIGHT", "2.5"))
    high = page.picture(lights, times=SETTLED)
    moved = page.picture(lights, poses=(Pose(name="ball", position=(0.0, 0.0, 0.6)),), times=1)
    assert not page.drawn["settled"]
    moved = page.picture(lights, poses=(Pose(name="ball", position=(0.0, 0.0, 0.6)),), times=SETTLED)
    assert page.drawn["settled"]
    assert np.abs(moved - high).max() > 0.1 * high.max()
    _, page = opened(text.replace("HEIGHT", "0.6"))
    there = page.picture(lights, times=SETTLED)
    assert relative_error(moved, there, 0.1) < 0.02  # of 32 rays a surfel, other ones, where its edges were cut elsewhere


def test_surfels_are_lit_once_for_each_light_and_not_without_time_for_it(opened):
    lights, size = lights_of(24), (DRAWING.width, DRAWING.height)
    _, page = opened(RED_FLOOR)
    page.picture(lights, times=SETTLED)
    made = page.page.evaluate(GATHERED, {"bytes": frame_bytes(lights), "width": size[0], "height": size[1]})
    assert made["counts"] == [1, 0, 0, 1, 0]
    text = RED_FLOOR.replace("base_color = [1.0, 1.0, 1.0], metallic = 1.0, roughness = 0.05", "diffuse = [0.8, 0.8, 0.8]")
    _, page = opened(text)
    lit = page.picture(lights, times=SETTLED)
    made = page.page.evaluate(GATHERED, {"bytes": frame_bytes(lights), "width": size[0], "height": size[1]})
    without = np.reshape(made["pixels"], (size[1], size[0], 4))[..., :3]
    _, page = opened(text, structs.replace(DRAWING, bounces=0))
    assert relative_error(without, page.picture(lights)) < 0.01 < relative_error(lit, without)
