import numpy as np
import pytest

from tests.support.rendering import SceneRenderer
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
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
