"""Animated glTF files: where their meshes are at a time."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.gltf_files import TRIANGLE, AnimatedTriangle
from vemlight.errors import UserError
from vemlight.light.sphere import rotation_xyz
from vemlight.renderer.scene.animation import KeyframeTrack, track_value
from vemlight.renderer.scene.mesh_files import read_meshes
from vemlight.renderer.scene.meshes import swept_bounds

HALF = float(np.sqrt(0.5))


def corners(file: AnimatedTriangle, folder: Path, time_s: float, suffix: str = "gltf") -> np.ndarray:
    """The triangle's corners (3, 3) at a time, as the file is read."""
    part = read_meshes(file.write(folder / f"animated.{suffix}"), "here").parts[0]
    assert part.motion is not None
    matrix = part.motion.world_from_rest(time_s)
    return part.geometry.positions @ matrix[:3, :3].T + matrix[:3, 3]


@pytest.mark.parametrize("suffix", ["gltf", "glb"])
def test_a_mesh_follows_its_keys_and_starts_again(tmp_path, suffix):
    triangle = AnimatedTriangle(translation=[5.0, 0.0, 0.0]).move(1, "translation", [0, 1, 3], [[0, 0, 0], [0, 0, 2], [4, 0, 2]])
    for time_s, at in ((0.0, (0, 0, 0)), (0.5, (0, 0, 1)), (1.0, (0, 0, 2)), (2.0, (2, 0, 2)), (3.5, (0, 0, 1)), (302.0, (2, 0, 2))):
        assert np.allclose(corners(triangle, tmp_path, time_s, suffix), TRIANGLE + np.array(at), atol=1e-6), time_s


def test_a_step_lasts_until_the_next_key(tmp_path):
    triangle = AnimatedTriangle().move(1, "translation", [0.5, 1, 2], [[1, 0, 0], [2, 0, 0], [3, 0, 0]], "STEP")
    assert [corners(triangle, tmp_path, t)[0, 0] for t in (0.0, 0.5, 0.99, 1.0, 1.99)] == [1, 1, 1, 2, 2]


def test_a_parents_rotation_carries_its_child(tmp_path):
    triangle = AnimatedTriangle(translation=[2.0, 0.0, 0.0]).move(0, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, HALF, HALF]])
    turned = rotation_xyz((0, 0, 45))
    assert np.allclose(corners(triangle, tmp_path, 0.5), (TRIANGLE + np.array([2, 0, 0])) @ turned.T, atol=1e-6)


def test_rotations_take_the_shorter_way_and_may_be_short_integers(tmp_path):
    quarter = np.round(np.array([[0, 0, 0, 1], [0, 0, -HALF, -HALF]]) * 32767).astype(np.int16)
    triangle = AnimatedTriangle().move(1, "rotation", [0, 1], quarter, normalized=True)
    assert np.allclose(corners(triangle, tmp_path, 1 / 3), TRIANGLE @ rotation_xyz((0, 0, 30)).T, atol=1e-4)  # 16 bits


def test_scale_rotation_and_translation_apply_in_this_order(tmp_path):
    triangle = AnimatedTriangle().move(1, "scale", [0, 1], [[1, 1, 1], [2, 2, 2]])
    triangle.move(1, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, HALF, HALF]]).move(1, "translation", [0, 1], [[0, 0, 0], [1, 1, 1]])
    near = 1 - 1e-6  # at 1 the animation begins again
    assert np.allclose(corners(triangle, tmp_path, near)[1], [1, 3, 1], atol=1e-4)


@given(st.floats(0, 1), st.floats(0.5, 5), st.lists(st.floats(-3, 3), min_size=4, max_size=4))
def test_a_cubic_spline_is_the_cubic_that_it_was_made_of(t, step_s, coefficients):
    cubic = np.polynomial.Polynomial(coefficients)
    slope = cubic.deriv()
    keys = [[[slope(x)], [cubic(x)], [slope(x)]] for x in (0.0, step_s)]
    track = KeyframeTrack(np.array([0.0, step_s]), np.array(keys), "CUBICSPLINE")
    assert track_value(track, t * step_s, False)[0] == pytest.approx(cubic(t * step_s), abs=1e-9 * (1 + np.abs(keys).max() * step_s))


