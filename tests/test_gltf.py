"""Accessors, primitives and nodes of glTF files."""

import json
import os

import numpy as np
import pytest

from tests.support.gltf_files import CORNERS, TexturedSquare
from vemlight.errors import UserError
from vemlight.renderer.scene.gltf import GltfFile
from vemlight.renderer.scene.mesh_files import read_meshes


def test_sparse_places_replace_those_of_the_buffer(tmp_path):
    sheet = TexturedSquare()
    rows, values = sheet.accessor(np.array([[2]], np.uint16)), sheet.accessor(np.array([[1, 3, 0]], np.float32))
    views = [sheet.document["accessors"][k]["bufferView"] for k in (rows, values)]
    sheet.document["accessors"][0]["sparse"] = {
        "count": 1, "indices": {"bufferView": views[0], "componentType": 5123}, "values": {"bufferView": views[1]},
    }  # fmt: skip
    (part,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
    assert part.geometry.positions[:, 1].max() == 3


def test_numbers_that_end_beyond_their_buffer_are_refused(tmp_path):
    sheet = TexturedSquare()  # its texture coordinates come last
    sheet.data = sheet.data[:-4]
    with pytest.raises(UserError, match="outside their buffer"):
        read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here")


@pytest.mark.parametrize(("count", "with_data", "refused"), [
    (2**20, False, ""),
    (2**20 + 1, False, "rows without data"),
    (45_000_000, True, "outside their buffer"),
    (55_000_000, True, "has 55000000 rows"),
])  # fmt: skip
def test_an_accessor_has_at_most_50_million_rows_and_a_million_without_data(tmp_path, count, with_data, refused):
    sheet = TexturedSquare()
    accessor = {"componentType": 5121, "type": "SCALAR", "count": count}
    sheet.document["accessors"].append({**accessor, "bufferView": 0} if with_data else accessor)
    file, number = GltfFile(sheet.write(tmp_path / "sheet.gltf")), len(sheet.document["accessors"]) - 1
    if refused:
        with pytest.raises(ValueError, match=refused):
            file.array(number)
    else:
        assert not file.array(number).any()


def test_files_of_gltf_1_are_refused(tmp_path):
    sheet = TexturedSquare()
    sheet.document["asset"]["version"] = "1.0"
    with pytest.raises(UserError, match="is of another version than glTF 2"):
        read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here")


def test_files_that_need_a_later_version_are_refused(tmp_path):
    sheet = TexturedSquare()
    sheet.document["asset"]["minVersion"] = "2.5"
    with pytest.raises(UserError, match=r"needs glTF 2\.5"):
        read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here")


def test_numbers_behind_the_end_of_their_view_are_none(tmp_path):
    sheet = TexturedSquare()
    position = sheet.document["accessors"][sheet.primitive["attributes"]["POSITION"]]
    sheet.document["bufferViews"][position["bufferView"]]["byteLength"] -= 4
    with pytest.raises(UserError, match="outside their buffer view"):
        read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here")


def test_what_a_node_hides_is_not_drawn(tmp_path):
    sheet = TexturedSquare()
    nodes = sheet.document["nodes"]
    nodes += [{"mesh": 0}, {"children": [len(nodes)], "extensions": {"KHR_node_visibility": {"visible": False}}}]
    sheet.document["scenes"][0]["nodes"].append(len(nodes) - 1)
    sheet.document["extensionsRequired"] = sheet.document["extensionsUsed"] = ["KHR_node_visibility"]
    assert len(read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts) == 1
    nodes[-1]["extensions"]["KHR_node_visibility"]["visible"] = True
    assert len(read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts) == 2


def test_strips_and_vertices_without_indices_are_triangles(tmp_path):
    sheet = TexturedSquare()
    sheet.primitive.update(mode=5, indices=sheet.accessor(np.array([0, 1, 3, 2], np.uint32)[:, None]))
    (strip,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
    assert strip.geometry.positions[strip.geometry.triangles].tolist() == CORNERS[[[0, 1, 3], [1, 2, 3]]].tolist()
    sheet = TexturedSquare(uv=None)
    sheet.attribute("POSITION", CORNERS[[0, 1, 2, 0, 2, 3]])
    del sheet.primitive["indices"]
    (loose,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
    assert len(loose.geometry.triangles) == 2


def test_fans_are_triangles(tmp_path):
    sheet = TexturedSquare()
    sheet.primitive.update(mode=6, indices=sheet.accessor(np.array([0, 1, 2, 3], np.uint32)[:, None]))
    (fan,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
    assert fan.geometry.positions[fan.geometry.triangles].tolist() == CORNERS[[[0, 1, 2], [0, 2, 3]]].tolist()


@pytest.mark.parametrize(
    ("hidden", "said"),
    [
        ({"mesh": 0, "scale": [0, 0, 0], "name": "a"}, "node a is left out: its scale is 0"),
        ({"scale": [0, 0, 0], "children": [2]}, "node 2 is left out: its scale is 0"),
        ({"mesh": 0, "scale": [0, 0, 1]}, "node 1 is left out: its scale is 0"),
        ({"mesh": 1}, "part 1 has no size and is left out"),
        ({"mesh": 2}, "a mesh of node 1 is left out: it is empty"),
        ({"mesh": 3}, "a mesh of node 1 is left out: it is empty"),
    ],
)
def test_what_cannot_be_seen_spoils_nothing(tmp_path, hidden, said):
    sheet = TexturedSquare()
    point = sheet.accessor(np.zeros((3, 3), np.float32))
    empty = sheet.accessor(np.zeros((0, 3), np.float32))
    primitives = [{"attributes": {"POSITION": point}}, {"attributes": {"POSITION": empty}}, {"attributes": {}}]
    sheet.document["meshes"] += [{"primitives": [primitive]} for primitive in primitives]
    sheet.document.update(nodes=[{"mesh": 0}, hidden, {"mesh": 0}], scenes=[{"nodes": [0, 1]}])
    file = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here")
    assert len(file.parts) == 1
    assert file.unsupported == [f"sheet.gltf: {said}"]


def test_a_node_that_is_pressed_flat_is_drawn(tmp_path):
    sheet = TexturedSquare()
    sheet.attribute("NORMAL", np.tile(np.array([0, 0, 1], np.float32), (4, 1)))
    sheet.document["nodes"][0].update(scale=[1, 1, 0])
    (part,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
    assert np.abs(part.geometry.normals) == pytest.approx(np.tile([0, 0, 1], (4, 1)))


def test_instances_of_a_mesh_are_placed_in_their_node(tmp_path):
    sheet = TexturedSquare()
    places = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0]], np.float32)
    half = np.sqrt(0.5)
    turns = np.array([[0, 0, 0, 1], [half, 0, 0, half], [0, 0, 0, 1]], np.float32)
    scales = np.array([[1, 1, 1], [1, 1, 1], [2, 0.5, 1]], np.float32)
    attributes = {"TRANSLATION": sheet.accessor(places), "ROTATION": sheet.accessor(turns), "SCALE": sheet.accessor(scales)}
    sheet.document.update(extensionsUsed=["EXT_mesh_gpu_instancing"], extensionsRequired=["EXT_mesh_gpu_instancing"])
    sheet.document["nodes"][0].update(translation=[0, 0, 5], extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
    file = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here")
    assert file.unsupported == []
    middles = [part.geometry.positions.mean(axis=0) for part in file.parts]
    assert middles == [pytest.approx(place + np.array([0, 0, 5]), abs=1e-5) for place in places]
    sides = [np.ptp(part.geometry.positions, axis=0) for part in file.parts]
    assert sides == [pytest.approx(side, abs=1e-5) for side in ([2, 2, 0], [2, 0, 2], [4, 1, 0])]
    attributes["SCALE"] = sheet.accessor(scales[:2])
    with pytest.raises(UserError, match="not as many as each other"):
        read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here")


def test_a_node_with_two_parents_is_refused(tmp_path):
    sheet = TexturedSquare()
    sheet.document.update(nodes=[{"children": [2]}, {"children": [2]}, {"mesh": 0}], scenes=[{"nodes": [0, 1]}])
    with pytest.raises(UserError, match="has nodes with several parents"):
        read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here")


def test_transforms_of_nested_nodes_apply_from_the_mesh_up(tmp_path):
    sheet = TexturedSquare()
    half = float(np.sqrt(0.5))
    sheet.document["nodes"] = [{"translation": [5.0, 0.0, 0.0], "children": [1]}, {"mesh": 0, "rotation": [0.0, 0.0, half, half]}]
    (part,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
    assert np.allclose(part.geometry.positions, CORNERS @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + [5, 0, 0], atol=1e-6)


def test_a_device_is_no_buffer(tmp_path):
    sheet = TexturedSquare()
    path = sheet.write(tmp_path / "sheet.gltf")
    sheet.document["buffers"][0]["uri"] = "/dev/zero"
    path.write_text(json.dumps(sheet.document))
    with pytest.raises(UserError, match=r"^here: .*/dev/zero leads out of its folder"):
        read_meshes(path, "here")


def test_a_file_and_what_it_refers_to_have_a_gigabyte_together(tmp_path):
    sheet = TexturedSquare()
    path = sheet.write(tmp_path / "sheet.gltf")
    sheet.document["buffers"][0]["uri"] = "sparse.bin"
    path.write_text(json.dumps(sheet.document))
    (tmp_path / "sparse.bin").touch()
    os.truncate(tmp_path / "sparse.bin", 2**30 - path.stat().st_size + 1)
    with pytest.raises(UserError, match=r"sparse\.bin: has \d+ bytes, at most \d+ are read"):
        read_meshes(path, "here")


def test_an_accessor_is_read_once(tmp_path):
    file = GltfFile(TexturedSquare().write(tmp_path / "sheet.gltf"))
    assert file.array(0) is file.array(0)
    with pytest.raises(ValueError, match="read-only"):
        file.array(0)[:] = 0


def test_accessors_on_top_of_each_other_are_counted(tmp_path):
    sheet = TexturedSquare()
    bytes_view = sheet.accessor(np.zeros((2**20, 1), np.uint8))
    sheet.document["accessors"] += [dict(sheet.document["accessors"][bytes_view]) for _ in range(16)]
    file = GltfFile(sheet.write(tmp_path / "sheet.gltf"))
    for number in range(bytes_view, bytes_view + 16):  # 2^24 numbers, with those before none is left
        file.array(number)
    with pytest.raises(ValueError, match="on top of each other"):
        file.array(bytes_view + 16)
