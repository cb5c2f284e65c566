"""What polished surfaces show of the scene: closed forms, which pixels have rays of their own, and what costs nothing."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.light_sets import lights_from, uniform_lights
from tests.support.rendering import SceneRenderer
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer import pass_table
from vemlight.renderer.passes.mirrors import mirrors
from vemlight.renderer.rays.bounce import MIRROR_EXPONENT
from vemlight.renderer.rays.mirror import polished_of, ray_pattern
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

SIDE = 48
WHITE = EnvironmentMap(np.ones((90, 180, 3), np.float32), "sphere")
CHROME = "{base_color = [1.0, 1.0, 1.0], metallic = 1.0, roughness = 0.05}"
PHONG = "{{diffuse = [0.0, 0.0, 0.0], specular = [1.0, 1.0, 1.0], exponent = {}}}"
# From so far away that all rays are parallel, and a ball of radius 1 fills 0.91 of the picture's half.
CAMERA = "[camera]\nfrom = [0.0, -60.0, 0.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 2.1\n"
BALL = '[[mesh]]\nname = "ball"\nshape = "sphere"\nmaterial = {}\n'
GROUND = '[[mesh]]\nname = "ground"\nshape = "plane"\nscale = 4000.0\nat = [0.0, 0.0, -1.0]\nmaterial = {{diffuse = [{0}, {0}, {0}]}}\n'


def even_lights(count: int) -> LightSet:
    """Radiance 1 from all sides."""
    z = 1 - 2 * (np.arange(count) + 0.5) / count
    directions = direction_from_angles(np.arccos(z), np.arange(count) * np.pi * (3 - np.sqrt(5)))
    return LightSet.of(np.arange(count), directions, np.full((count, 3), 4 * np.pi / count))


def renderer_of(folder: Path, text: str, **wanted) -> SceneRenderer:
    (folder / "scene.toml").write_text(CAMERA + text)
    settings = {"width": SIDE, "height": SIDE, "shadows": "rays", "bounces": 1, "frame_ms": 0.0, **wanted}
    return SceneRenderer(load_scene(folder / "scene.toml"), Settings(**settings), 1 if settings["frame_ms"] else 4)


def picture(folder: Path, text: str, lights: LightSet, environment: EnvironmentMap | None, **wanted) -> np.ndarray:
    renderer = renderer_of(folder, text, **wanted)
    made = renderer.picture(lights, environment)[..., :3].astype(np.float64)
    renderer.release()
    return made


def test_a_mirror_ball_over_a_black_plane_shows_the_map_above_the_horizon_alone(tmp_path):
    made = picture(tmp_path, BALL.format(CHROME) + GROUND.format(0.0), even_lights(300), WHITE)[..., 1]
    y, x = (np.indices((SIDE, SIDE)) - (SIDE - 1) / 2) / (SIDE / 2) * 60 * np.tan(np.radians(1.05))
    height, square = -y, x * x + y * y
    # The view is along +y: with the normal n it is mirrored to d - 2 (d.n) n, whose height is 2 sqrt(1 - r^2) n_z.
    up = 2 * np.sqrt(np.maximum(1 - square, 0)) * height
    inner = square < 0.6
    np.testing.assert_allclose(made[inner & (up > 0.2)], 1, atol=0.02)
    np.testing.assert_allclose(made[inner & (up < -0.2)], 0, atol=0.02)
    assert (inner & (up > 0.2)).sum() > 200
    assert (inner & (up < -0.2)).sum() > 200


@pytest.mark.parametrize("material", [CHROME, PHONG.format(200), PHONG.format(16)])
@pytest.mark.parametrize("frame_ms", [0.0, 1e5])
def test_a_furnace_of_map_and_white_ground_is_white(tmp_path, material, frame_ms):
    """The ground is lit from above alone: radiance 1 again, but in the ball's shadow, far below its middle."""
    alone = picture(tmp_path, BALL.format(material), even_lights(300), WHITE, frame_ms=frame_ms)[..., 1]
    ground = GROUND.format(1.0).replace("-1.0", "-60.0")
    both = picture(tmp_path, BALL.format(material) + ground, even_lights(300), WHITE, frame_ms=frame_ms)[..., 1]
    inner = np.hypot(*(np.indices((SIDE, SIDE)) - (SIDE - 1) / 2)) < 0.6 * SIDE / 2
    assert both[inner].mean() == pytest.approx(alone[inner].mean(), rel=0.015)
    # Where the horizon lies in a wide lobe, few rays say how much of it: noise of single pixels.
    np.testing.assert_allclose(both[inner], alone[inner], rtol=0.2 if "16" in material else 0.06)


