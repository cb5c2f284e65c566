"""Cameras of glTF files as presets of a scene, and scales of its meshes along each axis."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.gltf_files import TexturedSquare
from vemlight.errors import UserError
from vemlight.renderer.scene.scene import load_scene
from vemlight.renderer.scene.scene_limits import MAX_VIEWS
from vemlight.renderer.scene.view import view_from_world

HALF = float(np.sqrt(0.5))


def with_cameras(folder: Path) -> TexturedSquare:
    sheet = TexturedSquare()
    perspective = {"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}
    sheet.document["cameras"] = [perspective, {"type": "orthographic", "name": "flat"}]
    sheet.document["nodes"] = [
        {"mesh": 0}, {"name": "Front", "camera": 0, "translation": [0.0, 1.0, 5.0]}, {"children": [3], "rotation": [0.0, HALF, 0.0, HALF]},
        {"name": "Side", "camera": 0, "translation": [0.0, 0.0, 4.0]}, {"camera": 1},
        {"name": "Rolled", "camera": 0, "translation": [0.0, 0.0, 5.0], "rotation": [0.0, 0.0, float(np.sin(0.1)), float(np.cos(0.1))]},
    ]  # fmt: skip
    sheet.document["scenes"] = [{"nodes": [0, 1, 2, 4, 5]}]
    sheet.write(folder / "sheet.gltf")
    return sheet


def scene(folder: Path, camera: str, mesh: str = ""):
    (folder / "scene.toml").write_text(f"[camera]\n{camera}\n[[mesh]]\nfile = \"sheet.gltf\"\n{mesh}\n")
    return load_scene(folder / "scene.toml")


def test_a_camera_of_a_file_is_a_preset(tmp_path):
    with_cameras(tmp_path)
    camera = scene(tmp_path, 'preset = "Front"').camera
    assert camera.position == pytest.approx((0, -5, 1))  # the file's y is the world's z
    assert np.subtract(camera.at, camera.position) == pytest.approx((0, 1, 0))
    assert camera.fov_y == pytest.approx(np.degrees(0.8))
    assert scene(tmp_path, 'preset = "Front"\nfov_y = 20.0').camera.fov_y == 20
    side = scene(tmp_path, 'preset = "Side"', "at = [0.0, 0.0, 2.0]\nscale = 2.0").camera  # placed with its file
    assert side.position == pytest.approx((8, 0, 2))
    assert np.subtract(side.at, side.position) == pytest.approx((-1, 0, 0))


def test_what_the_camera_sees_is_where_the_file_has_it(tmp_path):
    with_cameras(tmp_path)
    loaded = scene(tmp_path, 'preset = "Front"', "rotate = [10.0, 20.0, 30.0]\nscale = 0.5")
    seen = loaded.meshes[0].geometry.positions @ view_from_world(loaded.camera)[:3, :3].T + view_from_world(loaded.camera)[:3, 3]
    assert seen[:, 2] == pytest.approx(2.5, abs=1e-5)  # 5 m in the file, halved


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        ('preset = "Front"\nfrom = [1.0, 0.0, 0.0]', "leave one of the two out"),
        ('preset = "Back"', "its cameras are Front, Side, flat, Rolled"),
        ('preset = "flat"', "has no perspective"), ("at = [1.0, 0.0, 0.0]", "needs from and at, or preset"),
    ],
)  # fmt: skip
def test_presets_that_cannot_be_are_refused(tmp_path, camera, said):
    with_cameras(tmp_path)
    with pytest.raises(UserError, match=said):
        scene(tmp_path, camera)


def test_roll_and_motion_of_a_camera_are_said(tmp_path, capsys):
    sheet = with_cameras(tmp_path)
    times, values = sheet.accessor(np.array([0, 1], np.float32)), sheet.accessor(np.zeros((2, 3), np.float32))
    channel = {"sampler": 0, "target": {"node": 5, "path": "translation"}}
    sheet.document["animations"] = [{"samplers": [{"input": times, "output": values}], "channels": [channel]}]
    sheet.write(tmp_path / "sheet.gltf")
    scene(tmp_path, 'preset = "Rolled"')
    err = capsys.readouterr().err
    assert "its roll of 11.5 degrees is not drawn" in err or "its roll of -11.5 degrees is not drawn" in err
    assert "its animation is not followed" in err
    scene(tmp_path, 'preset = "Front"')
    assert capsys.readouterr().err == ""


def test_a_scale_along_each_axis(tmp_path):
    (tmp_path / "scene.toml").write_text(
        "[camera]\nfrom = [0.0, -9.0, 2.0]\nat = [0.0, 0.0, 0.0]\n"
        '[[mesh]]\nshape = "sphere"\nscale = [3.0, 1.0, 0.5]\nrotate = [0.0, 0.0, 90.0]\n'
    )
    (ball,) = load_scene(tmp_path / "scene.toml").meshes
    p, n = ball.geometry.positions.astype(float), ball.geometry.normals.astype(float)
    assert np.abs(p).max(axis=0) == pytest.approx([1, 3, 0.5], abs=1e-3)  # scaled, then rotated
    gradient = p / [1, 9, 0.25]
    assert np.abs(n - gradient / np.linalg.norm(gradient, axis=1, keepdims=True)).max() < 1e-5


@pytest.mark.parametrize("scale", ["0.0", "-1.0", "[1.0, 0.0, 1.0]", "[1.0, 1.0, 2e9]", "[1.0, 1.0]"])
def test_scales_that_cannot_be_are_refused(tmp_path, scale):
    with_cameras(tmp_path)
    with pytest.raises(UserError, match="scale"):
        scene(tmp_path, 'preset = "Front"', f"scale = {scale}")


def test_a_page_is_offered_named_views_and_the_cameras_of_files_up_to_a_limit_that_is_said(tmp_path, capsys):
    with_cameras(tmp_path)
    view = "[[view]]\nname = \"{}\"\nfrom = [0.0, -5.0, 1.0]\nat = [0.0, 0.0, 1.0]\n"
    few = scene(tmp_path, 'preset = "Front"', view.format("desk") + view.format("Side"))
    assert [name for name, _ in few.views] == ["desk", "Side", "Front", "Rolled"]  # the scene file's own Side
    assert dict(few.views)["Front"].eye == pytest.approx((0, -5, 1))
    assert not capsys.readouterr().err
    many = scene(tmp_path, 'preset = "Front"', "".join(view.format(f"view {n}") for n in range(MAX_VIEWS - 1)))
    assert [name for name, _ in many.views[-2:]] == [f"view {MAX_VIEWS - 2}", "Front"]
    assert "32 views are offered, and the scene's files have more cameras" in capsys.readouterr().err
