import resource
from pathlib import Path

import moderngl
import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from tests.support.light_sets import lights_from, uniform_lights
from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.errors import FatalError, UserError
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.frame import ToneRequest
from vemlight.renderer.gl.programs import Programs, check_context, headless_context
from vemlight.renderer.passes.shadow_maps import shadow_map_plan
from vemlight.renderer.scene.scene import load_scene
from vemlight.renderer.scene.view import clip_from_world, nearest_distance, pixel_samples, ray_from_pixel
from vemlight.settings import Renderer as Settings

WHITE = "material = {diffuse = [1.0, 1.0, 1.0]}"
GROUND = f'[[mesh]]\nshape = "plane"\nscale = 4.0\n{WHITE}\n'
FROM_ABOVE = "[camera]\nfrom = [0.0, 0.0, 40.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 11.0\n"  # 7.7 m of the ground
FROM_THE_SIDE = "[camera]\nfrom = [0.0, -6.0, 3.0]\nat = [0.0, 0.0, 0.4]\nfov_y = 40.0\n"


def a_scene(folder: Path, text: str):
    path = folder / "scene.toml"
    path.write_text(text)
    return load_scene(path)


def picture(scene, lights: LightSet, samples: int = 1, **settings) -> np.ndarray:
    renderer = SceneRenderer(scene, Settings(**{"width": 96, "height": 96, "shadow_map": 128, **settings}), samples)
    try:
        return renderer.picture(lights).copy()
    finally:
        renderer.release()


@pytest.fixture(scope="module")
def pole(tmp_path_factory):
    """A renderer that looks down on a pole of height 1 in the middle of the ground; +X to the right, +Y up."""
    import trimesh

    folder = tmp_path_factory.mktemp("pole")
    tube = trimesh.creation.cylinder(radius=0.05, height=1.0)
    tube.apply_translation([0, 0, 0.5])
    tube.export(folder / "pole.obj")
    scene = a_scene(folder, FROM_ABOVE + GROUND + f'[[mesh]]\nfile = "pole.obj"\n{WHITE}')
    renderer = SceneRenderer(scene, Settings(width=256, height=256, shadow_map=256))
    yield renderer
    renderer.release()


@example_settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(theta=st.floats(0.5, 1.2), phi=st.floats(0, 2 * np.pi))
def test_a_poles_shadow_points_to_phi_plus_180_degrees(pole, theta, phi):
    image = pole.picture(lights_from(direction_from_angles(theta, phi)))[..., 0]
    row, column = np.nonzero(image < 0.5 * np.median(image))
    x, y = column + 0.5 - 128, 128 - (row + 0.5)
    far = np.hypot(x, y) > 8  # pixels; nearer is the pole itself
    assert far.sum() > 5
    direction = np.arctan2(y[far].mean(), x[far].mean())
    off = (direction - (phi + np.pi) + np.pi) % (2 * np.pi) - np.pi
    # the pole stands within a pixel of the middle and its shadow is 3 pixels wide, seen over 10 pixels or more
    assert abs(off) < np.radians(5)
    # the pole's top lies 1 m up: its shadow ends tan(theta) m away; a pixel is 40 tan(5.5 degrees) / 128 = 0.030 m
    assert np.hypot(x, y).max() * 0.0301 == pytest.approx(np.tan(theta), abs=0.06)


@pytest.mark.parametrize("shadow_map", [64, 256])
@pytest.mark.parametrize("theta", [0.4, 0.9])
def test_a_boxs_shadow_ends_where_geometry_says(tmp_path, theta, shadow_map):
    # a box from z = 0 to z = 1; under a light at azimuth 180 degrees its shadow ends at x = 0.5 + tan(theta)
    box = f'[[mesh]]\nshape = "box"\nscale = 0.5\nat = [0.0, 0.0, 0.5]\n{WHITE}'
    scene = a_scene(tmp_path, FROM_ABOVE + GROUND + box)
    image = picture(scene, lights_from(direction_from_angles(theta, np.pi)), width=512, height=512, shadow_map=shadow_map)
    pixel = 2 * 40 * np.tan(np.radians(5.5)) / 512
    for row in (256 - 20, 256, 256 + 20):
        line = image[row, :, 0] / image[row, -1, 0]
        edge = 256 + np.flatnonzero(line[256:] < 0.5).max() + 1
        found = (edge - 256) * pixel
        # the map spans the box: at most its half diagonal sqrt(0.75) m a side, in tile - 4 texels, 1 / cos(theta) wider on ground
        texel = 2 * np.sqrt(0.75) / (shadow_map - 4) / np.cos(theta)
        assert found == pytest.approx(0.5 + np.tan(theta), abs=1.5 * texel + pixel)