@given(st.lists(st.floats(-1, 1), min_size=8, max_size=8), st.floats(0, 1))
def test_rotations_are_interpolated_at_constant_speed(numbers, t):
    a, b = np.array(numbers[:4]), np.array(numbers[4:])
    if min(np.linalg.norm(a), np.linalg.norm(b)) < 1e-3:
        return
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    track = KeyframeTrack(np.array([0.0, 1.0]), np.repeat(np.array([a, b])[:, None], 3, axis=1), "LINEAR")
    between = track_value(track, t, True)
    assert np.linalg.norm(between) == pytest.approx(1, abs=1e-9)
    whole, part = (np.arccos(min(abs(float(a @ other)), 1.0)) for other in (b, between))
    assert part == pytest.approx(t * whole, abs=1e-6)


def test_the_animation_is_chosen_by_name_or_all_play(tmp_path):
    triangle = AnimatedTriangle().move(1, "translation", [0, 1], [[1, 0, 0], [1, 0, 0]])
    (walk,) = triangle.document["animations"]
    walk["name"] = "walk"
    triangle.document["animations"].append({"name": "rise", "channels": [], "samplers": []})
    triangle.document["animations"].reverse()  # `move` adds to the first
    triangle.move(1, "translation", [0, 2], [[0, 0, 3], [0, 0, 3]]).move(0, "translation", [0, 2], [[0, 5, 0], [0, 5, 0]])
    path = triangle.write(tmp_path / "animated.gltf")
    for name, at, duration_s in (("", (0, 5, 3), 2), ("rise", (0, 5, 3), 2), ("walk", (1, 0, 0), 1), ("*", (0, 5, 3), 2)):
        found = read_meshes(path, "here", name)
        (part,) = found.parts
        assert part.motion is not None
        assert part.motion.world_from_rest(0.5)[:3, 3] == pytest.approx(at)
        assert part.motion.duration_s == duration_s
        assert len(found.unsupported) == (name == "")
    with pytest.raises(UserError, match="has no animation run, but rise, walk"):
        read_meshes(path, "here", "run")


def test_all_animations_move_what_each_of_them_moves(tmp_path):
    triangle = AnimatedTriangle().move(1, "translation", [0, 1], [[1, 0, 0], [1, 0, 0]])
    triangle.document["animations"].insert(0, {"channels": [], "samplers": []})
    triangle.move(0, "translation", [0, 4], [[0, 0, 2], [0, 0, 2]])
    (part,) = read_meshes(triangle.write(tmp_path / "animated.gltf"), "here", "*").parts
    assert part.motion is not None
    assert part.motion.world_from_rest(3.0)[:3, 3] == pytest.approx([1, 0, 2])
    (line,) = read_meshes(triangle.write(tmp_path / "animated.gltf"), "here").unsupported
    assert line == 'animated.gltf: of its 2 animations the first plays: animation = "*" plays all, or name one of 1, 2'


def test_a_node_with_the_name_of_the_graphs_root_moves_too(tmp_path):
    triangle = AnimatedTriangle().move(1, "translation", [0, 1], [[3, 0, 0], [3, 0, 0]])
    triangle.document["nodes"][1]["name"] = "world"
    assert corners(triangle, tmp_path, 0.5)[0] == pytest.approx([3, 0, 0])


def test_a_file_without_animation_stands_still(tmp_path):
    triangle = AnimatedTriangle()
    del triangle.document["animations"]
    assert read_meshes(triangle.write(tmp_path / "animated.gltf"), "here").parts[0].motion is None


