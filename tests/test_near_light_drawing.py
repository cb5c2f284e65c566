"""Near lights in pictures: irradiance in closed form, shadows, the directional light that a far one is, budgets."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.renderer_steps import stepped
from tests.support.rendering import SceneRenderer
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import MAX_NEAR_LIGHTS, NearLightSet
from vemlight.renderer import pass_table
from vemlight.renderer.accumulation import MapLights
from vemlight.renderer.frame_budget import MIN_LIGHTS
from vemlight.renderer.rays import near_tracing
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.renderer.stage import RendererStage
from vemlight.runtime import stamps, wire
from vemlight.settings import Renderer as Settings
from vemlight.settings import Settings as AllSettings

DARK = LightSet.none()
ABOVE = "[camera]\nfrom = [0.0, 0.0, 10.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 11.0\n"  # sees x, y from -0.963 to 0.963
GROUND = '[[mesh]]\nshape = "plane"\nscale = 4.0\nmaterial = {diffuse = [1.0, 1.0, 1.0]}\n'
BOX = '[[mesh]]\nshape = "box"\nscale = 0.1\nat = [0.1, 0.05, 0.4]\nmaterial = {diffuse = [0.5, 0.5, 0.5]}\n'  # a cube of .2 m
SIDE = 64
SEEN = 10 * np.tan(np.radians(5.5))


def near_lights(*places, intensity=(3.0, 2.0, 1.0), radius=0.0) -> NearLightSet:
    count = len(places)
    return NearLightSet.of(np.arange(count), np.array(places), np.tile(intensity, (count, 1)), np.full(count, radius), np.zeros(count))


def scene_of(folder: Path, text: str) -> Scene:
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml")


def renderer_of(scene: Scene, shadows: str = "rays", frame_ms: float = 0.0, samples: int = 1, bounces: int = 0, side: int = SIDE):
    wanted = Settings(width=side, height=side, shadows=shadows, frame_ms=frame_ms, bounces=bounces)  # type: ignore[arg-type]
    return SceneRenderer(scene, wanted, samples)


@pytest.fixture(autouse=True)
def rough_edges(monkeypatch):
    """Pictures change by their lights alone, not while their edges are found (test_edges.py)."""
    monkeypatch.setattr("vemlight.renderer.frame.EDGE_SAMPLES", 0)


@pytest.fixture
def drawn(tmp_path, request):
    """Draws scenes, and frees what that took."""
    made = []

    def draw(text: str, near: NearLightSet, lights: LightSet = DARK, **settings) -> np.ndarray:
        made.append(renderer_of(scene_of(tmp_path, text), **settings))
        made[-1].near = near
        return made[-1].picture(lights).copy()

    yield draw
    for renderer in made:
        renderer.release()


def ground_points(side: int = SIDE) -> np.ndarray:
    """World positions (side, side, 3) of the pixels of ABOVE."""
    x = ((np.arange(side) + 0.5) / (side / 2) - 1) * SEEN
    return np.stack([*np.meshgrid(x, -x), np.zeros((side, side))], axis=-1)


def irradiance(near: NearLightSet, points: np.ndarray, normal=(0.0, 0.0, 1.0)) -> np.ndarray:
    """I max(0, n . v) / |v|^2 of points, (..., 3)."""
    total = np.zeros(points.shape)
    for at, intensity in zip(near.at.astype(float), near.intensity.astype(float), strict=True):
        v = at - points
        square = (v * v).sum(axis=-1)
        total += intensity * (np.maximum(v @ np.array(normal), 0) / square**1.5)[..., None]
    return total


BOTH = pytest.mark.parametrize("shadows", ["rays", "maps"])


@BOTH
@pytest.mark.parametrize("radius", [0.0, 0.3])
def test_a_plane_receives_what_the_closed_form_says(drawn, radius, shadows):
    near = near_lights((0.3, 0.1, 1.5), (-0.5, -0.4, 0.8), radius=radius)
    picture = drawn(ABOVE + GROUND, near, shadows=shadows)
    assert np.abs(np.pi * picture[..., :3] / irradiance(near, ground_points()) - 1).max() < 1e-3


@BOTH
def test_a_far_light_is_the_directional_one(drawn, shadows):
    """A point at 100 m is the directional light I / D^2, to 1 % of the picture: both differ by 1 cm a metre, and so do their shadows."""
    direction, text = np.array([0.48, 0.36, 0.8]), ABOVE + GROUND + BOX
    far = near_lights(100 * direction, intensity=(1e4, 2e4, 3e4))
    directional = LightSet.of(np.zeros(1), direction[None], np.array([[1.0, 2.0, 3.0]]))
    for bounces in (0, 1):
        expected = drawn(text, NearLightSet.empty(), directional, bounces=bounces, shadows=shadows)[..., :3]
        made = drawn(text, far, bounces=bounces, shadows=shadows)[..., :3]
        assert np.abs(made - expected).mean() < 0.01 * expected.mean(), bounces


@BOTH
def test_a_box_casts_the_shadow_of_its_projection(drawn, shadows):
    at = np.array([-0.3, -0.2, 1.2])
    near = near_lights(at)
    picture, points = drawn(ABOVE + GROUND + BOX, near, side=128, shadows=shadows), ground_points(128)
    lit = np.pi * picture[..., 0] / irradiance(near, points)[..., 0] > 0.5
    # Slabs: where the segment from the ground to the light passes through the box.
    low, high = np.array([0.0, -0.05, 0.3]), np.array([0.2, 0.15, 0.5])
    way = at - points
    first, second = (low - points) / way, (high - points) / way
    enters, leaves = np.minimum(first, second).max(axis=-1), np.maximum(first, second).min(axis=-1)
    shaded = enters < leaves
    on_top = (np.abs(points[..., 0] / 9.5 * 10 - 0.1) < 0.115) & (np.abs(points[..., 1] / 9.5 * 10 - 0.05) < 0.115)  # the box itself
    wrong = (lit == shaded) & ~on_top
    assert shaded.sum() > 500
    assert wrong.sum() <= 0.01 * wrong.size


def test_shadows_stay_where_the_ground_is_of_kilometres(drawn):
    """As under a terrace, beside something that leans over the light: depths of maps must not be spent on what is far away."""
    leaning = '[[mesh]]\nshape = "plane"\nrotate = [0.0, -45.0, 0.0]\nat = [-0.8, 0.0, 1.6]\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'
    standing, near = leaning + BOX, near_lights((-0.3, -0.18, 1.2))
    small, large = (drawn(ABOVE + ground + standing, near, shadows="maps")[..., 0] for ground in (GROUND, GROUND.replace("4.0", "8000.0")))
    assert (small < 0.1 * small.max()).sum() > 25, "a shadow"
    assert np.abs(large - small).mean() < 0.01 * small.mean()


@BOTH
def test_what_is_nearer_than_the_radius_casts_nothing(drawn, shadows):
    cover = '[[mesh]]\nshape = "plane"\nscale = 0.3\nat = [0.0, 0.0, 1.4]\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'
    points = ground_points()[SIDE // 2 :: 8, :4]  # off the middle, which the cover hides from the camera
    for radius, passes in ((0.05, False), (0.5, True)):
        near = near_lights((0.0, 0.0, 1.5), radius=radius)
        picture = drawn(ABOVE + GROUND + cover, near, shadows=shadows)[SIDE // 2 :: 8, :4, :3]
        expected = irradiance(near, points) / np.pi
        seen = np.abs(picture / expected - 1).max() < 0.01
        assert seen == passes


HALF_SHADED = "[camera]\nfrom = [0.0, 0.0, 0.5]\nat = [0.0, 0.0, 0.0]\nfov_y = 90.0\n" + GROUND
HALF_SHADED += '[[mesh]]\nshape = "plane"\nscale = 1.0\nat = [1.0, 0.0, 1.0]\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'


def half_shaded(near: NearLightSet, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Of a row of HALF_SHADED's pixels under a light 2 m up, 0.2 m in radius: radiance without shadows, the fraction that arrives."""
    x = ((np.arange(side) + 0.5) / (side / 2) - 1) * 0.5
    t = np.clip(-x / 0.2, -1, 1)  # the shadow's edge in radii of the disc
    whole = irradiance(near, np.stack([x, np.zeros(side), np.zeros(side)], axis=-1))[..., 0] / np.pi
    return whole, 0.5 + (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi


def test_penumbrae_get_better_all_through_a_pause(tmp_path):
    """A ray of each pixel a pass: after 16 passes like the sixteen of a file, and better after 64."""
    renderer = renderer_of(scene_of(tmp_path, HALF_SHADED), frame_ms=10_000.0)
    renderer.near = near = near_lights((0.0, 0.0, 2.0), radius=0.2)
    expected, exact = half_shaded(near, SIDE)
    dark, total, errors = MapLights(np.zeros((4, 8, 3), np.float32), "hemisphere"), np.zeros((8, SIDE)), []
    for number in range(64):
        total += renderer.picture_of_pass(dark, number)[28:36, :, 0] / expected
        errors.append(np.sqrt(np.mean((total / (number + 1) - exact) ** 2)))
    renderer.release()
    assert errors[15] < 0.03
    assert errors[63] < 0.7 * errors[15]


@pytest.mark.parametrize("live", [False, True])
def test_the_penumbra_of_a_ball_is_that_of_its_disc(drawn, live):
    """A long edge half way up: the penumbra is as wide as the ball, and in its middle half of the disc is seen. Live it is as smooth."""
    near = near_lights((0.0, 0.0, 2.0), radius=0.2)
    picture = drawn(HALF_SHADED, near, side=128, samples=1 if live else 16, frame_ms=10_000.0 if live else 0.0)
    expected, exact = half_shaded(near, 128)
    fraction = picture[62:66, :, 0].mean(axis=0) / expected
    smooth = picture[56:72, :, 0] / expected
    assert np.abs(fraction - exact).max() < 0.06
    assert np.abs(fraction - exact).mean() < 0.01
    assert smooth.std(axis=0).max() < 1 / 15  # along the edge, where all rays together have steps of a sixteenth


def test_a_ball_half_in_a_wall_lights_it_live_as_its_disc_does(drawn):
    """Live a pixel has few rays, and where the surface itself cuts the ball all of them may go below it: it is lit all the same."""
    near = near_lights((0.1, 0.05, 0.02), radius=0.05)
    points = ground_points()
    v = near.at[0].astype(float) - points
    distance = np.linalg.norm(v, axis=-1)
    sine, cosine = 0.05 / np.maximum(distance, 0.05), v[..., 2] / distance
    t = np.clip(cosine / sine, -1, 1)
    w = np.sqrt(1 - t * t)
    disc = sine * (t / 2 + (t * t * w + t * np.arcsin(t) + 2 / 3 * w**3) / np.pi)  # near_light.glsl
    expected = (disc + np.maximum(cosine - sine, 0)) / np.maximum(distance, 0.05) ** 2
    for frame_ms in (0.0, 10_000.0):
        picture = drawn(ABOVE + GROUND, near, frame_ms=frame_ms)[..., :3] * np.pi
        assert picture == pytest.approx(expected[..., None] * near.intensity[0], rel=0.01), frame_ms


@BOTH
def test_a_room_returns_its_light(tmp_path, shadows):
    """Power law: what a light sends out falls on the walls of a closed room about it."""
    camera = "[camera]\nfrom = [0.0, 0.0, 0.0]\nat = [0.0, 1.0, 0.0]\nfov_y = 90.0\n"
    room = '[[mesh]]\nshape = "box"\nscale = 1.0\nmaterial = {diffuse = [1.0, 1.0, 1.0]}\n'
    renderer = renderer_of(scene_of(tmp_path, camera + room), shadows)
    renderer.near = near_lights((0.0, 0.0, 0.0), intensity=(1.0, 1.0, 1.0), radius=0.1)
    wall = renderer.picture(DARK)[..., 0] * np.pi  # irradiance on one of six like walls
    renderer.release()
    assert 6 * wall.mean() * 4 == pytest.approx(4 * np.pi, rel=2e-3)  # 4 m^2 each


@BOTH
def test_256_lights_are_each_drawn(drawn, shadows):
    rng = np.random.default_rng(1)
    places = np.concatenate([rng.uniform(-2, 2, (MAX_NEAR_LIGHTS, 2)), rng.uniform(0.5, 3, (MAX_NEAR_LIGHTS, 1))], axis=1)
    near = near_lights(*places)
    assert np.abs(np.pi * drawn(ABOVE + GROUND, near, shadows=shadows)[..., :3] / irradiance(near, ground_points()) - 1).max() < 1e-3


def test_no_near_light_costs_nothing(tmp_path):
    renderer = renderer_of(scene_of(tmp_path, ABOVE + GROUND), frame_ms=100.0)
    dark_lamp = near_lights((0.0, 0.0, 1.0), intensity=(0.0, 0.0, 0.0))
    for near in (NearLightSet.empty(), dark_lamp):
        renderer.near = near
        renderer.picture(LightSet.of(np.zeros(1), np.array([[0.0, 0.0, 1.0]]), np.ones((1, 3))))
        assert not {pass_table.NEAR_RAYS, pass_table.NEAR_LIGHTS} & {run.row for run in renderer.plan.passes}
    assert not renderer.renderer._near.made
    renderer.release()


@pytest.mark.parametrize("height", [2e-4, 5e-4, 2e-3])
def test_irradiance_grows_no_further_within_a_millimetre(drawn, height):
    """Drawn as NearLightSet.irradiance_at has it."""
    below = ground_points()[SIDE // 2, SIDE // 2]
    near = near_lights(below + np.array([0.0, 0.0, height]), intensity=(3e-6, 2e-6, 1e-6))
    picture = drawn(ABOVE + GROUND, near)
    assert picture[SIDE // 2, SIDE // 2, :3] * np.pi == pytest.approx(near.irradiance_at(below)[0], rel=0.02)


def test_maps_of_a_light_that_moved_a_little_are_read_as_they_were_drawn(tmp_path):
    """Across the edge between two faces of the cube, too: they lie about where the light stood then."""
    cover = '[[mesh]]\nshape = "plane"\nscale = 0.0833\nat = [0.5417, 0.0, 0.1]\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'
    renderer = renderer_of(scene_of(tmp_path, ABOVE + GROUND + cover), "maps", frame_ms=1000.0, side=256)
    pictures = []
    for x in (0.0, 0.06):  # an eighth of the radius is 0.069
        renderer.near = near_lights((x, 0.0, 0.6), radius=0.55)
        pictures.append(renderer.picture(DARK)[..., 0].copy())
    assert len(renderer.plan.near[0].traced) == 0
    renderer.release()
    points = ground_points(256)
    shaded = (np.abs(points[..., 0] - 0.69) < 0.05) & (np.abs(points[..., 1]) < 0.08)  # 0.55 to 0.75 by projection, less the cover itself
    assert shaded.sum() > 200
    for picture in pictures:
        assert picture[shaded].max() < 0.01 * picture.max()


def test_extreme_lights_stay_finite(drawn):
    near = near_lights((0.0, 0.0, 0.0), (0.1, 0.1, 1e-6), (0.0, 0.0, 2.0), intensity=(3e38, 1e-38, 1.0))
    assert np.isfinite(drawn(ABOVE + GROUND, near)).all()


@BOTH
def test_a_light_that_stays_is_traced_once_and_one_that_moves_again(tmp_path, shadows):
    renderer = renderer_of(scene_of(tmp_path, ABOVE + GROUND + BOX), shadows, frame_ms=1000.0)
    traced = []
    for shift in (0.0, 0.0, 1e-4, 0.3, 0.3):
        renderer.near = near_lights((-0.3 + shift, 0.0, 1.2), (0.5, 0.5, 1.0))
        renderer.picture(DARK)
        traced.append(len(renderer.plan.near[0].traced))
    moved = renderer.picture(DARK).copy()
    renderer.release()
    assert traced == [2, 0, 0, 1, 0]
    again = renderer_of(scene_of(tmp_path, ABOVE + GROUND + BOX), shadows, frame_ms=1000.0)
    again.near = near_lights((0.0, 0.0, 1.2), (0.5, 0.5, 1.0))
    assert again.picture(DARK) == pytest.approx(moved, abs=2e-3)
    again.release()


@BOTH
def test_a_state_drawn_again_gives_the_same_picture(tmp_path, shadows):
    renderer = renderer_of(scene_of(tmp_path, ABOVE + GROUND + BOX), shadows, frame_ms=1000.0)
    renderer.near = near_lights((-0.3, 0.0, 1.2), radius=0.1)
    renderer.picture(DARK)
    state = renderer.state
    expected = renderer.picture(DARK).copy()
    renderer.near = near_lights((0.3, 0.4, 0.8), radius=0.2)
    renderer.picture(DARK)
    renderer.state, renderer.near = state, near_lights((-0.3, 0.0, 1.2), radius=0.1)
    assert np.array_equal(renderer.picture(DARK), expected)
    renderer.release()


CATCHER = '[[mesh]]\nshape = "plane"\nscale = 4.0\nmaterial = {catcher = true}\n'


@pytest.mark.parametrize("samples", [1, 4])
def test_a_catcher_loses_what_shadows_take_of_all_its_light_there(drawn, samples):
    """A near and a directional light: alpha on the ground is the part of both together that the box takes."""
    near, sun = near_lights((-0.3, -0.2, 1.2)), LightSet.of(np.zeros(1), np.array([[0.6, 0.0, 0.8]]), np.array([[1.5, 1.0, 0.5]]))
    lit = {
        name: drawn(ABOVE + GROUND + BOX, points, lights, samples=samples)[..., 0] * np.pi
        for name, points, lights in (("near", near, DARK), ("sun", NearLightSet.empty(), sun))
    }
    whole = irradiance(near, ground_points())[..., 0] + 1.2
    taken = 1 - (lit["near"] + lit["sun"]) / whole
    picture = drawn(ABOVE + CATCHER + BOX, near, sun, samples=samples)
    ground = picture[..., 0] == 0  # not the box
    assert ground.sum() > 0.9 * ground.size
    assert np.abs(picture[..., 3] - taken)[ground].max() < 0.01
    assert taken[ground].max() > 0.3


def test_a_mirror_shows_what_a_near_light_lights_and_not_what_it_does_not(drawn):
    """A polished wall beside a white floor: its image of the floor is as bright as the floor itself, before it and behind a screen."""
    camera = "[camera]\nfrom = [-2.0, 0.0, 0.6]\nat = [1.0, 0.0, 0.3]\nfov_y = 40.0\n"
    wall = '[[mesh]]\nshape = "plane"\nscale = 2.0\nrotate = [0.0, 90.0, 0.0]\nat = [1.0, 0.0, 0.0]\n'
    wall += "material = {base_color = [1.0, 1.0, 1.0], metallic = 1.0, roughness = 0.05}\n"
    screen = '[[mesh]]\nshape = "plane"\nscale = 3.0\nat = [0.0, 0.0, 1.0]\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'
    lit = drawn(camera + GROUND + wall, near_lights((0.0, 0.0, 1.2)), bounces=1, samples=4)
    behind = drawn(camera + GROUND + wall + screen, near_lights((0.0, 0.0, 1.2)), bounces=1, samples=4)
    height, tall = SIDE, np.tan(np.radians(20.0))
    # A mirrored pixel sees the floor at twice the wall's distance less x; the middle column, rows below the camera's middle.
    pitch = np.arctan2(0.3, 3.0)
    checked = 0
    for row in range(height // 2, height):
        down = pitch + np.arctan((2 * (row + 0.5) / height - 1) * tall)
        x = -2.0 + 0.6 / np.tan(down)  # where the ray would meet the floor, behind the wall
        if 1.1 < x < 2.5:
            expected = irradiance(near_lights((0.0, 0.0, 1.2)), np.array([[2.0 - x, 0.0, 0.0]]))[0, 0] / np.pi
            assert lit[row, SIDE // 2, 0] == pytest.approx(expected, rel=0.12)
            assert behind[row, SIDE // 2, 0] < 0.02 * expected
            checked += 1
    assert checked >= 5


def test_coarse_pixels_do_for_weak_wide_lights_alone_and_change_little(tmp_path):
    """Live in large pictures: eight like lamps, of which none has three tenths of the light, and one that is small."""
    text = ABOVE + GROUND + BOX
    turn = np.arange(8) * np.pi / 4
    places = np.stack([1.2 * np.cos(turn), 1.2 * np.sin(turn), np.full(8, 1.5)], axis=-1)
    lamps = near_lights(*places, radius=0.15)
    lamps = NearLightSet(lamps.ids, lamps.at, lamps.intensity, np.where(lamps.ids == 7, 0.0, lamps.radius).astype(np.float32), lamps.sigma)
    pictures = []
    for frame_ms in (0.0, 10_000.0):
        wanted = Settings(width=400, height=300, shadows="rays", frame_ms=frame_ms, bounces=0)
        renderer = SceneRenderer(scene_of(tmp_path, text), wanted, 1)
        renderer.near = lamps
        pictures.append(renderer.picture(DARK)[..., :3].copy())
        (batch,) = renderer.plan.near
        assert set(batch.lights.ids[batch.coarse].tolist()) == (set(range(7)) if frame_ms else set())
        renderer.release()
    whole, live = pictures
    assert np.sqrt(np.mean((live - whole) ** 2) / np.mean(whole**2)) < 0.02


def test_the_first_near_lights_wait_for_no_compiler(tmp_path):
    """What `warm` compiled is what one light, several, and those on coarse pixels run."""
    wanted = Settings(width=400, height=300, shadows="rays", frame_ms=10_000.0, bounces=0)
    renderer = SceneRenderer(scene_of(tmp_path, ABOVE + GROUND + BOX), wanted, 1)
    renderer.renderer.warm(near=True)
    for places in ([(0.3, 0.1, 1.5)], [(np.cos(turn), np.sin(turn), 1.5) for turn in range(5)]):
        renderer.near = near_lights(*places, radius=0.15)
        renderer.picture(DARK)
    assert renderer.plan.near[0].coarse.any()
    renderer.release()
    kernels = (near_tracing._trace, near_tracing._smooth, near_tracing._spread)
    assert [len(kernel.signatures) for kernel in kernels] == [1, 1, 1]


def test_the_renderer_takes_points_and_says_how_many_it_leaves_out(tmp_path):
    """Live: in a time too short for them all, of 40 lamps the report says how many there are and how many are not drawn."""
    settings = Settings(scene=str(tmp_path / "scene.toml"), width=SIDE, height=SIDE, shadows="rays", frame_ms=1e-3, bounces=0)
    scene_of(tmp_path, ABOVE + GROUND)
    stage = RendererStage(AllSettings(renderer=settings))
    state, _ = stage.start_at(0)
    turn = np.arange(40) * np.pi / 20
    lamps = near_lights(*np.stack([np.cos(turn), np.sin(turn), np.full(40, 1.5)], axis=-1))
    lamps.intensity[3] = 0.0
    header = wire.PointsMessage(stamp=stamps.stamp(0, 0.0), count=40)
    message = wire.unpack(wire.pack(header, lamps.arrays()))
    reports = []
    for sequence in range(6):
        state = stage.on_message(state, message)
        state, image = stepped(stage, state, sequence)
        reports.append((image.report.near_lights, image.report.left_out_near_lights))
    assert reports[0] == (39, 0)  # before costs are known all are drawn
    assert reports[-1] == (39, 39 - MIN_LIGHTS)
    stage._renderer.release()