def test_the_picture_is_linear_in_the_lights_power(tmp_path):
    scene = load_scene(SHAPES)
    some = uniform_lights(7, 0.0)
    double = some._replace(irradiance=some.irradiance * np.array([2, 4, 8], np.float32))
    one, other = picture(scene, some), picture(scene, double)
    # powers of two scale every float exactly but for the order in which the shader adds
    assert np.allclose(one[..., :3] * [2, 4, 8], other[..., :3], rtol=1e-5)
    assert np.array_equal(one[..., 3], other[..., 3])


def test_pictures_of_lights_add_up():
    scene = load_scene(SHAPES)
    both = uniform_lights(8, 0.0)
    half = [LightSet(*(rows[part] for rows in both[:3])) for part in (slice(0, 5), slice(5, 8))]
    total = sum(picture(scene, lights)[..., :3] for lights in half)
    assert np.allclose(total, picture(scene, both)[..., :3], rtol=1e-5, atol=1e-6)


def test_no_lights_give_black_with_alpha():
    image = picture(load_scene(SHAPES), lights_from(np.zeros((0, 3))))
    assert not image[..., :3].any()
    assert image[..., 3].max() == 1
    assert image[..., 3].min() == 0
    dark = picture(load_scene(SHAPES), lights_from([0.0, 0.0, 1.0], 0.0))
    assert np.array_equal(image, dark)


@pytest.mark.parametrize("light", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, -1.0, 1e-4), (0.6, 0.0, -0.8), (0.0, 0.0, -1.0)])
def test_any_direction_and_a_huge_sun_stay_finite(light):
    direction = np.array(light) / np.linalg.norm(light)
    image = picture(load_scene(SHAPES), lights_from(direction, 1e6))
    assert np.all(np.isfinite(image))
    assert image.min() >= 0
    mirrored = picture(load_scene(SHAPES), lights_from(direction * [1, 1, -1], 1e6))
    if light[2] < 0:  # it reaches what stands on the ground neither through it nor around it but for a texel where they touch
        assert image[..., :3].sum() < 2e-3 * mirrored[..., :3].sum()
    else:
        assert image[..., :3].any()


def test_surfaces_have_two_sides(tmp_path):
    above = a_scene(tmp_path, "[camera]\nfrom = [0.0, 0.0, 5.0]\nat = [0.0, 0.0, 0.0]\n" + GROUND)
    below = a_scene(tmp_path, "[camera]\nfrom = [0.0, 0.0, -5.0]\nat = [0.0, 0.0, 0.0]\n" + GROUND)
    up, down = lights_from([0.6, 0.0, 0.8], np.pi), lights_from([0.6, 0.0, -0.8], np.pi)
    for scene, lit, dark in ((above, up, down), (below, down, up)):
        assert np.allclose(picture(scene, lit)[20:-20, 20:-20, :3], 0.8, atol=1e-4)
        assert not picture(scene, dark)[..., :3].any()


def test_a_white_plane_under_a_sky_of_radiance_1_has_radiance_1(tmp_path):
    scene = a_scene(tmp_path, FROM_ABOVE + GROUND)
    image = picture(scene, uniform_lights(2000, 0.0), width=8, height=8)
    # midpoint rule in z of the integrand 2 z: exact but for float32 sums
    assert np.allclose(image[..., :3], 1.0, atol=1e-3)


