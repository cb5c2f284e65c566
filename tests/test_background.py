from pathlib import Path

import numpy as np
import pytest

from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage, cell_directions, cell_from_direction
from vemlight.renderer.scene.scene import ViewCamera, load_scene
from vemlight.renderer.scene.view import clip_from_world, ray_from_pixel
from vemlight.settings import Renderer as Settings

CAMERA = "[camera]\nfrom = [1.0, -6.0, 1.0]\nat = [0.0, 0.0, 1.5]\nfov_y = 60.0\n"
BALL = '[[mesh]]\nshape = "sphere"\nscale = 0.5\nat = [0.0, 0.0, 1.0]\n'
CATCHER = '[[mesh]]\nshape = "plane"\nscale = 3.0\nmaterial = {catcher = true}\n'
SIZE = (80, 60)
NONE = LightSet.none()


def a_renderer(folder: Path, text: str = BALL, camera: str = CAMERA, samples: int = 1) -> SceneRenderer:
    (folder / "scene.toml").write_text(camera + text)
    return SceneRenderer(load_scene(folder / "scene.toml"), Settings(width=SIZE[0], height=SIZE[1], shadow_map=64), samples)


def rays(camera: ViewCamera) -> np.ndarray:
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    seen = np.stack([x, y, np.ones_like(x)], axis=-1) @ ray_from_pixel(camera, SIZE).T
    return seen / np.linalg.norm(seen, axis=-1, keepdims=True)


def looked_up(radiance: np.ndarray, directions: np.ndarray, coverage: Coverage) -> np.ndarray:
    """Bilinear between the cells' centres, the first and last ring going on to the map's ends."""
    rows, cols, _ = radiance.shape
    i, j = cell_from_direction(directions, rows, cols, coverage)
    i, j = np.clip(i - 0.5, 0, rows - 1), j - 0.5
    row, col = np.floor(i).astype(int), np.floor(j).astype(int)
    f, g = (i - row)[..., None], (j - col)[..., None]
    low, high = np.minimum(row + 1, rows - 1), (col + 1) % cols
    col = col % cols
    return (radiance[row, col] * (1 - g) + radiance[row, high] * g) * (1 - f) + (radiance[low, col] * (1 - g) + radiance[low, high] * g) * f


def test_a_ray_and_the_projection_agree():
    scene = load_scene(SHAPES)
    directions = rays(scene.camera)
    for row, col in ((0, 0), (30, 12), (59, 79)):
        point = np.array(scene.camera.position) + 3 * directions[row, col]
        clip = clip_from_world(scene, SIZE) @ [*point, 1]
        assert (clip[:2] / clip[3] + 1) / 2 * SIZE == pytest.approx([col + 0.5, row + 0.5], abs=1e-6)


@pytest.mark.parametrize("coverage", ["hemisphere", "sphere"])
@pytest.mark.parametrize("at", ["[0.0, 0.0, 1.5]", "[1.0, -6.0, 8.0]", "[-7.0, -6.1, 2.0]"])  # aside, up, over phi = 180 degrees
def test_the_background_is_the_map_along_each_ray(tmp_path, coverage, at):
    camera = CAMERA.replace("[0.0, 0.0, 1.5]", at)
    radiance = np.random.default_rng(1).uniform(0, 3, (18, 72, 3)).astype(np.float32)
    renderer = a_renderer(tmp_path, camera=camera)
    renderer.background = EnvironmentMap(radiance, coverage)
    picture = renderer.picture(NONE).copy()
    renderer.release()
    clear = a_renderer(tmp_path, camera=camera)
    there = clear.picture(NONE)[..., 3] > 0
    clear.release()
    directions = rays(load_scene(tmp_path / "scene.toml").camera)
    inside = ~there & (np.ones_like(there) if coverage == "sphere" else directions[..., 2] > 1e-4)
    # GL may filter with 8 bits between two cells: 3 / 256; llvmpipe's atan is good to 1e-3 of a cell
    assert np.abs(picture[inside][:, :3] - looked_up(radiance, directions, coverage)[inside]).max() < 3 / 128
    assert np.all(picture[inside][:, 3] == 1)
    below = ~there & (directions[..., 2] < -1e-4)
    if coverage == "hemisphere":
        assert not picture[below].any()
    assert not picture[there][:, :3].any()


def test_one_lit_cell_is_seen_in_its_direction(tmp_path):
    radiance = np.zeros((90, 360, 3), np.float32)
    radiance[80, 100] = 1.0  # 9.5 degrees high, azimuth 100.5
    direction = cell_directions(90, 360, "hemisphere")[80, 100]
    renderer = a_renderer(tmp_path)
    renderer.background = EnvironmentMap(radiance, "hemisphere")
    picture = renderer.picture(NONE)
    row, col = np.unravel_index(np.argmax(picture[..., 0]), SIZE[::-1])
    seen = rays(load_scene(tmp_path / "scene.toml").camera)[row, col]
    assert np.degrees(np.arccos(seen @ direction)) < 1  # a pixel is a degree wide here
    renderer.release()


def test_surfaces_hide_the_background_by_their_alpha(tmp_path):
    renderer = a_renderer(tmp_path, samples=16)
    lights = LightSet.of(np.arange(1), np.array([[0.0, -0.6, 0.8]]), np.ones((1, 3)))
    alone = renderer.picture(lights).copy()
    renderer.background = EnvironmentMap(np.full((4, 8, 3), 0.7, np.float32), "sphere")
    over = renderer.picture(lights)
    assert np.allclose(over[..., :3], alone[..., :3] + 0.7 * (1 - alone[..., 3:]), atol=1e-5)
    assert np.all(over[..., 3] == 1)
    renderer.release()


def test_catchers_dim_the_background(tmp_path):
    renderer = a_renderer(tmp_path, BALL + CATCHER)
    lights = LightSet.of(np.arange(1), np.array([[0.0, 0.6, 0.8]]), np.array([[1.0, 0.5, 0.25]]))
    alone = renderer.picture(lights).copy()
    renderer.background = EnvironmentMap(np.full((4, 8, 3), 0.7, np.float32), "sphere")
    over = renderer.picture(lights)
    shadow = (alone[..., 3] == 1) & ~alone[..., :3].any(axis=-1)
    assert shadow.any()
    assert np.abs(over[shadow][:, :3]).max() < 1e-5
    assert np.all(over[..., 3] == 1)
    renderer.release()


def test_nan_infinite_and_negative_cells_leave_finite_pictures(tmp_path):
    radiance = np.ones((8, 16, 3), np.float32)
    radiance[2], radiance[3], radiance[4] = np.nan, np.inf, -1
    renderer = a_renderer(tmp_path)
    renderer.background = EnvironmentMap(radiance, "hemisphere")
    picture = renderer.picture(NONE)
    assert np.all(np.isfinite(picture))
    assert picture.min() >= 0
    renderer.release()


def test_a_map_of_another_size_replaces_it(tmp_path):
    renderer = a_renderer(tmp_path)
    for value, shape in ((0.2, (4, 8, 3)), (0.4, (90, 360, 3)), (0.6, (90, 360, 3))):
        renderer.background = EnvironmentMap(np.full(shape, value, np.float32), "sphere")
        assert renderer.picture(NONE)[0, 0] == pytest.approx([value, value, value, 1])
    renderer.release()
