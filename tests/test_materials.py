from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from tests.support.ray_casting import first_hits, near_edges, scene_tree, unshadowed, visible
from tests.support.rendering import SceneRenderer
from vemlight.errors import UserError
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.scene.materials import Ggx, MaterialTable, Phong, material_from_table
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

CAMERA = "[camera]\nfrom = [0.0, -4.0, 3.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 30.0\n"
ABOVE = "[camera]\nfrom = [0.0, 0.0, 10.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 11.0\n"  # sees x, y from -0.963 to 0.963


def scene_of(folder: Path, text: str, camera: str = CAMERA):
    (folder / "scene.toml").write_text(camera + text)
    return load_scene(folder / "scene.toml")


def drawn(scene, lights: LightSet, width: int = 64, height: int = 64) -> np.ndarray:
    renderer = SceneRenderer(scene, Settings(width=width, height=height, shadow_map=128))
    picture = renderer.picture(lights).copy()
    renderer.release()
    return picture


def sky(count: int) -> LightSet:
    """Radiance 1 from the upper hemisphere."""
    k = np.arange(count) + 0.5
    return LightSet.of(k, direction_from_angles(np.arccos(k / count), k * np.pi * (3 - np.sqrt(5))), np.full((count, 3), 2 * np.pi / count))


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
        picture = drawn(scene, LightSet.of(np.zeros(1), direction[None], np.ones((1, 3))))[..., :3]
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
        with pytest.raises(UserError, match="either diffuse"):
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
    fraction = (picture - low) / (white - low)
    assert np.allclose(fraction[1, 1], [1, 0, 0], atol=0.02)  # top left: red
    assert np.allclose(fraction[1, 6], [0, 1, 0], atol=0.02)
    assert np.allclose(fraction[6, 1], [0, 0, 1], atol=0.02)
    assert np.allclose(fraction[6, 6], 0.503, atol=0.02)  # sRGB 188 is ((188 / 255 + 0.055) / 1.055)^2.4 = 0.503


def test_a_huge_image_is_reduced(tmp_path):
    quad(tmp_path, "quad.glb", Image.new("RGB", (6000, 8), (255, 255, 255)))
    material = scene_of(tmp_path, '[[mesh]]\nfile = "quad.glb"').meshes[0].material
    assert isinstance(material, Ggx)
    assert material.colour_map is not None
    assert max(material.colour_map.texels.shape) <= 4096


def test_the_scene_files_material_overrules_the_mesh_files(tmp_path):
    quad(tmp_path, "quad.glb", Image.new("RGB", (4, 4), (255, 0, 0)))
    scene = scene_of(tmp_path, '[[mesh]]\nfile = "quad.glb"\nmaterial = {diffuse = [0.1, 0.2, 0.3]}')
    assert scene.meshes[0].material == Phong((0.1, 0.2, 0.3))


def test_a_mesh_without_material_is_gray(tmp_path):
    (tmp_path / "plain.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nf 1/1 2/2 3/3\n")
    (tmp_path / "plainer.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    for name in ("plain.obj", "plainer.obj"):
        assert scene_of(tmp_path, f'[[mesh]]\nfile = "{name}"').meshes[0].material == Phong()


def bumpy_quad(folder: Path, code: tuple[int, int, int], mirrored: bool = False) -> None:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    if mirrored:
        uv[:, 0] = 1 - uv[:, 0]
    material = PBRMaterial(normalTexture=Image.new("RGB", (4, 4), code), baseColorFactor=[255, 255, 255, 255], metallicFactor=0.0)
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=TextureVisuals(uv=uv, material=material), process=False)
    mesh.export(folder / "quad.glb")