@pytest.mark.parametrize("shape", ["sphere", "box"])
def test_convex_bodies_in_a_white_furnace_have_no_shadows_of_their_own(tmp_path, shape):
    scene = a_scene(tmp_path, FROM_THE_SIDE + f'[[mesh]]\nshape = "{shape}"\nat = [0.0, 0.0, 0.4]\nrotate = [10.0, 20.0, 30.0]\n{WHITE}')
    image = picture(scene, uniform_lights(1500, -1.0), width=48, height=48, shadow_map=64)
    inside = image[..., 3] == 1
    # 1500 lights leave 0.3 % of quadrature error, lights between the smooth and the flat normal of a facet cost up to 0.1 %, and a
    # caster simplified by up to a texel costs what grazes it: 1.2 % at the worst pixel
    assert np.abs(image[inside][:, :3] - 1).max() < 0.02
    assert np.abs(image[inside][:, :3] - 1).mean() < 0.004


def test_energy_of_a_glossy_plane_stays_below_what_comes_in(tmp_path):
    glossy = GROUND.replace("diffuse = [1.0, 1.0, 1.0]", "diffuse = [0.5, 0.5, 0.5], specular = [0.5, 0.5, 0.5], exponent = 20.0")
    image = picture(a_scene(tmp_path, FROM_ABOVE + glossy), uniform_lights(2000, 0.0), width=8, height=8)
    # seen from straight above the lobe integrates to (n + 2) / (n + 2) with the cosine: 0.5 + 0.5
    assert np.allclose(image[..., :3], 1.0, atol=0.01)


def test_a_picture_of_one_pixel():
    image = picture(load_scene(SHAPES), uniform_lights(4, 0.0), width=1, height=1)
    assert image.shape == (1, 1, 4)
    assert image[0, 0, 3] == 1
    assert image[0, 0, :3].min() > 0


def test_pixels_are_means_over_their_area():
    scene, lights = load_scene(SHAPES), uniform_lights(3, 0.0)
    fine = picture(scene, lights, width=192, height=192).reshape(48, 4, 48, 4, 4).mean(axis=(1, 3))
    coarse = picture(scene, lights, samples=16, width=48, height=48)
    one = picture(scene, lights, width=48, height=48)

    def off(image):
        return float(np.sqrt(np.mean((image - fine) ** 2)))
    assert off(coarse) < 0.4 * off(one)  # 16 well-spread samples against one; both differ from the 16 of the fine picture
    assert np.abs(coarse.mean(axis=(0, 1)) - fine.mean(axis=(0, 1))).max() < 2e-3
    assert np.all(np.abs(coarse[..., 3] * 16 - np.round(coarse[..., 3] * 16)) < 1e-4)


@pytest.mark.parametrize("samples", [1, 2, 4, 7, 16])
def test_places_in_a_pixel_are_centred_and_distinct(samples):
    places = np.array([offset[:2] for offset in pixel_samples(samples)])
    assert places.min() > 0
    assert places.max() < 1
    assert np.abs(places.mean(axis=0) - 0.5).max() < 0.5 / samples
    assert len({tuple(place) for place in places.tolist()}) == samples


