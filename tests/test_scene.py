from pathlib import Path

import numpy as np
import pytest

from tests.support.scenes import SHAPES
from vemlight.errors import UserError
from vemlight.renderer.scene.scene import load_scene

CAMERA = "[camera]\nfrom = [0.0, -4.0, 2.0]\nat = [0.0, 0.0, 0.0]\n"


def scene_file(folder: Path, mesh: str, camera: str = CAMERA) -> Path:
    path = folder / "scene.toml"
    path.write_text(f"{camera}\n{mesh}\n")
    return path


def one_triangle(folder: Path, vertices: list[tuple[float, float, float]], name: str = "mesh.obj") -> None:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    (folder / name).write_text("\n".join([*lines, "f 1 2 3"]) + "\n")


def test_the_bundled_scene_loads():
    scene = load_scene(SHAPES)
    assert len(scene.meshes) >= 4
    assert np.all(np.isfinite(scene.centre))
    assert np.all(scene.half > 0)


def test_the_box_of_the_scene(tmp_path):
    scene = load_scene(scene_file(tmp_path, '[[mesh]]\nshape = "box"\nscale = 2.0\nat = [1.0, 2.0, 3.0]'))
    assert scene.centre.tolist() == [1, 2, 3]
    assert scene.half.tolist() == [2, 2, 2]


@pytest.mark.parametrize(("off_m", "lines"), [(0.0, 0), (3e3, 0), (4e3, 1), (-9e5, 1)])
def test_a_scene_too_far_from_the_origin_is_reported_in_a_line(tmp_path, capsys, off_m, lines):
    load_scene(scene_file(tmp_path, f'[[mesh]]\nshape = "box"\nat = [{off_m}, 0.0, 0.0]'))  # 2 sqrt(3) m large
    assert capsys.readouterr().err.count("\n") == lines


def test_y_up_scale_rotate_and_at_come_in_this_order(tmp_path):
    one_triangle(tmp_path, [(1, 2, 3), (0, 0, 0), (1, 0, 0)])
    mesh = '[[mesh]]\nfile = "mesh.obj"\ny_up = true\nscale = 2.0\nrotate = [0.0, 0.0, 90.0]\nat = [10.0, 0.0, 0.0]'
    scene = load_scene(scene_file(tmp_path, mesh))
    # (1, 2, 3) y-up is (1, -3, 2); twice that is (2, -6, 4); a quarter about z is (6, 2, 4); moved it is (16, 2, 4)
    positions = scene.meshes[0].geometry.positions
    assert np.abs(positions - [16, 2, 4]).max(axis=1).min() < 1e-5


def test_rotation_is_about_x_then_y_then_z(tmp_path):
    one_triangle(tmp_path, [(0, 1, 0), (0, 0, 0), (0.5, 0, 0)])
    scene = load_scene(scene_file(tmp_path, '[[mesh]]\nfile = "mesh.obj"\nrotate = [90.0, 90.0, 0.0]'))
    # (0, 1, 0) about x is (0, 0, 1), then about y (1, 0, 0)
    assert np.abs(scene.meshes[0].geometry.positions - [1, 0, 0]).max(axis=1).min() < 1e-6


def test_gltf_is_y_up_by_default(tmp_path):
    import trimesh

    trimesh.Trimesh([(0, 1, 0), (0, 0, 0), (0.5, 0, 0)], [(0, 1, 2)], process=False).export(tmp_path / "mesh.glb")
    scene = load_scene(scene_file(tmp_path, '[[mesh]]\nfile = "mesh.glb"'))
    assert np.abs(scene.meshes[0].geometry.positions - [0, 0, 1]).max(axis=1).min() < 1e-6


@pytest.mark.parametrize(
    ("mesh", "words"),
    [
        ('[[mesh]]\nfile = "absent.obj"', ["scene.toml", "[[mesh]] 1", "absent.obj", "correct the path"]),
        ('[[mesh]]\nfile = "mesh.fbx"', ["mesh.fbx", "convert it"]),
        ('[[mesh]]\nshape = "cone"', ["scene.toml", "cone"]),
        ('[[mesh]]\nshape = "box"\nfile = "mesh.obj"', ["either"]),
        ("[[mesh]]\nscale = 1.0", ["either"]),
        ('[[mesh]]\nshape = "box"\ncolour = 3', ["scene.toml", "colour"]),
        ('[[mesh]]\nshape = "box"\nanimation = "*"', ["animation = *", "leave it out"]),
        ('[[mesh]]\nshape = "box"\nscale = 0.0', ["scale"]),
        ('[[mesh]]\nshape = "box"\nat = [nan, 0.0, 0.0]', ["finite"]),
        ('[[mesh]]\nshape = "box"\nmaterial = {diffuse = [0.7, 0.7, 0.7], specular = [0.4, 0.0, 0.0]}', ["diffuse + specular", "1.1"]),
        ('[[mesh]]\nshape = "box"\nmaterial = {exponent = -1.0}', ["exponent"]),
        ("mesh = []", ["[[mesh]]"]),
    ],
)
def test_bad_scenes_end_in_one_line_that_says_where(tmp_path, mesh, words):
    path = scene_file(tmp_path, mesh) if mesh != "mesh = []" else scene_file(tmp_path, CAMERA, camera="mesh = []")
    with pytest.raises(UserError) as caught:
        load_scene(path)
    text = str(caught.value)
    assert "\n" not in text
    assert all(word in text for word in words), text


