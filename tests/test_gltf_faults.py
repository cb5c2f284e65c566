"""Invalid, damaged and unsupported content of glTF files: each is one line, an error or a report of what is not drawn."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.support.gltf_files import CORNERS, UPRIGHT
from tests.support.gltf_squares import SUN, drawn, emissive
from vemlight.errors import UserError
from vemlight.renderer.scene.mesh_files import read_meshes


def invalid_index(sheet):
    sheet.material["emissiveTexture"]["index"] = 7


def invalid_negative_index(sheet):
    sheet.material["emissiveTexture"]["index"] = -1


def invalid_cutoff(sheet):
    sheet.material.update(alphaMode="MASK", alphaCutoff=float("nan"))


def invalid_mode(sheet):
    sheet.material["alphaMode"] = "GLASS"


def invalid_factor(sheet):
    sheet.material["emissiveFactor"] = [1.0, "red", 0.0]


def invalid_negative(sheet):
    sheet.material["emissiveFactor"] = [1.0, -1.0, 0.0]


def invalid_strength(sheet):
    sheet.material["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": 1e999}}


def invalid_material(sheet):
    sheet.primitive["material"] = 3


def invalid_image(sheet):
    sheet.document["images"][0]["uri"] = sheet.document["images"][0]["uri"][:-40]


def invalid_base64(sheet):
    sheet.document["images"][0]["uri"] = "data:image/png;base64,%%%%"


def invalid_sampler(sheet):
    sheet.document["samplers"][0]["wrapS"] = 1


def invalid_count(sheet):
    sheet.attribute("TEXCOORD_0", UPRIGHT[:3])


def invalid_required(sheet):
    sheet.document["extensionsRequired"] = ["KHR_draco_mesh_compression"]


def invalid_shape(sheet):
    sheet.material["pbrMetallicRoughness"] = [1, 2]


@pytest.mark.parametrize("invalidate", [value for name, value in sorted(globals().items()) if name.startswith("invalid_")])
def test_an_invalid_material_is_one_line(tmp_path, invalidate):
    sheet = emissive()
    invalidate(sheet)
    with pytest.raises(UserError, match=r"^here: .*sheet\.gltf .*export it again$") as caught:
        read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here")
    assert "\n" not in str(caught.value)


def branches(value: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The ways to all that lies in a JSON document."""
    for key in value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ():
        yield (*way, key)
        yield from branches(value[key], (*way, key))


def test_whatever_stands_in_a_file_is_read_or_refused_in_one_line(tmp_path):
    sheet = emissive(info={"extensions": {"KHR_texture_transform": {"scale": [2, 2], "texCoord": 1}}}, wrapS=33648)
    sheet.attribute("TEXCOORD_1", UPRIGHT).attribute("COLOR_0", np.full((4, 4), 0.5, np.float32))
    sheet.material.update(alphaMode="BLEND", normalTexture={"index": 0, "scale": 2.0}, extensions={"KHR_materials_ior": {"ior": 1.4}})
    times, places = sheet.accessor(np.array([[0], [1]], np.float32)), sheet.accessor(np.zeros((2, 3), np.float32))
    channel, sampler = {"sampler": 0, "target": {"node": 0, "path": "translation"}}, {"input": times, "output": places}
    sheet.document.update(animations=[{"channels": [channel], "samplers": [sampler]}], extensionsUsed=["KHR_materials_ior", "KHR_other"])
    path = sheet.write(tmp_path / "sheet.gltf")
    whole = json.loads(path.read_text())
    read_meshes(path, "here")
    ways, rng, refused = list(branches(whole)), np.random.default_rng(5), []
    for _ in range(300):
        damaged = json.loads(json.dumps(whole))
        *way, last = ways[rng.integers(len(ways))]
        place = damaged
        for key in way:
            place = place[key]
        place[last] = (None, -1, 7, 1e30, "", "x", [], {}, [[]], True, 1.5, {"index": 0})[rng.integers(12)]
        path.write_text(json.dumps(damaged))
        try:
            read_meshes(path, "here")
        except UserError as error:
            refused.append(str(error))
    assert 100 < len(refused) < 300
    assert not any("\n" in line for line in refused)


def left_absent_image(sheet):
    sheet.document["images"][0] = {"uri": "glow%20map.png"}
    return "sheet.gltf: material Paint: its emissiveTexture is left out: there is no {folder}/glow map.png"


def left_absent_coordinates(sheet):
    sheet.material["emissiveTexture"]["texCoord"] = 1
    return "sheet.gltf: material Paint: its emissiveTexture is left out: it lies by TEXCOORD_1, the mesh does not have"


def left_third_coordinates(sheet):
    sheet.material["emissiveTexture"]["texCoord"] = 2
    return "sheet.gltf: material Paint: its emissiveTexture is left out: it lies by TEXCOORD_2, of which only 0 and 1 are drawn"


def left_other_format(sheet):
    sheet.document["textures"][0] = {"extensions": {"KHR_texture_basisu": {"source": 0}}}
    return "sheet.gltf: material Paint: its emissiveTexture is left out: it has no image of a kind that is read here"


def left_no_image(sheet):
    sheet.document["images"][0] = {"uri": "data:image/ktx2;base64,q0tUWCAyMLsNChoK"}
    return "sheet.gltf: material Paint: its emissiveTexture is left out: it is no image of a kind that is read here"


def left_extension(sheet):
    sheet.document["extensionsUsed"] = ["KHR_materials_clearcoat"]
    sheet.material["extensions"] = {"KHR_materials_clearcoat": {"clearcoatFactor": 1.0}}
    return "sheet.gltf: KHR_materials_clearcoat is not drawn, of material Paint"


def left_morph(sheet):
    sheet.primitive["targets"] = [{"POSITION": sheet.accessor(CORNERS)}]
    return "sheet.gltf: mesh Square: its morph targets are left out; it keeps its first form"


def left_skin(sheet):
    sheet.document["nodes"][0]["skin"] = 0
    return "sheet.gltf: node 0: its skin is left out; it keeps its first form"


def left_points(sheet):
    sheet.document["meshes"][0]["primitives"].append({"attributes": sheet.primitive["attributes"], "mode": 0})
    return "sheet.gltf: mesh Square: its points or lines are left out; triangles are drawn"


@pytest.mark.parametrize("leave", [value for name, value in sorted(globals().items()) if name.startswith("left_")])
def test_what_is_not_drawn_is_reported_in_one_line(tmp_path, leave, capsys):
    sheet = emissive()
    line = leave(sheet).format(folder=tmp_path)
    drawn(tmp_path, sheet, SUN)
    assert capsys.readouterr().err == f"vemlight: {tmp_path / 'scene.toml'}: [[mesh]] 1: {line}\n"


def test_a_good_file_is_read_in_silence(tmp_path, capsys):
    drawn(tmp_path, emissive())
    assert capsys.readouterr().err == ""