def test_more_lights_than_the_atlas_holds_are_drawn_in_turns(monkeypatch):
    scene, lights = load_scene(SHAPES), uniform_lights(11, 0.0)
    whole = picture(scene, lights, shadow_map=64)
    monkeypatch.setattr(shadow_map_plan, "MAX_ATLAS_SIDE", 128)  # 2 x 2 tiles of 64
    assert np.allclose(picture(scene, lights, shadow_map=64), whole, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("shadow_map", [64, None])
def test_a_renderer_draws_the_same_picture_again(shadow_map):
    scene = load_scene(SHAPES)
    renderer = SceneRenderer(scene, Settings(width=64, height=48, shadow_map=shadow_map), samples=2)
    first = renderer.picture(uniform_lights(5, 0.0)).copy()
    renderer.picture(uniform_lights(30, -1.0))
    assert np.array_equal(renderer.picture(uniform_lights(5, 0.0)), first)
    renderer.release()


def test_resolution_by_power_gives_the_picture_of_large_maps():
    sky = uniform_lights(40, 0.0)
    lights = sky._replace(irradiance=sky.irradiance * np.where(np.arange(40) == 11, 40.0, 1.0)[:, None].astype(np.float32))
    scene, made = load_scene(SHAPES), {}
    for shadow_map in (None, 1024, 64):
        made[shadow_map] = picture(scene, lights, shadow_map=shadow_map, shadows="maps")[..., :3]
    off = {size: np.sqrt(np.mean((made[size] - made[1024]) ** 2) / np.mean(made[1024] ** 2)) for size in (None, 64)}
    # The sky's maps have 64 texels, its strong light's 512. 0.015, where maps of 512 give 0.011, and 0.038 measured.
    assert off[None] < 0.02
    assert off[None] < 0.5 * off[64]


def test_two_renderers_of_one_process_do_not_disturb_each_other():
    scene, lights = load_scene(SHAPES), uniform_lights(3, 0.0)
    one = SceneRenderer(scene, Settings(width=64, height=48, shadow_map=64))
    alone = one.picture(lights).copy()
    other = SceneRenderer(scene, Settings(width=32, height=32, shadow_map=32))
    other.picture(uniform_lights(5, 0.0))
    assert np.array_equal(one.picture(lights), alone)
    other.release()
    assert np.array_equal(one.picture(lights), alone)
    one.release()


def test_the_middle_of_the_picture_is_what_the_camera_looks_at():
    scene = load_scene(SHAPES)
    clip = clip_from_world(scene, (640, 480)) @ [*scene.camera.at, 1]
    assert np.abs(clip[:2] / clip[3]).max() < 1e-9
    above = clip_from_world(scene, (640, 480)) @ [*np.add(scene.camera.at, [0, 0, 0.1]), 1]
    assert above[1] < 0  # row 0 is on top and comes first in memory


@pytest.mark.parametrize("around", ["plane", "box"])
def test_what_is_near_is_seen_in_a_wide_scene(around, tmp_path):
    """A box of half a metre, two metres from a camera on a ground of 8 km, or within a hall of 8 km: nothing cuts it away."""
    (tmp_path / "scene.toml").write_text(
        "[camera]\nfrom = [0.0, -2.5, 1.5]\nat = [0.0, 0.0, 0.25]\nfov_y = 40.0\n"
        f'[[mesh]]\nname = "around"\nshape = "{around}"\nscale = 8000.0\nmaterial = {{diffuse = [0.0, 0.0, 0.0]}}\n'
        '[[mesh]]\nname = "near"\nshape = "box"\nscale = 0.25\nat = [0.0, 0.0, 0.25]\nmaterial = {diffuse = [0.5, 0.5, 0.5]}\n'
    )
    renderer = SceneRenderer(load_scene(tmp_path / "scene.toml"), Settings(width=32, height=32))
    renderer.picture(LightSet.none())
    with renderer.renderer._context:
        pixels = renderer.renderer._g_buffer.read()
    renderer.release()
    seen = pixels.there & (np.linalg.norm(pixels.positions, axis=-1) < 0.6)
    assert 60 < seen.sum() < 200  # of 1024
    assert pixels.there.sum() >= 1000 - 400 * (around == "plane")
    shown = pixels.positions[seen & (pixels.positions[:, 2] > 0.49)]
    np.testing.assert_allclose(shown[:, 2], 0.5, atol=1e-5)


def test_the_near_plane_lies_before_all_that_can_be_seen():
    scene, size = load_scene(SHAPES)._replace(half=np.full(3, 1000.0)), (640, 480)
    for nearest_m in (0.5, 2.0):
        clip = clip_from_world(scene, size, nearest_m=nearest_m)
        for pixel in ((0.0, 0.0), (320.0, 240.0)):
            ray = ray_from_pixel(scene.camera, size) @ [*pixel, 1.0]
            place = scene.camera.position + 1.001 * nearest_m * ray / np.linalg.norm(ray)
            z, w = (clip @ [*place, 1])[2:]
            assert z >= -w
    assert nearest_distance(scene.camera, np.array([[[0, 0, 0], [1, 1, 1]], [[3, -5, 2], [4, -4, 3]]])) == 0
    box = np.array([[[3.6, -4.9, 0.0], [4.0, -4.0, 2.4]]])
    assert nearest_distance(scene.camera, box) == pytest.approx(0.5)


@pytest.mark.parametrize("frame_ms", [0.0, 20.0])
def test_frames_leak_no_memory(frame_ms):
    renderer = SceneRenderer(load_scene(SHAPES), Settings(width=8, height=8, shadow_map=128, frame_ms=frame_ms))
    request = ToneRequest(None, 0.0, 0.04)

    def peak_bytes(frames: int) -> int:
        for count in range(frames):
            # atlases of 1, 5 x 5 and 7 x 7 tiles: 0.1, 1.6 and 3.2 MB
            renderer.frame(uniform_lights((1, 20, 40)[count % 3], -1.0), tone=request)
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024

    before = peak_bytes(6)
    assert peak_bytes(45) - before < 20e6  # 15 rounds that left their atlases behind would hold 73 MB more
    renderer.release()


def test_a_shader_that_fails_is_one_line():
    context = headless_context()
    with pytest.raises(UserError, match=r"screen\.vert \+ shade\.frag") as caught:
        Programs(context).program("screen.vert", "shade.frag", MAX_LIGHTS="nonsense")
    assert "\n" not in str(caught.value)
    context.release()


def test_a_picture_beyond_the_limit_is_refused():
    with pytest.raises(UserError, match="make them smaller"):
        SceneRenderer(load_scene(SHAPES), Settings(width=10**6, height=4))


@pytest.mark.parametrize("frame_ms", [0.0, 20.0])
@pytest.mark.parametrize("timed", [False, True])
def test_every_pass_is_timed_for_a_target_or_when_asked(frame_ms, timed):
    renderer = SceneRenderer(load_scene(SHAPES), Settings(width=64, height=48, shadow_map=64, frame_ms=frame_ms), samples=2, timed=timed)
    for _ in range(2):  # a second picture begins to count again
        timings = renderer.frame(uniform_lights(5, 0.0), tone=ToneRequest(None, 0.0, 0.04)).timings
    if timed or frame_ms:
        assert set(timings.timers_ms) == {"shadow maps", "G-buffer", "classes", "lights", "read-back", "tone mapping"}
        assert min(timings.timers_ms.values()) > 0
        assert sum(timings.timers_ms.values()) <= timings.frame_ms
    else:
        assert timings.timers_ms == {}
        assert timings.frame_ms > 0
    renderer.release()


@pytest.mark.parametrize(
    ("error", "kind", "words"), [("GL_OUT_OF_MEMORY", UserError, "make them smaller"), ("GL_UNKNOWN_ERROR", FatalError, "start again")]
)
def test_a_context_that_fails_is_one_line(error, kind, words, monkeypatch):
    renderer = SceneRenderer(load_scene(SHAPES), Settings(width=8, height=8, shadow_map=16))
    monkeypatch.setattr(moderngl.Context, "error", property(lambda _: error))
    with pytest.raises(kind, match=words) as caught:
        renderer.picture(uniform_lights(3, 0.0))
    assert "\n" not in str(caught.value)
    with pytest.raises(kind, match=words):
        SceneRenderer(load_scene(SHAPES), Settings(width=8, height=8, shadow_map=16))
    monkeypatch.undo()
    renderer.release()


def test_gl_reports_no_error():
    for frame_ms in (0.0, 1000.0):
        renderer = SceneRenderer(load_scene(SHAPES), Settings(width=8, height=6, shadow_map=16, frame_ms=frame_ms), samples=2)
        for count in (1, 3, 30):
            renderer.frame(uniform_lights(count, 0.0), tone=ToneRequest(None, 0.0, 0.04))
        context = renderer.renderer._context
        with context:
            check_context(context)  # raises what the driver reports
            assert context.error == "GL_NO_ERROR"
        renderer.release()
