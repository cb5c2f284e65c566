"""Textures of glTF files as they are drawn: samplers, transforms and texture coordinates."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from tests.support.gltf_files import UPRIGHT, TexturedSquare
from tests.support.gltf_squares import BLUE, FOUR_COLOURS, GREEN, RED, WHITE, corners, drawn, emissive
from vemlight.renderer.scene import gltf_materials
from vemlight.renderer.scene.materials import Ggx
from vemlight.renderer.scene.mesh_files import read_meshes


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
    pixels[2:, :2] = FOUR_COLOURS
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


@pytest.mark.parametrize(("free_bytes", "left_out"), [(2 * 64 * 64 * 3 * 2, 0), (2 * 64 * 64 * 3 * 2 - 1, 1)])
def test_a_files_textures_together_are_limited_by_the_bytes_that_they_are_stored_in(tmp_path, monkeypatch, free_bytes, left_out):
    monkeypatch.setattr(gltf_materials, "FREE_TEXTURE_BYTES", free_bytes)
    monkeypatch.setattr(gltf_materials, "TEXTURE_RATIO", 0)
    sheet = emissive(pixels=np.zeros((64, 64, 3), np.uint8))
    sheet.material["pbrMetallicRoughness"] = {"baseColorTexture": sheet.image(np.ones((64, 64, 3), np.uint8))}
    file = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here")
    assert len(file.unsupported) == left_out
    assert all("is left out: with the other textures it takes far more memory" in line for line in file.unsupported)


def test_an_image_too_large_for_its_bytes_is_left_out_with_a_line(tmp_path):
    sheet = emissive()
    image = io.BytesIO()
    Image.new("1", (9000, 9000)).save(image, "PNG")  # 81 million pixels in 10 kB
    sheet.document["images"][0]["uri"] = "data:image/png;base64," + base64.b64encode(image.getvalue()).decode()
    (line,) = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").unsupported
    assert "is left out: image 0: has 9000 x 9000 pixels in" in line
