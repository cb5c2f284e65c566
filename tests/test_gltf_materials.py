"""Materials of glTF files as they are drawn: emission, textures and their coordinates, both models, and reports of what is not drawn."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.gltf_files import CORNERS, UPRIGHT, TexturedSquare
from tests.support.rendering import SceneRenderer
from vemlight.errors import UserError
from vemlight.light.light_set import LightSet
from vemlight.renderer.scene.gltf import GltfFile
from vemlight.renderer.scene.materials import Ggx, SpecularGlossiness, Unlit
from vemlight.renderer.scene.mesh_files import read_meshes
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

ABOVE = "[camera]\nfrom = [0.0, 0.0, 10.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 11.0\n"  # sees x, y from -0.963 to 0.963
DARK = LightSet.none()
SUN = LightSet.of(np.zeros(1), np.array([[0.0, 0.0, 1.0]]), np.full((1, 3), np.pi))
RED, GREEN, BLUE, WHITE = (255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255)
FOUR = np.array([[RED, GREEN], [BLUE, WHITE]], np.uint8)


def drawn(folder: Path, sheet: TexturedSquare, lights: LightSet = DARK, more: str = "", samples: int = 1, side: int = 8) -> np.ndarray:
    """(side, side, 4), the square seen from above with its x to the right and its y upwards."""
    sheet.write(folder / "sheet.gltf")
    (folder / "scene.toml").write_text(ABOVE + '[[mesh]]\nfile = "sheet.gltf"\ny_up = false\n' + more)
    renderer = SceneRenderer(load_scene(folder / "scene.toml"), Settings(width=side, height=side, shadow_map=128), samples)
    picture = renderer.picture(lights).copy()
    renderer.release()
    return picture


def emissive(uv: np.ndarray | None = UPRIGHT, pixels: np.ndarray = FOUR, info: dict | None = None, **sampler: int) -> TexturedSquare:
    """A square that shows an image by its emission alone."""
    sheet = TexturedSquare(uv, emissiveFactor=[1.0, 1.0, 1.0])
    sheet.material["emissiveTexture"] = sheet.image(pixels, info, **sampler)
    return sheet


def corners(picture: np.ndarray) -> list[list[float]]:
    """The colours near the corners: left and right on top, left and right below."""
    last = len(picture) - 2
    return [picture[row, col, :3].round(3).tolist() for row in (1, last) for col in (1, last)]


def test_emission_is_radiance_added_to_what_is_reflected(tmp_path):
    plain = TexturedSquare(pbrMetallicRoughness={"baseColorFactor": [0.5, 0.4, 0.3, 1.0], "metallicFactor": 0.0})
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": 12.5}}
    same = plain.material["pbrMetallicRoughness"]
    bright = TexturedSquare(pbrMetallicRoughness=same, emissiveFactor=[0.2, 0.4, 1.0], extensions=strength)
    assert np.allclose(drawn(tmp_path, bright)[..., :3], [2.5, 5.0, 12.5], rtol=1e-6)
    both, reflected = drawn(tmp_path, bright, SUN, samples=4), drawn(tmp_path, plain, SUN, samples=4)
    assert np.allclose((both - reflected)[..., :3], [2.5, 5.0, 12.5], rtol=1e-5)
    assert np.array_equal(both[..., 3], reflected[..., 3])


def test_emission_lights_nothing_else(tmp_path):
    ground = '[[mesh]]\nshape = "plane"\nat = [0.0, 0.0, -0.5]\nmaterial = {diffuse = [0.8, 0.8, 0.8]}\n'
    sheet = TexturedSquare(emissiveFactor=[1.0, 1.0, 1.0])
    sheet.document["nodes"][0]["scale"] = [0.5, 0.5, 0.5]
    picture = drawn(tmp_path, sheet, more=ground)
    assert picture[4, 4, 0] == pytest.approx(1)
    assert picture[0, 0].tolist() == [0, 0, 0, 1]


def test_an_emissive_image_is_coded_in_srgb_and_times_the_factor(tmp_path):
    sheet = emissive(pixels=np.full((2, 2, 3), 188, np.uint8))
    sheet.material["emissiveFactor"] = [1.0, 0.5, 0.0]
    # sRGB 188 is ((188 / 255 + 0.055) / 1.055)^2.4 = 0.5029; half floats keep 11 bits of it
    assert np.allclose(drawn(tmp_path, sheet)[..., :3], [0.5029, 0.2515, 0], atol=3e-4)


def test_an_unlit_surface_is_its_colour_in_any_light(tmp_path):
    sheet = TexturedSquare(extensions={"KHR_materials_unlit": {}}, pbrMetallicRoughness={"baseColorFactor": [0.8, 0.4, 0.2, 1.0]})
    sheet.material["pbrMetallicRoughness"]["baseColorTexture"] = sheet.image(FOUR)
    sheet.attribute("COLOR_0", np.full((4, 3), 0.5, np.float32))
    for lights in (DARK, SUN):
        assert np.allclose(corners(drawn(tmp_path, sheet, lights)), [[0.4, 0, 0], [0, 0.2, 0], [0, 0, 0.1], [0.4, 0.2, 0.1]], atol=1e-3)


def test_images_lie_upright_and_wrap_as_their_sampler_says(tmp_path):
    red, green, blue, white = ([c / 255 for c in colour] for colour in (RED, GREEN, BLUE, WHITE))
    assert corners(drawn(tmp_path, emissive())) == [red, green, blue, white]
    beyond = UPRIGHT + np.array([0.5, 0], np.float32)  # from the middle of one image to the middle of the next
    assert corners(drawn(tmp_path, emissive(beyond))) == [green, red, white, blue]
    assert corners(drawn(tmp_path, emissive(beyond, wrapS=33071))) == [green, green, white, white]
    assert corners(drawn(tmp_path, emissive(beyond, wrapS=33648))) == [green, green, white, white]
    whole = UPRIGHT + np.array([1, 0], np.float32)
    assert corners(drawn(tmp_path, emissive(whole, wrapS=33648))) == [green, red, white, blue]
    assert corners(drawn(tmp_path, emissive(whole, wrapT=33648))) == [red, green, blue, white]
    below = UPRIGHT + np.array([0, 1], np.float32)
    assert corners(drawn(tmp_path, emissive(below, wrapT=33648))) == [blue, white, red, green]
    assert corners(drawn(tmp_path, emissive(below, wrapT=33071))) == [blue, white, blue, white]


def test_nearest_texels_have_edges_and_linear_ones_none(tmp_path):
    pixels = np.array([[[0] * 3, [255] * 3]], np.uint8)
    sharp = drawn(tmp_path, emissive(pixels=pixels), side=16)[8, :, 0]
    assert set(sharp.tolist()) == {0, 1}
    smooth = drawn(tmp_path, emissive(pixels=pixels, magFilter=9729, wrapS=33071), side=16)[8, 5:11, 0]
    assert np.all(np.diff(smooth) > 0.05)


def test_a_texture_transform_scales_turns_and_moves(tmp_path):
    # The standard's example: offset 0, 1, a quarter turn and half the size show the lower left quarter, turned clockwise by a quarter.
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[2:, :2] = FOUR
    transform = {"KHR_texture_transform": {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}}
    red, green, blue, white = ([c / 255 for c in colour] for colour in (RED, GREEN, BLUE, WHITE))
    assert corners(drawn(tmp_path, emissive(pixels=pixels, info={"extensions": transform}))) == [blue, red, white, green]
    flipped = {"KHR_texture_transform": {"offset": [0, 1], "scale": [1, -1]}}
    assert corners(drawn(tmp_path, emissive(info={"extensions": flipped}))) == [blue, white, red, green]


def test_a_texture_may_use_the_second_set_of_coordinates(tmp_path):
    for info in ({"texCoord": 1}, {"extensions": {"KHR_texture_transform": {"texCoord": 1}}}):
        sheet = emissive(info=info).attribute("TEXCOORD_1", UPRIGHT[:, ::-1])
        sheet.material["pbrMetallicRoughness"] = {"metallicFactor": 0.0, "baseColorTexture": sheet.image(np.zeros((1, 1, 3), np.uint8))}
        red, green, blue, white = ([c / 255 for c in colour] for colour in (RED, GREEN, BLUE, WHITE))
        assert corners(drawn(tmp_path, sheet)) == [red, blue, green, white]


def test_coordinates_and_colours_may_be_short_integers(tmp_path):
    sheet = emissive(uv=None).attribute("TEXCOORD_0", (UPRIGHT * 65535).astype(np.uint16), normalized=True)
    assert corners(drawn(tmp_path, sheet)) == [[c / 255 for c in colour] for colour in (RED, GREEN, BLUE, WHITE)]
    unlit = TexturedSquare(extensions={"KHR_materials_unlit": {}})
    unlit.attribute("COLOR_0", np.full((4, 4), 128, np.uint8), normalized=True)
    assert np.allclose(drawn(tmp_path, unlit)[..., :3], 128 / 255, atol=1e-3)


def test_sparse_places_replace_those_of_the_buffer(tmp_path):
    sheet = TexturedSquare()
    rows, values = sheet.accessor(np.array([[2]], np.uint16)), sheet.accessor(np.array([[1, 3, 0]], np.float32))
    views = [sheet.document["accessors"][k]["bufferView"] for k in (rows, values)]
    sheet.document["accessors"][0]["sparse"] = {
        "count": 1, "indices": {"bufferView": views[0], "componentType": 5123}, "values": {"bufferView": views[1]},
    }  # fmt: skip
    (part,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
    assert part.geometry.positions[:, 1].max() == 3


def test_specular_glossiness_is_metallic_roughness_in_other_terms(tmp_path):
    metal = TexturedSquare(pbrMetallicRoughness={"baseColorFactor": [0.9, 0.6, 0.3, 1.0], "metallicFactor": 1.0, "roughnessFactor": 0.4})
    old = {"diffuseFactor": [0.0, 0.0, 0.0, 1.0], "specularFactor": [0.9, 0.6, 0.3], "glossinessFactor": 0.6}
    same = TexturedSquare(extensions={"KHR_materials_pbrSpecularGlossiness": old})
    assert np.allclose(drawn(tmp_path, same, SUN), drawn(tmp_path, metal, SUN), rtol=2e-3)
    plastic = TexturedSquare(pbrMetallicRoughness={"baseColorFactor": [0.5, 0.4, 0.3, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.5})
    # 1 - max(specular) is left for the diffuse part here, all of it there
    old = {"diffuseFactor": [0.5 / 0.96, 0.4 / 0.96, 0.3 / 0.96, 1.0], "specularFactor": [0.04, 0.04, 0.04]}
    same = TexturedSquare(extensions={"KHR_materials_pbrSpecularGlossiness": {**old, "glossinessFactor": 1.0}})
    texture = np.array([[[255, 255, 255, 128]]], np.uint8)
    same.material["extensions"]["KHR_materials_pbrSpecularGlossiness"]["specularGlossinessTexture"] = same.image(texture)
    assert np.allclose(drawn(tmp_path, same, SUN), drawn(tmp_path, plastic, SUN), rtol=1e-2)


def test_the_refractive_index_is_how_much_a_surface_reflects(tmp_path):
    for index, reflected in ((1.0, 0.0), (1.5, 0.04), (2.0, 1 / 9)):
        sheet = TexturedSquare(extensions={"KHR_materials_ior": {"ior": index}}, pbrMetallicRoughness={"metallicFactor": 0.0})
        (part,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
        assert isinstance(part.material, Ggx)
        assert part.material.reflectance == pytest.approx(reflected)


def test_a_normal_maps_scale_makes_it_steeper(tmp_path):
    sheet = TexturedSquare(pbrMetallicRoughness={"metallicFactor": 0.0})
    sheet.material["normalTexture"] = sheet.image(np.full((1, 1, 3), (191, 128, 255), np.uint8), {"scale": 0.5})
    (part,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
    assert isinstance(part.material, Ggx)
    assert part.material.normal_map is not None
    assert 2 * part.material.normal_map.texels[0, 0].astype(float) - 1 == pytest.approx([0.25, 0, 1], abs=5e-3)


def test_metallic_is_in_blue_and_roughness_in_green(tmp_path):
    sheet = TexturedSquare()
    image = sheet.image(np.full((1, 1, 3), (10, 51, 204), np.uint8))
    sheet.material["pbrMetallicRoughness"] = {"metallicRoughnessTexture": image}
    (part,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
    assert isinstance(part.material, Ggx)
    assert part.material.metallic_roughness_map is not None
    assert part.material.metallic_roughness_map.texels[0, 0].tolist() == pytest.approx([0.8, 0.2], abs=1e-3)


def test_numbers_that_end_beyond_their_buffer_are_refused(tmp_path):
    sheet = TexturedSquare()  # its texture coordinates come last
    sheet.data = sheet.data[:-4]
    with pytest.raises(UserError, match="outside their buffer"):
        read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here")


def test_emission_ends_at_the_largest_half_float(tmp_path):
    for strength, radiance in ((6e4, 6e4), (1e5, 65504.0)):
        sheet = TexturedSquare(emissiveFactor=[1.0, 1.0, 1.0])
        sheet.material["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
        (part,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
        assert isinstance(part.material, Ggx)
        assert part.material.emission == (radiance,) * 3


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


def test_strips_and_vertices_without_indices_are_triangles(tmp_path):
    sheet = TexturedSquare()
    sheet.primitive.update(mode=5, indices=sheet.accessor(np.array([0, 1, 3, 2], np.uint32)[:, None]))
    (strip,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
    assert strip.geometry.positions[strip.geometry.triangles].tolist() == CORNERS[[[0, 1, 3], [2, 3, 1]]].tolist()
    sheet = TexturedSquare(uv=None)
    sheet.attribute("POSITION", CORNERS[[0, 1, 2, 0, 2, 3]])
    del sheet.primitive["indices"]
    (loose,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
    assert len(loose.geometry.triangles) == 2


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
    with pytest.raises(UserError, match="there is no such file"):
        read_meshes(path, "here")


def test_an_image_is_read_once_for_all_materials(tmp_path):
    sheet = emissive()
    sheet.document["materials"].append(dict(sheet.material, name="Other"))
    sheet.document["meshes"][0]["primitives"].append(dict(sheet.primitive, material=1))
    one, other = (part.material for part in read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts)
    assert isinstance(one, Ggx)
    assert isinstance(other, Ggx)
    assert one.emission_map is not None
    assert other.emission_map is not None
    assert one.emission_map.texels is other.emission_map.texels


def test_materials_of_a_mesh_that_has_none_or_several_kinds(tmp_path):
    kinds = []
    for extension in ({}, {"KHR_materials_unlit": {}}, {"KHR_materials_pbrSpecularGlossiness": {}}):
        kinds.append(type(read_meshes(TexturedSquare(extensions=extension).write(tmp_path / "s.gltf"), "here").parts[0].material))
    assert kinds == [Ggx, Unlit, SpecularGlossiness]
    sheet = TexturedSquare()
    del sheet.primitive["material"]
    assert read_meshes(sheet.write(tmp_path / "s.gltf"), "here").parts[0].material is None


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
    return "sheet.gltf: mesh Square: its points, lines or fans are left out; triangles and strips are drawn"


@pytest.mark.parametrize("leave", [value for name, value in sorted(globals().items()) if name.startswith("left_")])
def test_what_is_not_drawn_is_reported_in_one_line(tmp_path, leave, capsys):
    sheet = emissive()
    line = leave(sheet).format(folder=tmp_path)
    drawn(tmp_path, sheet, SUN)
    assert capsys.readouterr().err == f"vemlight: {tmp_path / 'scene.toml'}: [[mesh]] 1: {line}\n"


def test_a_good_file_is_read_in_silence(tmp_path, capsys):
    drawn(tmp_path, emissive())
    assert capsys.readouterr().err == ""


def test_a_material_of_the_scene_file_needs_no_images(tmp_path, capsys):
    sheet = emissive()
    sheet.document["images"][0] = {"uri": "absent.png"}
    drawn(tmp_path, sheet, more="material = {diffuse = [0.5, 0.5, 0.5]}\n")
    assert capsys.readouterr().err == ""
