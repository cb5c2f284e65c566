"""Names, poses and animations of objects, and that a picture of what was moved is the picture of what is placed there."""

from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as example_settings
from hypothesis import strategies as st

from tests.support.gl_objects import gl_objects
from tests.support.gltf_files import AnimatedTriangle
from tests.support.light_sets import lights_from, uniform_lights
from tests.support.rendering import SceneRenderer
from vemlight.errors import UserError
from vemlight.light.sphere import direction_from_angles, quaternion_xyz
from vemlight.renderer import frame_plan, near_planning
from vemlight.renderer.passes.shadow_maps.casters import moved_by_m, placed_casters, scene_casters
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.renderer.scene.scene_pose import scene_pose
from vemlight.runtime.poses import Pose
from vemlight.settings import Renderer as Settings

CAMERA = "[camera]\nfrom = [0.0, -7.0, 4.0]\nat = [0.0, 0.0, 0.4]\nfov_y = 40.0\n"
GROUND = '[[mesh]]\nshape = "plane"\nscale = 3.0\n'
LIGHTS = lights_from(direction_from_angles(np.array([0.3, 0.7, 1.0]), np.array([0.0, 2.0, 4.0])))


def a_scene(folder: Path, text: str) -> Scene:
    (folder / "scene.toml").write_text(CAMERA + text)
    return load_scene(folder / "scene.toml")


def box(at: str, rotate: str = "[0.0, 0.0, 0.0]") -> str:
    return f'[[mesh]]\nshape = "box"\nscale = 0.4\nat = {at}\nrotate = {rotate}\nmaterial = {{diffuse = [0.8, 0.2, 0.2]}}\n'


def renderer_of(scene: Scene, **settings) -> SceneRenderer:
    return SceneRenderer(scene, Settings(**{"width": 96, "height": 72, "shadow_map": 256, **settings}))


def pose(name: str, at: tuple[float, float, float], rotate=(0.0, 0.0, 0.0), power: float | None = None) -> Pose:
    return Pose(name=name, position=at, rotation=quaternion_xyz(rotate), power=power)


def relative_rmse(a: np.ndarray, b: np.ndarray) -> float:
    """Relative RMSE of colours."""
    return float(np.sqrt(np.mean((a[..., :3] - b[..., :3]) ** 2)) / np.sqrt(np.mean(b[..., :3] ** 2)))


def test_objects_have_names_of_their_own(tmp_path):
    crate = box("[0.0, 0.0, 1.0]") + 'name = "crate"\n'
    scene = a_scene(tmp_path, GROUND + crate + 2 * box("[1.0, 0.0, 1.0]") + "[[luminaire]]\npower = 2.0\n")
    assert [each.name for each in scene.objects] == ["plane", "crate", "box", "box 2", "torch"]
    assert [each.power for each in scene.objects] == [None, None, None, None, 2.0]
    assert scene.objects[1].position == (0.0, 0.0, 1.0)
    with pytest.raises(UserError, match="crate is the name of several"):
        a_scene(tmp_path, 2 * crate)


@pytest.mark.parametrize("frame_ms", [0.0, 1000.0])
def test_what_was_moved_looks_as_if_it_had_always_stood_there(tmp_path, frame_ms):
    there = renderer_of(a_scene(tmp_path, GROUND + box("[1.0, 0.5, 0.6]", "[0.0, 0.0, 30.0]")), frame_ms=frame_ms)
    expected = there.picture(LIGHTS)
    there.release()
    renderer = renderer_of(a_scene(tmp_path, GROUND + box("[-1.0, -0.5, 0.4]")), frame_ms=frame_ms)
    rest = renderer.picture(LIGHTS)
    assert relative_rmse(rest, expected) > 0.2
    renderer.place(0.0, [pose("box", (1.0, 0.5, 0.6), (0.0, 0.0, 30.0)), pose("nobody", (0.0, 0.0, 0.0))])
    moved = renderer.picture(LIGHTS)
    # the maps' box grew to hold both places, so that shadow edges lie up to 2 of its texels (2 x 4 m / 252) elsewhere
    assert relative_rmse(moved, expected) < 0.06
    assert np.array_equal(moved[..., 3], expected[..., 3])
    assert np.mean(np.abs(moved - expected).max(axis=-1) > 1e-3) < 0.03
    renderer.place(0.0)
    assert relative_rmse(renderer.picture(LIGHTS), rest) < 0.06
    renderer.release()