@pytest.mark.parametrize("camera", [ABOVE, ABOVE.replace("10.0]", "-10.0]"), CAMERA])
@pytest.mark.parametrize(("code", "normal"), [((230, 128, 204), (0.8, 0.0, 0.6)), ((128, 230, 204), (0.0, 0.8, 0.6))])
def test_a_normal_map_turns_the_normal_towards_its_axes(tmp_path, camera, code, normal):
    # x along u, y along v upwards; from below the normal is turned round with all it has
    bumpy_quad(tmp_path, code)
    scene = scene_of(tmp_path, '[[mesh]]\nfile = "quad.glb"\ny_up = false', camera)
    below = "-10.0]" in camera
    for direction in ((0.6, 0.0, 0.8), (-0.6, 0.0, 0.8), (0.0, 0.6, 0.8), (0.0, -0.6, 0.8)):
        light = np.array(direction) * [1, 1, -1 if below else 1]
        value = drawn(scene, LightSet.of(np.zeros(1), light[None], np.ones((1, 3))), 8, 8)[4, 4, 0]
        cosine = max(float(np.dot(normal, light)) * (-1 if below else 1), 0.0)
        # Lambert's fraction of the white, rough dielectric: 0.96 / pi and a specular part of a percent or two of the light
        assert value == pytest.approx(cosine / np.pi, abs=0.03)


def test_a_mirrored_normal_map_turns_the_other_way(tmp_path):
    bumpy_quad(tmp_path, (230, 128, 204), mirrored=True)
    scene = scene_of(tmp_path, '[[mesh]]\nfile = "quad.glb"\ny_up = false', ABOVE)
    left, right = (
        drawn(scene, LightSet.of(np.zeros(1), np.array([[x, 0.0, 0.8]]), np.ones((1, 3))), 8, 8)[4, 4, 0] for x in (-0.6, 0.6)
    )
    assert left > 0.25
    assert right < 0.03


def test_a_flat_normal_map_changes_nothing(tmp_path):
    (tmp_path / "flat").mkdir()
    bumpy_quad(tmp_path, (128, 128, 255))
    quad(tmp_path / "flat", "quad.glb", Image.new("RGB", (4, 4), (255, 255, 255)))
    scenes = [scene_of(folder, '[[mesh]]\nfile = "quad.glb"', CAMERA) for folder in (tmp_path, tmp_path / "flat")]
    one, other = (drawn(scene, sky(50), 16, 16) for scene in scenes)
    assert np.abs(one - other).max() < 0.01  # 128 is half a step off the middle: 0.2 degrees


def test_vertex_colours_are_linear_in_gltf_and_coded_elsewhere(tmp_path):
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    faces, colours = [[0, 1, 2], [0, 2, 3]], np.array([[255, 128, 0, 255]] * 4, np.uint8)
    trimesh.Trimesh(corners, faces, vertex_colors=colours, process=False).export(tmp_path / "quad.ply")
    trimesh.Trimesh(corners, faces, vertex_colors=colours, process=False).export(tmp_path / "quad.glb")
    light = LightSet.of(np.zeros(1), np.array([[0.0, 0.0, 1.0]]), np.full((1, 3), np.pi))
    for name, green in (("quad.ply", 0.2159), ("quad.glb", 128 / 255)):
        text = f'[[mesh]]\nfile = "{name}"\ny_up = false\n'
        assert drawn(scene_of(tmp_path, text, ABOVE), light, 4, 4)[2, 2, :3] == pytest.approx([1, green, 0], abs=2e-3)
        overruled = scene_of(tmp_path, text + "material = {diffuse = [0.5, 0.5, 0.5]}", ABOVE)
        assert drawn(overruled, light, 4, 4)[2, 2, :3] == pytest.approx([0.5, 0.5, 0.5], abs=2e-3)


def test_vertex_colours_multiply_the_material_and_its_image(tmp_path):
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    material = PBRMaterial(baseColorTexture=Image.new("RGB", (4, 4), (255, 188, 255)), metallicFactor=1.0, roughnessFactor=1.0)
    visual = TextureVisuals(uv=uv, material=material)
    visual.vertex_attributes["color"] = np.array([[128, 128, 255, 255]] * 4, np.uint8)
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=visual, process=False).export(tmp_path / "quad.glb")
    scene = scene_of(tmp_path, '[[mesh]]\nfile = "quad.glb"\ny_up = false', ABOVE)
    red, green, blue = drawn(scene, sky(200), 4, 4)[2, 2, :3]
    assert red / blue == pytest.approx(0.5, abs=0.03)  # Fresnel adds some white at grazing angles
    assert green / red == pytest.approx(0.503, abs=0.03)
