import numpy as np
import pytest

from tests.support.rendering import SceneRenderer
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.gl.buffers import LIGHT_FRAME
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

STANDING = """
[camera]
from = [2.0, -4.0, 2.5]
at = [0.0, 0.0, 0.4]
[[mesh]]
shape = "plane"
scale = {half}
[[mesh]]
shape = "box"
scale = 0.4
rotate = [0.0, 0.0, 30.0]
at = [-0.6, 0.0, 0.4]
[[mesh]]
shape = "sphere"
scale = 0.5
at = [0.6, 0.0, 0.5]
"""


def renderer_on_a_floor(folder, half: float, shadow_map: int | None = 128) -> SceneRenderer:
    (folder / "scene.toml").write_text(STANDING.format(half=half))
    return SceneRenderer(load_scene(folder / "scene.toml"), Settings(width=64, height=48, shadow_map=shadow_map))


def sky(count: int) -> np.ndarray:
    """Directions spread evenly over the upper hemisphere but for its lowest fifth."""
    k = np.arange(count) + 0.5
    return direction_from_angles(np.arccos(1 - 0.8 * k / count), k * 2.4)


def lights_from(directions: np.ndarray) -> LightSet:
    return LightSet.of(np.arange(len(directions)), directions, np.full((len(directions), 3), 1 / len(directions)))


@pytest.mark.parametrize("half", [6.0, 60.0])
@pytest.mark.parametrize(("shadow_map", "count"), [(128, 24), (None, 24), (None, 72)])
def test_no_light_comes_through_a_floor_however_large(tmp_path, half, shadow_map, count):
    renderer = renderer_on_a_floor(tmp_path, half, shadow_map)
    above = float(renderer.picture(lights_from(sky(count)))[..., :3].mean())
    below = float(renderer.picture(lights_from(sky(count) * [1, 1, -1]))[..., :3].mean())
    renderer.release()
    assert below < 1e-3 * above  # a tenth of a texel at the feet of what stands there; 3e-4 measured with 128 texels


def test_the_floors_shadow_stays_in_its_lights_map(tmp_path):
    renderer = renderer_on_a_floor(tmp_path, 60.0)
    above = sky(9)
    alone = renderer.picture(lights_from(above)).copy()
    mixed = renderer.picture(lights_from(np.concatenate([above, above * [1, 1, -1]])))
    renderer.release()
    assert alone[..., :3].max() > 0.05
    # maps lie in other tiles, so edges of their triangles may round to the other texel
    assert np.mean(np.abs(2 * mixed - alone)[..., :3].max(axis=-1) > 1e-4) < 0.005


WALL = """
[camera]
from = [0.0, 0.3, 6.0]
at = [0.0, 0.3, 0.0]
fov_y = 5.0
[[mesh]]
shape = "plane"
material = {diffuse = [1.0, 1.0, 1.0]}
[[mesh]]
shape = "plane"
rotate = [90.0, 0.0, 0.0]
at = [0.0, 0.3, 0.0]
"""


def frames_of(renderer: SceneRenderer) -> np.ndarray:
    """The light frames of the last picture, LIGHT_FRAME."""
    with renderer.renderer._context:
        return np.frombuffer(renderer.renderer._frames._frames.read(), LIGHT_FRAME.dtype)


def test_the_bias_is_a_texels_width(tmp_path):
    # By less, surfaces shadow themselves: casters are simplified by up to a texel. By more, shadows part from what casts them.
    renderer = renderer_on_a_floor(tmp_path, 6.0)
    renderer.picture(lights_from(sky(5)))
    frames = frames_of(renderer)[:5]
    renderer.release()
    texels_a_metre, depth_a_metre = (np.linalg.norm(frames[name][:, :3], axis=1) for name in ("column", "depth"))
    np.testing.assert_allclose(frames["bias"] / depth_a_metre * texels_a_metre, 1, rtol=1e-5)


def test_under_grazing_light_shadows_part_from_their_casters_by_three_texels(tmp_path):
    # A thin wall through the ground, the light from +y: behind it the ground counts as lit as far as the bias lifts it along the light.
    # A row of the map is 1 / cosine texels of the ground: lights of many heights average over where the wall lies in its row.
    (tmp_path / "scene.toml").write_text(WALL)
    renderer = SceneRenderer(load_scene(tmp_path / "scene.toml"), Settings(width=8, height=512, shadow_map=256))
    pixel_m, gaps = 2 * 6 * np.tan(np.radians(2.5)) / 512, []
    for cosine in np.linspace(0.08, 0.16, 32):
        image = renderer.picture(lights_from(np.array([[0.0, np.sqrt(1 - cosine**2), cosine]])))[..., 0].mean(axis=1)
        texel_m = 1 / np.linalg.norm(frames_of(renderer)[0]["column"][:3])
        gaps.append((image.sum() / image[0] - 256) * pixel_m / texel_m)  # rows 0 to 255 lie towards +y
    renderer.release()
    assert np.mean(gaps) == pytest.approx(3, abs=1)  # 1 / cosine without a limit: 10


@pytest.mark.parametrize("cosine", [0.05, 0.1, 0.2, 0.6])
def test_a_plane_does_not_shadow_itself_under_grazing_light(tmp_path, cosine):
    camera = "[camera]\nfrom = [0.0, 0.0, 6.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 15.0\n"
    (tmp_path / "scene.toml").write_text(camera + '[[mesh]]\nshape = "plane"\nmaterial = {diffuse = [1.0, 1.0, 1.0]}\n')
    renderer = SceneRenderer(load_scene(tmp_path / "scene.toml"), Settings(width=64, height=64, shadow_map=64))
    direction = np.array([[0.6 * np.sqrt(1 - cosine**2), 0.8 * np.sqrt(1 - cosine**2), cosine]])
    image = renderer.picture(lights_from(direction))[..., 0]
    renderer.release()
    assert np.allclose(image, cosine / np.pi, rtol=1e-3)


def test_the_rim_of_a_map_stays_empty_and_the_ground_beyond_is_lit(tmp_path):
    """A light from straight above a cube: its map holds the cube's top up to the rim, which the ground beyond looks up."""
    text = """
[camera]
from = [0.0, 0.0, 40.0]
at = [0.0, 0.0, 0.0]
fov_y = 8.0
[[mesh]]
shape = "plane"
scale = 6.0
[[mesh]]
shape = "box"
scale = 0.4
at = [0.0, 0.0, 0.4]
"""
    (tmp_path / "scene.toml").write_text(text)
    renderer = SceneRenderer(load_scene(tmp_path / "scene.toml"), Settings(width=64, height=64, shadow_map=64))
    picture = renderer.picture(lights_from(np.array([[0.0, 0.0, 1.0]])))[..., 0]
    with renderer.renderer._context:
        assert renderer.renderer._atlas is not None
        atlas = renderer.renderer._atlas.texture
        assert atlas is not None
        depth = np.frombuffer(atlas.read(alignment=1), np.float32).reshape(atlas.height, atlas.width)[:64, :64]
    renderer.release()
    for axis in (0, 1):  # a lookup reads 2 x 2 texels, and one ring more is for rounding
        filled = np.flatnonzero((depth < 1).any(axis=axis))
        assert (filled[0], filled[-1]) == (2, 61)
    assert picture.min() > 0.99 * picture[0, 0] > 0