def test_an_animation_plays_on_the_pictures_time(tmp_path):
    triangle = AnimatedTriangle(scale=[1.5, 1.5, 1.5]).move(1, "translation", [0, 2], [[0, 1, 0], [2, 1, 0]])
    triangle.write(tmp_path / "animated.gltf")
    ground, mesh = GROUND, '[[mesh]]\nfile = "animated.gltf"\nat = [-1.0, 0.0, 0.0]\n'
    renderer = renderer_of(a_scene(tmp_path, ground + mesh))
    pictures = {}
    for time_s in (0.0, 1.0, 3.0, 1.5):
        renderer.place(time_s)
        pictures[time_s] = renderer.picture(LIGHTS)
    assert np.array_equal(pictures[1.0], pictures[3.0])
    assert relative_rmse(pictures[0.0], pictures[1.0]) > 0.02
    renderer.release()
    again = renderer_of(a_scene(tmp_path, ground + mesh))
    again.place(1.5)
    assert np.array_equal(again.picture(LIGHTS), pictures[1.5])  # a restart goes on where it was
    again.release()
    # file axes are y-up: at 1 s the node is at (1, 1, 0), that is 1 m above (0, 0, 0) of the world
    still = AnimatedTriangle(scale=[1.5, 1.5, 1.5], translation=[1.0, 1.0, 0.0])
    still.write(tmp_path / "animated.gltf")
    there = renderer_of(a_scene(tmp_path, ground + mesh))
    expected = there.picture(LIGHTS)
    there.release()
    assert np.array_equal(expected[..., 3], pictures[1.0][..., 3])
    assert np.mean(np.abs(expected - pictures[1.0]).max(axis=-1) > 1e-3) < 0.02  # shadow edges: the maps span the whole way


def test_a_lamp_moves_and_is_dimmed(tmp_path):
    def lamp(at, rotate, power):
        return f"[[luminaire]]\nat = {at}\nrotate = {rotate}\npower = {power}\nsamples = 16\nshadow_map = 64\n"

    there = renderer_of(a_scene(tmp_path, GROUND + box("[0.0, 0.0, 0.4]") + lamp([1.0, -1.0, 1.5], [20.0, 200.0, 0.0], 3.0)))
    expected = there.picture(LIGHTS)
    there.release()
    renderer = renderer_of(a_scene(tmp_path, GROUND + box("[0.0, 0.0, 0.4]") + lamp([-1.0, 1.0, 2.0], [0.0, 180.0, 0.0], 1.0)))
    dark = renderer.picture(LIGHTS)
    objects = renderer.place(0.0, [pose("torch", (1.0, -1.0, 1.5), (20.0, 200.0, 0.0), 3.0)])
    assert objects[-1].power == 3.0
    moved = renderer.picture(LIGHTS)
    assert relative_rmse(dark, expected) > 0.01
    assert relative_rmse(moved, expected) < 1e-3
    renderer.place(0.0, [pose("torch", (1.0, -1.0, 1.5), (20.0, 200.0, 0.0), 0.0)])
    out = renderer.picture(LIGHTS)
    assert out[..., :3].sum() < moved[..., :3].sum()
    renderer.place(0.0, [pose("torch", (-1.0, 1.0, 2.0), (0.0, 180.0, 0.0))])  # no word of its power: the file's
    assert relative_rmse(renderer.picture(LIGHTS), dark) < 1e-3
    renderer.release()


def test_what_moves_in_a_lamps_light_moves_its_shadow(tmp_path):
    lamp = "[[luminaire]]\nat = [0.0, 0.0, 2.5]\nrotate = [180.0, 0.0, 0.0]\nsamples = 16\nshadow_map = 64\n"
    none = lights_from(np.zeros((0, 3)))
    there = renderer_of(a_scene(tmp_path, GROUND + box("[0.5, 0.0, 1.0]") + lamp))
    expected = there.picture(none)
    there.release()
    renderer = renderer_of(a_scene(tmp_path, GROUND + box("[-0.5, 0.0, 1.0]") + lamp))
    rest = renderer.picture(none)
    renderer.place(0.0, [pose("box", (0.5, 0.0, 1.0))])
    moved = renderer.picture(none)
    assert relative_rmse(rest, expected) > 0.2
    assert relative_rmse(moved, expected) < 0.01
    renderer.release()


