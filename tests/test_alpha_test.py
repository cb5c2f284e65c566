"""Alpha-tested surfaces: what is seen through them, and what light falls through them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.gltf_files import TexturedSquare
from tests.support.rendering import SceneRenderer
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.accumulation import MapLights
from vemlight.renderer.scene.materials import alpha_test_of
from vemlight.renderer.scene.mesh_files import read_meshes
from vemlight.renderer.scene.scene import load_scene
from vemlight.renderer.scene.textures import alpha_bled
from vemlight.renderer.stage import file_samples
from vemlight.runtime.poses import Pose
from vemlight.settings import Renderer as Settings

ABOVE = "[camera]\nfrom = [0.0, 0.0, 10.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 11.0\n"  # sees x, y from -0.963 to 0.963
GROUND = '[[mesh]]\nshape = "plane"\nscale = 4.0\nat = [0.0, 0.0, -0.5]\nmaterial = {diffuse = [1.0, 1.0, 1.0]}\n'
DARK = LightSet.none()
SUN = LightSet.of(np.zeros(1), np.array([[0.0, 0.0, 1.0]]), np.full((1, 3), np.pi))


def board(size: int, alpha: float = 1.0, low: int = 0) -> np.ndarray:
    """White and, as its alpha, a chessboard of `size` x `size` texels: `low` where it has holes."""
    pixels = np.full((size, size, 4), 255, np.uint8)
    pixels[..., 3] = np.where(np.indices((size, size)).sum(axis=0) % 2, low, round(255 * alpha))
    return pixels


def sheet_of(mode: str, alpha: float = 1.0, image: np.ndarray | None = None, cutoff: float | None = None) -> TexturedSquare:
    """A white square that emits 1, and reflects nothing, over the ground."""
    base: dict[str, Any] = {"baseColorFactor": [1.0, 1.0, 1.0, alpha]}
    sheet = TexturedSquare(extensions={"KHR_materials_unlit": {}}, pbrMetallicRoughness=base, alphaMode=mode)
    if cutoff is not None:
        sheet.material["alphaCutoff"] = cutoff
    if image is not None:
        base["baseColorTexture"] = sheet.image(image)
    return sheet


def renderer_of(
    folder: Path, sheet: TexturedSquare, camera: str = ABOVE, more: str = "", samples: int = 1, side: int = 16, shadow_map: int = 256
) -> SceneRenderer:
    sheet.write(folder / "sheet.gltf")
    (folder / "scene.toml").write_text(camera + GROUND + '[[mesh]]\nname = "sheet"\nfile = "sheet.gltf"\ny_up = false\n' + more)
    return SceneRenderer(load_scene(folder / "scene.toml"), Settings(width=side, height=side, shadow_map=shadow_map), samples)


def drawn(folder: Path, sheet: TexturedSquare, lights: LightSet = DARK, **options) -> np.ndarray:
    renderer = renderer_of(folder, sheet, **options)
    picture = renderer.picture(lights).copy()
    renderer.release()
    return picture


@pytest.mark.parametrize(
    ("factor", "vertex", "cutoff", "there"), [(1.0, 1.0, 0.6, True), (0.7, 1.0, 0.6, True), (0.7, 0.8, 0.6, False), (0.5, 1.0, None, True)]
)
def test_a_mask_is_there_where_its_alpha_is_no_less_than_the_cutoff(tmp_path, factor, vertex, cutoff, there):
    sheet = sheet_of("MASK", factor, cutoff=cutoff).attribute("COLOR_0", np.array([[1, 1, 1, vertex]] * 4, np.float32))
    assert np.all(drawn(tmp_path, sheet)[..., 0] == there)


def test_an_opaque_material_has_no_holes_whatever_its_image_says(tmp_path):
    sheet = sheet_of("OPAQUE", 0.0, board(2))
    assert np.all(drawn(tmp_path, sheet)[..., 0] == 1)


@pytest.mark.parametrize(("mode", "low", "cutoff"), [("BLEND", 255, None), ("MASK", 200, 0.5), ("MASK", 0, 0.0)])
def test_a_surface_that_is_there_all_over_has_no_holes(tmp_path, mode, low, cutoff):
    sheet = sheet_of(mode, 1.0, board(4, low=low), cutoff)
    material = read_meshes(sheet.write(tmp_path / "sheet.gltf"), "here").parts[0].material
    assert material is not None
    assert alpha_test_of(material) is None


def test_through_a_masks_holes_lies_what_is_behind_and_the_light_that_fell_through_them(tmp_path):
    # 2 x 2 texels over the square; the light comes straight from above, as the camera looks
    picture = drawn(tmp_path, sheet_of("MASK", 1.0, board(2)), SUN, side=16)[..., 0]
    assert np.allclose(picture[2:6, 2:6], 1)  # the sheet's emission
    assert np.allclose(picture[2:6, 10:14], 1, atol=1e-3)  # white ground under irradiance pi
    lit = drawn(tmp_path, sheet_of("MASK", 0.0, board(2)), SUN, side=16)[..., 0]
    assert np.allclose(lit, 1, atol=1e-3)


@pytest.mark.parametrize("mode", ["MASK", "BLEND"])
def test_colours_that_holes_hide_do_not_show(tmp_path, mode):
    pictures = []
    for hidden in (0, 255):
        image = board(16)
        image[image[..., 3] == 0, :3] = hidden
        sheet = sheet_of(mode)
        sheet.material["pbrMetallicRoughness"]["baseColorTexture"] = sheet.image(image, magFilter=9729, minFilter=9987)
        pictures.append(drawn(tmp_path, sheet, side=9))
    assert np.array_equal(*pictures)
    assert pictures[0][..., 0].max() == 1


def test_what_is_filled_in_is_the_colour_around():
    image = np.zeros((64, 48, 4), np.float16)
    image[:, :16], image[:, 32:] = (1, 0, 0, 1), (0, 0, 1, 1)
    filled = alpha_bled(image)
    assert np.array_equal(filled[:, :16], image[:, :16])
    assert np.array_equal(filled[..., 3], image[..., 3])
    assert np.all(filled[:, 16, 0] > filled[:, 16, 2])
    assert np.all(filled[:, 31, 0] < filled[:, 31, 2])
    assert filled[:, 16:32, :3].sum(axis=-1) == pytest.approx(1, abs=2e-3)  # half floats
    for same in (np.ones((4, 4, 4), np.float16), np.zeros((4, 4, 4), np.float16)):
        assert alpha_bled(same) is same


WIDE = "[camera]\nfrom = [0.0, 0.0, 10.0]\nat = [0.0, 0.0, -0.5]\nfov_y = 16.0\n"


@pytest.mark.parametrize(("mode", "size", "alpha"), [("MASK", 2, 1.0), ("MASK", 64, 1.0), ("BLEND", 1, 0.3), ("BLEND", 64, 0.8)])
def test_the_ground_gets_the_fraction_of_light_that_the_holes_have(tmp_path, mode, size, alpha):
    sheet = sheet_of(mode, 1.0, board(size, alpha))
    light = LightSet.of(np.zeros(1), np.array([[0.0, 0.6, 0.8]]), np.full((1, 3), np.pi))
    renderer = renderer_of(tmp_path, sheet, WIDE, side=64)
    shadow = renderer.picture(light).copy()[..., 0]
    renderer.release()
    shape = '[[mesh]]\nshape = "plane"\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'
    (tmp_path / "scene.toml").write_text(WIDE + GROUND + shape)
    renderer = SceneRenderer(load_scene(tmp_path / "scene.toml"), Settings(width=64, height=64, shadow_map=256))
    whole = renderer.picture(light).copy()[..., 0]
    renderer.release()
    # the shadow lies 0.375 m towards -y: rows below the sheet's edge, which is at y = -1, see it; 10.5 tan(8 deg) is 1.476 m
    rows = slice(55, 60)
    assert whole[rows, 20:44].max() == 0
    # the mean over a coverage of thresholds: 256 texels over 4 m, 20 x 6 of them in view, so up to 120 independent cells of 1 to 4 texels
    coverage = 1 - alpha if size == 1 else 1 - alpha / 2
    assert shadow[rows, 20:44].mean() == pytest.approx(0.8 * coverage, abs=0.06)


@pytest.mark.parametrize("alpha", [0.1, 0.25, 0.5, 0.8])
def test_blending_with_16_samples_is_the_mixture(tmp_path, alpha):
    picture = drawn(tmp_path, sheet_of("BLEND", alpha), samples=16, side=32)[..., 0]
    # black ground, white sheet: thresholds of one pixel are even to 1/16 where its samples lie in one cell
    assert picture.mean() == pytest.approx(alpha, abs=0.01)
    assert picture.std() < 0.1  # 16 random ones leave sqrt(alpha (1 - alpha) / 16), 0.125 at a half
    assert np.all(drawn(tmp_path, sheet_of("BLEND", alpha), samples=16, side=8)[..., 3] == 1)


def test_two_layers_let_through_what_either_leaves(tmp_path):
    sheet = sheet_of("BLEND", 0.5)
    again = '[[mesh]]\nfile = "sheet.gltf"\ny_up = false\nat = [0.0, 0.0, -0.25]\n'
    picture = drawn(tmp_path, sheet, samples=64, side=16, more=again)[..., 0]
    assert picture.mean() == pytest.approx(0.75, abs=0.02)
    assert picture.std() < 0.06  # layers with the same thresholds would leave 0.5 to 1 in one pixel


def test_the_pattern_of_one_sample_stays_and_moves_with_the_sheet(tmp_path):
    renderer = renderer_of(tmp_path, sheet_of("BLEND", 0.5), side=32)
    one = renderer.picture(DARK).copy()[..., 0]
    assert 0.4 < one.mean() < 0.6
    assert set(np.unique(one)) == {0, 1}
    renderer.picture(SUN)
    assert np.array_equal(renderer.picture(DARK)[..., 0], one)

    step_m = 4 * 2 * 10 * np.tan(np.radians(5.5)) / 32  # four pixels
    renderer.place(0.0, [Pose(name="sheet", position=(step_m, 0.0, 0.0), rotation=(0.0, 0.0, 0.0, 1.0), power=None)])
    moved = renderer.picture(DARK).copy()[..., 0]
    renderer.release()
    assert np.mean(moved[:, 5:] == one[:, 1:-4]) > 0.97


def test_a_lamp_shines_through_holes(tmp_path):
    lamp = '[[luminaire]]\nat = [0.0, 0.0, 4.0]\nrotate = [180.0, 0.0, 0.0]\nshadow_map = 256\n'
    pictures = []
    for cutoff in (0.0, 1.0, 0.5):
        renderer = renderer_of(tmp_path, sheet_of("MASK", 0.9, board(2), cutoff), WIDE, lamp, side=32)
        pictures.append(renderer.picture(DARK).copy()[..., 0])
        renderer.release()
    whole, none, half = pictures
    ring = np.ones((32, 32), bool)
    ring[5:27, 5:27] = False  # the ground beside the sheet
    assert whole[ring].mean() < 0.9 * half[ring].mean()
    assert half[ring].mean() < none[ring].mean() * 0.98


def test_a_near_light_passes_what_of_a_mask_is_nearer_than_its_radius(tmp_path):
    """A ball of .5 m, .2 m above the middle of the sheet: through a hole of .46 m it lights the ground to 1.6 m, far beyond the sheet."""
    image = np.full((8, 8, 4), 255, np.uint8)
    image[0, 0, 3] = 0  # a hole in a corner
    renderer = renderer_of(tmp_path, sheet_of("MASK", 0.9, image, 0.5), ABOVE.replace("11.0", "30.0"), side=64)
    row = np.abs((np.arange(64) + 0.5) / 32 - 1) * 10.5 * np.tan(np.radians(15.0))  # m from the middle, on the ground
    for radius, reach in ((0.5, 1.6), (0.1, 0.0)):
        renderer.near = NearLightSet.of(np.zeros(1), np.array([[0, 0, 0.2]]), np.full((1, 3), 5.0), np.full(1, radius), np.zeros(1))
        ground = renderer.picture(DARK)[32, :, 0]
        lit = ground > 0.05
        assert np.array_equal(lit[(row > 1.1) & (np.abs(row - reach) > 0.1)], (row < reach)[(row > 1.1) & (np.abs(row - reach) > 0.1)])
    renderer.release()


def test_a_scene_of_nothing_but_holes_is_drawn(tmp_path):
    sheet_of("BLEND", 0.5).write(tmp_path / "sheet.gltf")
    (tmp_path / "scene.toml").write_text(ABOVE + '[[mesh]]\nfile = "sheet.gltf"\ny_up = false\n')
    renderer = SceneRenderer(load_scene(tmp_path / "scene.toml"), Settings(width=8, height=8, shadow_map=64), 16)
    picture = renderer.picture(SUN).copy()
    renderer.release()
    assert picture[..., 3].mean() == pytest.approx(0.5, abs=0.03)
    assert np.allclose(picture[..., 0], picture[..., 3], atol=1e-6)


def test_files_of_a_scene_with_partial_coverage_have_more_samples(tmp_path):
    for mode, samples in (("BLEND", 16), ("MASK", 4), ("OPAQUE", 4)):
        sheet_of(mode, 0.5, board(2)).write(tmp_path / "sheet.gltf")
        (tmp_path / "scene.toml").write_text(ABOVE + '[[mesh]]\nfile = "sheet.gltf"\n')
        assert file_samples(load_scene(tmp_path / "scene.toml")) == samples


def test_the_passes_of_a_pause_go_to_the_mixture(tmp_path):
    renderer = renderer_of(tmp_path, sheet_of("BLEND", 0.4))
    light = MapLights(np.full((8, 16, 3), 1e-9, np.float32), "hemisphere")
    passes = [renderer.picture_of_pass(light, number)[..., 0].copy() for number in range(32)]
    renderer.release()
    mean = np.mean(passes, axis=0)
    assert mean.mean() == pytest.approx(0.4, abs=0.015)
    assert mean.std() < 0.095  # 32 random ones leave 0.087
    assert passes[0].std() == pytest.approx(0.49, abs=0.03)