def test_a_reflection_keeps_its_edge(tmp_path):
    """Under a sun a mirror shows the lit ground as bright as it is, and nothing of it a degree above the horizon."""
    sun = lights_from(np.array([0.0, 0.0, 1.0]))
    made = picture(tmp_path, BALL.format(CHROME) + GROUND.format(0.6).replace("-1.0", "-60.0"), sun, None)
    column, ground = made[:, SIDE // 2, 1], 0.6 / np.pi * sun.irradiance[0, 1]
    assert column[SIDE // 2 + 4] == pytest.approx(ground, rel=0.03)
    assert column[SIDE // 2 - 4] < 0.02 * ground


@pytest.mark.parametrize("material", [CHROME, PHONG.format(2000)])
def test_a_small_thing_is_seen_where_its_direction_is_mirrored(tmp_path, material):
    """A wall at the side, 11 degrees wide, lies in the mirrored view of the normal between it and the eye: at 45 degrees on the ball."""
    wall = '[[mesh]]\nshape = "plane"\nscale = 6\nrotate = [0.0, 90.0, 0.0]\nat = [60.0, 0.0, 0.0]\nmaterial = {diffuse = [0.8, 0.8, 0.8]}'
    light = np.array([-1.0, 0.0, 0.5]) / np.sqrt(1.25)
    made = picture(tmp_path, BALL.format(material) + wall, lights_from(light), None)[..., 1]
    x = (np.arange(SIDE) - (SIDE - 1) / 2) / (SIDE / 2) * 60 * np.tan(np.radians(1.05))
    row, aside = made[SIDE // 2 - 1 : SIDE // 2 + 1].mean(axis=0), np.abs(np.degrees(np.arcsin(np.clip(x, -1, 1))) - 45)
    lit = 0.8 / np.pi / np.sqrt(1.25)
    assert row[aside < 1].min() > 0.6 * lit  # at the ball's slope a pixel has 4 degrees of normals there
    assert row[(aside > 8) & (x > 0) & (x < 0.95)].max() < 0.02 * lit


def test_the_share_of_the_gather_fades_with_the_variance_of_the_lobe(tmp_path):
    shader = (Path(mirrors.__file__).parent / "scene_rays.glsl").read_text()
    gathered = float(shader.partition("GATHERED_VARIANCE = ")[2].partition(";")[0])
    assert gathered == pytest.approx(1 / (MIRROR_EXPONENT + 2))
    own = {}
    for exponent in (4, 8, 12, 20, 200):
        renderer = renderer_of(tmp_path, BALL.format(PHONG.format(exponent)) + GROUND.format(0.5))
        renderer.picture(uniform_lights(8, 0.0))
        part = renderer.renderer._interreflection._mirrors
        assert part
        own[exponent] = len(part._mirror._polished.numbers)
        renderer.release()
    assert own[4] == own[8] == 0 < own[12] == own[20] == own[200]


def test_rays_of_sixteen_pixels_are_spread_evenly_and_so_are_those_of_one():
    shared, own = ray_pattern(0, 1)[:, 0], ray_pattern(0, 16)[5]
    assert sorted((16 * shared[:, 0]).astype(int)) == list(range(16))
    for points in (shared, own):
        for axis in (0, 1):
            assert np.all(np.bincount((4 * points[:, axis]).astype(int), minlength=4) >= 3)
    np.testing.assert_array_equal(ray_pattern(4, 4), ray_pattern(0, 8)[:, 4:])  # samples go on in the sequence


def test_pixels_are_polished_where_they_have_a_lobe():
    lobes = np.zeros((3, 4), np.float32)
    lobes[1, 2], lobes[2, 0] = 0.01, -50.0
    polished = polished_of(lobes)
    assert polished.numbers.tolist() == [6, 8]
    np.testing.assert_allclose(polished.lobes, [0.01, -50.0])


def test_live_rays_are_kept_while_the_light_changes(tmp_path, monkeypatch):
    renderer = renderer_of(tmp_path, BALL.format(CHROME) + GROUND.format(0.5), frame_ms=1e5)
    part = renderer.renderer._interreflection._mirrors
    assert part
    seen: list[int] = []
    lit: list[int] = []
    see, light = part._mirror.see, part._mirror.lit
    monkeypatch.setattr(part._mirror, "see", lambda *of: (seen.append(1), see(*of)))
    monkeypatch.setattr(part._mirror, "lit", lambda *of: (lit.append(1), light(*of))[1])
    pictures = [renderer.picture(uniform_lights(n, 0.0)) for n in (8, 9, 8)]
    renderer.release()
    assert (len(seen), len(lit)) == (1, 3)
    assert not np.array_equal(pictures[0], pictures[1])


@pytest.mark.parametrize(("material", "wanted", "has"), [
    (CHROME, {}, True), (CHROME, {"bounces": 0}, False), (CHROME, {"shadows": "maps"}, False), ("{diffuse = [0.5, 0.5, 0.5]}", {}, False),
])  # fmt: skip
def test_frames_follow_mirrored_rays_where_a_bounce_is_drawn_on_gloss(tmp_path, material, wanted, has):
    renderer = renderer_of(tmp_path, BALL.format(material), **wanted)
    renderer.picture(uniform_lights(8, 0.0))
    assert renderer.plan.runs(pass_table.MIRRORS) == has
    renderer.release()
