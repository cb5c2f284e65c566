"""Materials of glTF files as they are drawn: emission, unlit, both reflection models and their factors."""

import numpy as np
import pytest

from tests.support.gltf_files import TexturedSquare
from tests.support.gltf_squares import DARK, FOUR_COLOURS, SUN, corners, drawn, emissive
from vemlight.renderer.scene.materials import Ggx, SpecularGlossiness, Unlit
from vemlight.renderer.scene.mesh_files import read_meshes


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
    sheet.material["pbrMetallicRoughness"]["baseColorTexture"] = sheet.image(FOUR_COLOURS)
    sheet.attribute("COLOR_0", np.full((4, 3), 0.5, np.float32))
    for lights in (DARK, SUN):
        assert np.allclose(corners(drawn(tmp_path, sheet, lights)), [[0.4, 0, 0], [0, 0.2, 0], [0, 0, 0.1], [0.4, 0.2, 0.1]], atol=1e-3)


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


def test_emission_ends_at_the_largest_half_float(tmp_path):
    for strength, radiance in ((6e4, 6e4), (1e5, 65504.0)):
        sheet = TexturedSquare(emissiveFactor=[1.0, 1.0, 1.0])
        sheet.material["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}
        (part,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts
        assert isinstance(part.material, Ggx)
        assert part.material.emission == (radiance,) * 3


def test_materials_of_a_mesh_that_has_none_or_several_kinds(tmp_path):
    kinds = []
    for extension in ({}, {"KHR_materials_unlit": {}}, {"KHR_materials_pbrSpecularGlossiness": {}}):
        kinds.append(type(read_meshes(TexturedSquare(extensions=extension).write(tmp_path / "s.gltf"), "here").parts[0].material))
    assert kinds == [Ggx, Unlit, SpecularGlossiness]
    sheet = TexturedSquare()
    del sheet.primitive["material"]
    assert read_meshes(sheet.write(tmp_path / "s.gltf"), "here").parts[0].material is None


def test_a_material_of_the_scene_file_needs_no_images(tmp_path, capsys):
    sheet = emissive()
    sheet.document["images"][0] = {"uri": "absent.png"}
    drawn(tmp_path, sheet, more="material = {diffuse = [0.5, 0.5, 0.5]}\n")
    assert capsys.readouterr().err == ""