def test_a_scenes_box_holds_an_excursion_between_keys_that_lie_close_together(tmp_path):
    # 50 keys in the first hundredth of the time, and the farthest place at one of them alone
    times = np.concatenate([np.linspace(0, 0.1, 50), [10.0]]).astype(np.float32)
    places = np.zeros((51, 3), np.float32)
    places[37] = [0, 0, 7]
    (part,) = read_meshes(AnimatedTriangle().move(1, "translation", times, places).write(tmp_path / "animated.gltf"), "here").parts
    low, high = swept_bounds(part.geometry, part.motion)
    assert 7 < high[2] < 7.5
    assert -0.5 < low[2] < 0
    assert part.motion is not None
    shown = part.motion.sample_times_s(64)
    assert set(times[:-1].astype(float)) < set(shown)
    assert len(shown) == 51 + 64
    assert shown.max() < part.motion.duration_s == 10.0


def invalid_key_order(triangle):
    triangle.move(1, "translation", [1, 0], [[0, 0, 0], [1, 0, 0]])


def invalid_nan(triangle):
    triangle.move(1, "translation", [0, 1], [[0, 0, 0], [np.nan, 0, 0]])


def invalid_count(triangle):
    triangle.move(1, "translation", [0, 1, 2], [[0, 0, 0], [1, 0, 0]])


def invalid_accessor(triangle):
    triangle.move(1, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]])
    triangle.document["accessors"][-1]["count"] = 10**6


def invalid_interpolation(triangle):
    triangle.move(1, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]], "SWAY")


def invalid_rotation(triangle):
    triangle.move(1, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 0, 0]])


@pytest.mark.parametrize(
    "invalidate", [invalid_key_order, invalid_nan, invalid_count, invalid_accessor, invalid_interpolation, invalid_rotation]
)
def test_an_invalid_animation_is_one_line(tmp_path, invalidate):
    triangle = AnimatedTriangle()
    invalidate(triangle)
    with pytest.raises(UserError, match=r"^here: .*animated\.gltf .*export it again$") as caught:
        read_meshes(triangle.write(tmp_path / "animated.gltf"), "here")
    assert "\n" not in str(caught.value)


def test_the_wheels_of_a_real_truck_turn_once(tmp_path):
    data = os.environ.get("VEMLIGHT_DATA")
    if not data:
        pytest.skip("VEMLIGHT_DATA is not set")
    parts = read_meshes(Path(data) / "models" / "CesiumMilkTruck.glb", "here").parts
    wheels = [part for part in parts if part.motion]
    assert len(wheels) == 2
    for wheel in wheels:
        assert wheel.motion is not None
        assert wheel.motion.duration_s == pytest.approx(1.25)
        middle = wheel.geometry.positions.mean(axis=0)
        for time_s in np.linspace(0, 1.2, 7):
            matrix = wheel.motion.world_from_rest(time_s)
            assert np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-6)  # rigid
            assert np.allclose(matrix[:3, :3] @ middle + matrix[:3, 3], middle, atol=2e-2)  # about its own axle, but for its pattern
        half = wheel.motion.world_from_rest(0.625)
        assert np.trace(half[:3, :3]) == pytest.approx(-1, abs=0.05)  # half a turn


def test_long_animations_short_quaternions_and_small_nodes_are_read(tmp_path):
    """Ten minutes at 30 keyframes a second; a rotation of length 1/2, as of coarse numbers; a node at a hundredth of its size."""
    times = np.arange(18_000) / 30
    long = AnimatedTriangle().move(1, "translation", times, np.stack([times, 0 * times, 0 * times], axis=-1).astype(np.float32))
    assert corners(long, tmp_path, 300.0)[0, 0] == pytest.approx(TRIANGLE[0, 0] + 300)
    short = AnimatedTriangle().move(1, "rotation", [0, 1], [[0, 0, 0, 0.5], [0, 0, 0.5 * HALF, 0.5 * HALF]])
    assert np.allclose(corners(short, tmp_path, 1 - 1e-6), TRIANGLE @ rotation_xyz((0, 0, 90)).T, atol=1e-4)
    small = AnimatedTriangle(scale=[0.01, 0.01, 0.01]).move(1, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]])
    assert np.allclose(corners(small, tmp_path, 0.5), 0.01 * TRIANGLE + np.array([0.5, 0, 0]), atol=1e-6)
