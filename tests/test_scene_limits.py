"""What the files of a scene may become, and which files a scene may name."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from tests.support.gltf_files import AnimatedTriangle, GltfFile
from tests.support.gltf_squares import TexturedSquare
from vemlight.errors import UserError
from vemlight.renderer.scene.mesh_files import read_meshes
from vemlight.renderer.scene.scene import load_scene
from vemlight.renderer.scene.scene_limits import SceneLimits

CAMERA = "[camera]\nfrom = [3.0, -4.0, 2.5]\nat = [0.0, 0.0, 0.5]\n"
BOX = '[[mesh]]\nshape = "box"\n'


def refused(call, *arguments) -> bool:
    try:
        call(*arguments)
    except ValueError:
        return True
    return False


def test_small_files_may_be_drawn_up_to_fixed_counts():
    assert not refused(SceneLimits().on_cleaned, 349_525)  # 2^20 corners
    assert refused(SceneLimits().on_cleaned, 349_526)
    assert not refused(SceneLimits().on_placed, 2**22)
    assert refused(SceneLimits().on_placed, 2**22 + 1)


def test_large_files_may_be_drawn_as_far_as_their_bytes_go():
    limits = SceneLimits()
    limits.on_stored(3 * 10**7)
    assert not refused(limits.on_cleaned, 10**7)
    assert refused(limits.on_cleaned, 1)
    assert not refused(limits.on_placed, 3 * 10**7)
    assert refused(limits.on_placed, 1)


def test_meshes_are_counted():
    limits = SceneLimits()
    assert not any(refused(limits.on_placed, 3) for _ in range(4096))
    assert refused(limits.on_placed, 3)


def instances(path: Path, count: int, **node) -> Path:
    """Nodes with a mesh of 2,000 triangles."""
    file = GltfFile()
    corners = np.random.default_rng(0).random((6000, 3)).astype(np.float32)
    file.document["meshes"] = [{"primitives": [{"attributes": {"POSITION": file.accessor(corners)}}]}]
    file.document["nodes"] = [{"mesh": 0, "translation": [float(k), 0.0, 0.0], **node} for k in range(count)]
    file.document["scenes"] = [{"nodes": list(range(count))}]
    return file.write(path)


def test_instances_are_cleaned_once_and_lie_where_their_nodes_are(tmp_path):
    # the last child comes first
    parts = read_meshes(instances(tmp_path / "a.glb", 200, rotation=[0.0, 0.0, 0.6, 0.8]), "here").parts  # 400,000 triangles
    (alone,) = read_meshes(instances(tmp_path / "b.glb", 1, rotation=[0.0, 0.0, 0.6, 0.8]), "here").parts
    assert np.allclose(parts[-8].geometry.positions, alone.geometry.positions + np.array([7, 0, 0], np.float32), atol=1e-5)
    assert np.allclose(parts[-8].geometry.normals, alone.geometry.normals, atol=1e-5)
    assert parts[-8].geometry.triangles is parts[0].geometry.triangles


def test_instances_that_are_stretched_are_each_cleaned_and_counted(tmp_path):
    with pytest.raises(UserError, match=r"draws 400000 triangles from \d+ bytes; repeat fewer"):
        read_meshes(instances(tmp_path / "a.glb", 200, scale=[1.0, 2.0, 1.0]), "here")


def test_a_scenes_meshes_are_counted_together(tmp_path):
    (tmp_path / "scene.toml").write_text(CAMERA + BOX * 4097)
    with pytest.raises(UserError, match=r"\[\[mesh\]\] 4097: the scene draws more than 4096 meshes; join them"):
        load_scene(tmp_path / "scene.toml")


def test_a_scene_has_at_most_256_luminaires_and_reads_each_file_once(tmp_path):
    (tmp_path / "scene.toml").write_text(CAMERA + BOX + "[[luminaire]]\n" * 257)
    with pytest.raises(UserError, match="at most 256"):
        load_scene(tmp_path / "scene.toml")
    (tmp_path / "scene.toml").write_text(CAMERA + BOX + "[[luminaire]]\n" * 256)
    lamps = load_scene(tmp_path / "scene.toml").luminaires
    assert lamps[255].source is lamps[0].source


@pytest.mark.parametrize("table", ["[[mesh]]\nfile = ", "[[luminaire]]\nfile = ", "[plate]\nfile = "])
@pytest.mark.parametrize(
    "name",
    ["/etc/passwd.ply", "../outside.ply", "https://host/a.ply", "link.ply", "pipe.ply", "folder.ply", 300 * "x" + ".ply", "\\u0000.ply"],
)
def test_a_scene_names_regular_files_in_its_folder(tmp_path, table, name):
    (tmp_path / "scene").mkdir()
    (tmp_path / "outside.ply").write_bytes(b"ply\n")
    (tmp_path / "scene" / "link.ply").symlink_to("../outside.ply")
    (tmp_path / "scene" / "folder.ply").mkdir()
    os.mkfifo(tmp_path / "scene" / "pipe.ply")
    suffix = ".ply" if "mesh" in table else ".ies" if "luminaire" in table else ".png"
    for path in (tmp_path / "scene").iterdir():
        path.rename(path.with_suffix(suffix))
    scene = tmp_path / "scene" / "scene.toml"
    scene.write_text(CAMERA + BOX + table + f'"{name.replace(".ply", suffix)}"\n')
    with pytest.raises(
        UserError, match=r"scene\.toml: .*(leads out of|is an address|is a link out of|regular file|is a folder|no such|mesh file|name)"
    ) as caught:
        load_scene(scene)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["/dev/zero", "../a.png", "%2e%2e/a.png", "http://host/a.png", "file:///etc/passwd", "link.png"])
@pytest.mark.parametrize("key", ["buffers", "images"])
def test_a_gltf_names_files_in_its_folder(tmp_path, key, name):
    (tmp_path / "link.png").symlink_to("/etc/hostname")
    sheet = TexturedSquare(pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    sheet.document.update(textures=[{"source": 0}], images=[{"uri": "data:image/png;base64,"}])
    path = sheet.write(tmp_path / "sheet.gltf")
    sheet.document[key][0]["uri"] = name
    path.write_text(json.dumps(sheet.document))
    with pytest.raises(UserError, match=r"^here: .*sheet\.gltf: .*(leads out of|is an address|is a link out of)"):
        read_meshes(path, "here")


@pytest.mark.parametrize(("depth", "is_refused"), [(256, False), (257, True)])
def test_nodes_lie_inside_one_another_up_to_a_depth(tmp_path, depth, is_refused):
    file = GltfFile()
    file.document["meshes"] = [{"primitives": [{"attributes": {"POSITION": file.accessor(np.eye(3, dtype=np.float32))}}]}]
    file.document["nodes"] = [{"children": [k + 1]} for k in range(depth - 1)] + [{"mesh": 0}]
    assert refused(read_meshes, file.write(tmp_path / "a.gltf"), "here") == is_refused


@pytest.mark.parametrize(("meshes", "is_refused"), [(767, False), (769, True)])
def test_moving_meshes_are_limited_by_the_nodes_above_them(tmp_path, meshes, is_refused):
    triangle = AnimatedTriangle().move(1, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]])
    triangle.document["nodes"] = [{"mesh": 0} for _ in range(meshes)]
    triangle.document["scenes"] = [{"nodes": list(range(meshes))}]
    channel = triangle.document["animations"][0]["channels"][0]
    channels = [{**channel, "target": {"node": k, "path": "translation"}} for k in range(meshes)]
    triangle.document["animations"][0]["channels"] = channels
    assert refused(read_meshes, triangle.write(tmp_path / "a.gltf"), "here") == is_refused


def test_what_is_not_drawn_is_told_in_20_lines_at_most(tmp_path):
    sheet = TexturedSquare()
    sheet.document["extensionsUsed"] = [f"EXT_{k}" for k in range(1000)]
    lines = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").unsupported
    assert len(lines) == 20
    assert lines[-1].endswith("has more that is not drawn")
