from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from bench.renderer_truth import first_hits, near_edges, scene_tree, unshadowed, visible
from services.files import BadInput
from services.lights import Lights
from services.renderer.materials import Ggx, MaterialTable, Phong, material_from_table
from services.renderer.renderer import Renderer
from services.renderer.scene import load_scene
from services.settings import Renderer as Settings
from services.sphere import direction_from_angles

CAMERA = "[camera]\nfrom = [0.0, -4.0, 3.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 30.0\n"
ABOVE = "[camera]\nfrom = [0.0, 0.0, 10.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 11.0\n"  # sees x, y from -0.963 to 0.963


def scene_of(folder: Path, text: str, camera: str = CAMERA):
    (folder / "scene.toml").write_text(camera + text)
    return load_scene(folder / "scene.toml")


def drawn(scene, lights: Lights, width: int = 64, height: int = 64) -> np.ndarray:
    renderer = Renderer(scene, Settings(width=width, height=height, shadow_map=128))
    picture = renderer.render(lights).copy()
    renderer.release()
    return picture


def sky(count: int) -> Lights:
    """Radiance 1 from the upper hemisphere."""
    k = np.arange(count) + 0.5
    return Lights.of(k, direction_from_angles(np.arccos(k / count), k * np.pi * (3 - np.sqrt(5))), np.full((count, 3), 2 * np.pi / count))


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("roughness", [0.2, 0.6, 1.0])
def test_ggx_is_the_formula_of_gltf(tmp_path, metallic, roughness):
    material = f"material = {{base_color = [0.9, 0.5, 0.2], metallic = {metallic}, roughness = {roughness}}}"
    scene = scene_of(tmp_path, f'[[mesh]]\nshape = "sphere"\n{material}')
    tree = scene_tree(scene)
    hits = first_hits(scene, tree, 64, 64)
    for theta, phi in ((0.3, 4.5), (1.0, 0.0), (1.3, 5.5)):
        direction = direction_from_angles(theta, phi)
        seen = visible(tree, hits, direction, 1.0)
        truth = unshadowed(scene, hits, direction, np.ones(3)) * seen[..., None]
        picture = drawn(scene, Lights.of(np.zeros(1), direction[None], np.ones((1, 3))))[..., :3]
        inside = ~(near_edges(seen, 2) | near_edges(hits.triangle >= 0, 1))
        assert np.abs(picture - truth)[inside].max() < 5e-3 * max(truth.max(), 0.1)


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_a_white_ggx_plane_under_a_white_sky_gives_back_no_more_than_it_gets(tmp_path, metallic, roughness):
    text = f'[[mesh]]\nshape = "plane"\nmaterial = {{base_color = [1.0, 1.0, 1.0], metallic = {metallic}, roughness = {roughness}}}'
    radiance = drawn(scene_of(tmp_path, text, ABOVE), sky(3000), 4, 4)[..., :3]
    assert radiance.max() < 1.01
    if metallic == roughness == 1.0:
        # single bounces at alpha 1, seen from above: D = 1 / pi, G / (4 nl nv) = 1 / (2 (nl + 1)), so 2 pi times the integral of
        # nl / (2 pi (nl + 1)) over nl in 0 .. 1, which is 1 - ln 2
        assert np.allclose(radiance, 1 - np.log(2), atol=3e-3)
    elif metallic == 0.0 or roughness < 0.5:
        assert radiance.min() > 0.93


def test_keys_of_two_kinds_do_not_mix(tmp_path):
    assert material_from_table(MaterialTable()) == Phong()
    assert material_from_table(MaterialTable(base_color=(1, 0, 0))) == Ggx((1, 0, 0))
    for keys in ("diffuse = [0.1, 0.1, 0.1], roughness = 0.5", "metallic = 1.0", "base_color = [1.0, 1.0, 1.0], exponent = 3.0"):
        with pytest.raises(BadInput, match="either diffuse"):
            scene_of(tmp_path, f'[[mesh]]\nshape = "box"\nmaterial = {{{keys}}}')


def quad(folder: Path, name: str, image: Image.Image, roughness: float = 1.0) -> None:
    """A 2 x 2 plane in the file's x, y with an image over all of it, upright in u, v."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    material = PBRMaterial(baseColorTexture=image, metallicFactor=0.0, roughnessFactor=roughness)
    visual = TextureVisuals(uv=uv, material=material)
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False).export(folder / name)


def test_an_image_lies_upright_and_in_linear_light(tmp_path):
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0, 0], pixels[0, 1], pixels[1, 0], pixels[1, 1] = (255, 0, 0), (0, 255, 0), (0, 0, 255), (188, 188, 188)
    quad(tmp_path, "quad.glb", Image.fromarray(pixels).resize((64, 64), Image.Resampling.NEAREST))
    scene = scene_of(tmp_path, '[[mesh]]\nfile = "quad.glb"\ny_up = false', ABOVE)
    assert isinstance(scene.meshes[0].material, Ggx)
    picture = drawn(scene, sky(200), 8, 8)[..., :3]
    white = picture[1, 1, 0]  # the specular part is the same all over, so compare colours above it
    low = picture[1, 1, 1]
    share = (picture - low) / (white - low)
    assert np.allclose(share[1, 1], [1, 0, 0], atol=0.02)  # top left: red
    assert np.allclose(share[1, 6], [0, 1, 0], atol=0.02)
    assert np.allclose(share[6, 1], [0, 0, 1], atol=0.02)
    assert np.allclose(share[6, 6], 0.503, atol=0.02)  # sRGB 188 is ((188 / 255 + 0.055) / 1.055)^2.4 = 0.503


def test_a_huge_image_is_reduced(tmp_path):
    quad(tmp_path, "quad.glb", Image.new("RGB", (6000, 8), (255, 255, 255)))
    material = scene_of(tmp_path, '[[mesh]]\nfile = "quad.glb"').meshes[0].material
    assert isinstance(material, Ggx)
    assert material.image is not None
    assert max(material.image.shape) <= 4096


def test_the_scene_files_material_overrules_the_mesh_files(tmp_path):
    quad(tmp_path, "quad.glb", Image.new("RGB", (4, 4), (255, 0, 0)))
    scene = scene_of(tmp_path, '[[mesh]]\nfile = "quad.glb"\nmaterial = {diffuse = [0.1, 0.2, 0.3]}')
    assert scene.meshes[0].material == Phong((0.1, 0.2, 0.3))


def test_a_file_that_says_nothing_of_its_material_is_gray(tmp_path):
    (tmp_path / "plain.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    (tmp_path / "plainer.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for name in ("plain.obj", "plainer.obj"):
        assert scene_of(tmp_path, f'[[mesh]]\nfile = "{name}"').meshes[0].material == Phong()