@pytest.mark.parametrize(
    ("key", "good", "bad"),
    [
        ("at", "[0.9e6, 0.0, 0.0]", "[1.1e6, 0.0, 0.0]"),
        ("at", "[0.0, 0.0, -0.9e6]", "[0.0, 0.0, -1.1e6]"),
        ("scale", "1e9", "1.1e9"),
        ("scale", "1e-9", "0.9e-9"),
        ("name", f'"{64 * "a"}"', f'"{65 * "a"}"'),
        ("material", "{exponent = 1e5}", "{exponent = 1.1e5}"),
        ("material", "{diffuse = [0.7, 0.7, 0.7], specular = [0.3, 0.3, 0.3]}", "{diffuse = [0.7, 0.7, 0.7], specular = [0.31, 0.3, 0.3]}"),
    ],
)
def test_the_limits_of_a_mesh(tmp_path, key, good, bad):
    load_scene(scene_file(tmp_path, f'[[mesh]]\nshape = "box"\n{key} = {good}'))
    with pytest.raises(UserError):
        load_scene(scene_file(tmp_path, f'[[mesh]]\nshape = "box"\n{key} = {bad}'))


@pytest.mark.parametrize(("place", "refused"), [("0.9e6", False), ("1.1e6", True), ("1e308", True)])
def test_the_camera_stands_within_1000_km(tmp_path, place, refused):
    path = scene_file(tmp_path, '[[mesh]]\nshape = "box"\n', camera=f"[camera]\nfrom = [{place}, 0.0, 0.0]\nat = [0.0, 0.0, 0.0]\n")
    if refused:
        with pytest.raises(UserError, match=r"two different points within 1000000 m"):
            load_scene(path)
    else:
        load_scene(path)


def test_a_name_made_of_a_long_file_name_has_room_for_its_number(tmp_path):
    one_triangle(tmp_path, [(0, 0, 0), (1, 0, 0), (0, 1, 0)], f"{100 * 'a'}.obj")
    scene = load_scene(scene_file(tmp_path, 11 * f'[[mesh]]\nfile = "{100 * "a"}.obj"\n'))
    names = [pose.name for pose in scene.objects]
    assert names == [56 * "a", *(f"{56 * 'a'} {k}" for k in range(2, 12))]


@pytest.mark.parametrize(("bend_deg", "flat"), [(0.03, True), (0.12, False)])
def test_a_shadow_catcher_is_flat_to_a_sixteenth_of_a_degree(tmp_path, bend_deg, flat):
    rise, normal = np.tan(np.radians(bend_deg)), f"{-np.sin(np.radians(bend_deg))} 0 1"
    faces = "f 1//1 2//1 3//1\nf 1//2 4//2 2//2\n"
    (tmp_path / "mesh.obj").write_text(f"v 0 0 0\nv 0 1 0\nv -1 0 0\nv 1 0 {rise}\nvn 0 0 1\nvn {normal}\n{faces}")
    text = '[[mesh]]\nfile = "mesh.obj"\nmaterial = {catcher = true}'
    if flat:
        load_scene(scene_file(tmp_path, text))
    else:
        with pytest.raises(UserError, match="not flat"):
            load_scene(scene_file(tmp_path, text))


@pytest.mark.parametrize(
    ("vertices", "words"),
    [
        ([(0, 0, 0), (1, 0, 0), (np.nan, 1, 0)], "nan"),
        ([(0, 0, 0), (1, 0, 0), (2, 0, 0)], "no area"),
        ([(5, 5, 5), (5, 5, 5), (5, 5, 5)], "no size"),
    ],
)
def test_meshes_that_cannot_be_drawn_are_named(tmp_path, vertices, words):
    one_triangle(tmp_path, vertices)
    with pytest.raises(UserError, match=words) as caught:
        load_scene(scene_file(tmp_path, '[[mesh]]\nfile = "mesh.obj"'))
    assert "mesh.obj" in str(caught.value)
    assert "[[mesh]] 1" in str(caught.value)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb", "gltf"])
def test_random_bytes_and_empty_files_are_bad_input(tmp_path, suffix):
    for data in (b"", np.random.default_rng(3).bytes(2000)):
        (tmp_path / f"mesh.{suffix}").write_bytes(data)
        with pytest.raises(UserError):
            load_scene(scene_file(tmp_path, f'[[mesh]]\nfile = "mesh.{suffix}"'))


def test_a_camera_must_look_somewhere(tmp_path):
    with pytest.raises(UserError, match="camera"):
        load_scene(scene_file(tmp_path, '[[mesh]]\nshape = "box"', camera="[camera]\nfrom = [1.0, 1.0, 1.0]\nat = [1.0, 1.0, 1.0]"))