def test_below_the_ground_no_light_from_above_arrives(tmp_path):
    ground = GROUND + 'material = {diffuse = [0.0, 0.0, 0.0]}\n'
    scene = a_scene(tmp_path, ground + box("[0.0, 0.0, 1.0]"))
    below = scene._replace(camera=scene.camera.__class__(position=(0.0, -7.0, -4.0), at=(0.0, 0.0, -1.0)))
    renderer = renderer_of(below)
    renderer.place(0.0, [pose("box", (0.0, 0.0, -1.5))])
    assert renderer.picture(lights_from([0.0, 0.0, 1.0]))[..., :3].max() == 0
    assert renderer.picture(lights_from([0.0, 0.0, -1.0]))[..., :3].max() > 0.1
    renderer.place(0.0)
    assert renderer.picture(lights_from([0.0, 0.0, -1.0]))[..., :3].max() == 0
    renderer.release()


def test_cached_maps_follow_moving_casters_within_their_budget(tmp_path, monkeypatch):
    monkeypatch.setattr(frame_plan, "affordable_maps", lambda *_: 4)
    monkeypatch.setattr(near_planning, "affordable_lights", lambda *_: None)
    scene = a_scene(tmp_path, GROUND + box("[-1.0, 0.0, 0.4]") + box("[1.5, 1.5, 0.4]"))
    renderer, lights = renderer_of(scene, frame_ms=1000.0, shadow_map=64), uniform_lights(24, 0.0)
    renderer.picture(lights)
    renderer.place(0.0, [pose("box", (0.5, 0.5, 0.4))])
    errors = [renderer.picture(lights) for _ in range(7)]
    errors = [relative_rmse(picture, errors[-1]) for picture in errors]
    assert errors[0] > 0.02  # 4 of 24 maps show the box where it now is
    assert all(later <= earlier for earlier, later in pairwise(errors))
    assert errors[5] == 0  # after 6 frames all 24, and then none is drawn
    renderer.release()


@pytest.fixture(scope="module")
def box_on_ground(tmp_path_factory) -> Scene:
    return a_scene(tmp_path_factory.mktemp("ground"), GROUND + box("[0.0, 0.0, 0.4]"))


@example_settings(deadline=None)
@given(at=st.tuples(*3 * [st.floats(-20, 20)]), rotate=st.tuples(*3 * [st.floats(-180, 180)]), then=st.tuples(*3 * [st.floats(-20, 20)]))
def test_the_maps_hold_what_casts_wherever_it_stands(box_on_ground, at, rotate, then):
    scene = box_on_ground
    casters = scene_casters(scene, (64,))
    placed, before, last = None, scene_pose(scene, 0.0).matrices, 0.0
    for target in (at, then):
        matrices = scene_pose(scene, 0.0, [pose("box", target, rotate)]).matrices
        placed = placed_casters(casters, matrices, placed)
        last = moved_by_m(casters, before, matrices)
        before = matrices
        lowest = np.inf
        (level,) = placed.levels
        for piece in (*level.closed, *level.open):
            run = casters.positions[casters.indices[piece.indices.first : sum(piece.indices)]]
            points = run @ piece.world_from_rest[:3, :3].T + piece.world_from_rest[:3, 3]
            assert np.all(np.abs(points - placed.box_centre) <= placed.box_half + 1e-3)
            lowest = min(lowest, points[:, 2].min()) if any(piece is closed for closed in level.closed) else lowest
        assert bool(placed.receiver_plane) == (lowest >= -casters.tolerance_m)
    assert last == pytest.approx(np.linalg.norm(np.subtract(at, then)), abs=1e-6)


def test_moving_objects_leak_no_gpu_memory(tmp_path):
    lamp = "[[luminaire]]\nat = [0.0, 0.0, 2.5]\nrotate = [180.0, 0.0, 0.0]\nsamples = 4\nshadow_map = 32\n"
    renderer = renderer_of(a_scene(tmp_path, GROUND + box("[0.0, 0.0, 0.4]") + lamp), frame_ms=1000.0, width=16, height=12, shadow_map=32)

    def objects_after(frames: range) -> tuple[int, ...]:
        for k in frames:
            renderer.place(0.0, [pose("box", (0.3 * k, 0.0, 0.4)), pose("torch", (0.1 * k, 0.0, 2.5), (180.0, 0.0, 0.0), 1.0)])
            renderer.picture(uniform_lights(5 + k % 20, 0.0))  # the atlas is made anew where it must hold more
        return gl_objects(renderer.renderer._context)

    before = objects_after(range(25))
    assert min(before) > 0
    assert objects_after(range(25, 60)) == before
    renderer.release()


def test_normals_follow_a_scale_that_is_not_the_same_all_ways(tmp_path):
    """A slope squeezed to half its height by its animation is lit as one that was built so."""
    slope = np.array([[-1, 1, -1], [1, 1, -1], [0, -1, 1]], float)
    for name, height in (("tall", 1.0), ("low", 0.5)):
        triangle = AnimatedTriangle()
        if name == "tall":
            triangle.move(1, "scale", [0, 1, 2], [[1, 1, 1], [1, 0.5, 1], [1, 1, 1]])
        triangle.data = (slope * [1, height, 1]).astype(np.float32).tobytes() + triangle.data[36:]
        triangle.document["accessors"][0] |= {"min": [-1, -height, -1], "max": [1, height, 1]}
        triangle.write(tmp_path / f"{name}.gltf")
    pictures = []
    for name in ("tall", "low"):
        renderer = renderer_of(a_scene(tmp_path, f'[[mesh]]\nfile = "{name}.gltf"\nmaterial = {{diffuse = [1.0, 1.0, 1.0]}}\n'))
        renderer.place(1.0)
        pictures.append(renderer.picture(lights_from([0.0, 0.0, 1.0])))
        renderer.release()
    both = (pictures[0][..., 3] > 0) & (pictures[1][..., 3] > 0)
    assert both.sum() > 50
    assert np.allclose(pictures[0][both], pictures[1][both], atol=1e-3)
    # the slope of 45 degrees becomes one of atan(1/2)
    assert pictures[0][both][:, 0].max() == pytest.approx(np.cos(np.arctan(0.5)) / np.pi, rel=1e-3)


@pytest.mark.parametrize("shadows", ["rays", "maps"])
def test_what_was_scaled_looks_as_if_it_had_always_been_so_large(tmp_path, shadows):
    small = '[[mesh]]\nshape = "sphere"\nscale = 0.25\nat = [0.3, 0.0, 0.9]\nrotate = [10.0, 20.0, 30.0]\n'
    settings = {"shadows": shadows, "shadow_map": 256 if shadows == "maps" else None}
    there = renderer_of(a_scene(tmp_path, GROUND + small.replace("0.25", "0.75")), **settings)
    expected = there.picture(LIGHTS)
    there.release()
    renderer = renderer_of(a_scene(tmp_path, GROUND + small), **settings)
    rest = renderer.picture(LIGHTS)
    assert relative_rmse(rest, expected) > 0.2
    pose = renderer.renderer.setup.scene.objects[1]
    moved = renderer.place(0.0, [msgspec.structs.replace(pose, scale=3.0)])
    assert moved[1].scale == 3.0
    picture = renderer.picture(LIGHTS)
    assert relative_rmse(picture, expected) < (0.06 if shadows == "maps" else 1e-3)
    assert np.array_equal(picture[..., 3], expected[..., 3])
    renderer.place(0.0)
    assert relative_rmse(renderer.picture(LIGHTS), rest) < 0.06
    renderer.release()


def test_a_lamp_has_no_scale(tmp_path):
    scene = a_scene(tmp_path, GROUND + "[[luminaire]]\npower = 2.0\n")
    asked = Pose(name="torch", position=(1.0, 0.0, 2.0), scale=3.0)
    assert scene_pose(scene, 0.0, [asked]).objects[1] == Pose(name="torch", position=(1.0, 0.0, 2.0), power=2.0)
