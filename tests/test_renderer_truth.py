"""Pictures against exact ray casting."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.ray_casting import first_hits, near_edges, scene_tree, unshadowed, visible
from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

CONTACT = """
[camera]
from = [2.0, -4.0, 2.5]
at = [0.0, 0.0, 0.4]
[[mesh]]
shape = "plane"
scale = 3.0
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


def scene_of(name: str, folder: Path):
    if name == "demo":
        return load_scene(SHAPES)
    (folder / "scene.toml").write_text(CONTACT)
    return load_scene(folder / "scene.toml")


@pytest.mark.parametrize("name", ["demo", "contact"])
@pytest.mark.parametrize("shadow_map", [128, 256, None])
def test_shadows_agree_with_rays_but_for_their_edges(tmp_path, name, shadow_map):
    scene, width, height = scene_of(name, tmp_path), 128, 96
    tree = scene_tree(scene)
    hits = first_hits(scene, tree, width, height)
    renderer = SceneRenderer(scene, Settings(width=width, height=height, shadow_map=shadow_map, shadows="maps"))
    error = power = lost = 0.0
    for theta, phi in [(0.2, 1.0), (0.7, 4.0), (0.9, 2.2), (1.2, 5.0), (1.45, 0.3)]:
        direction = direction_from_angles(theta, phi)
        seen = visible(tree, hits, direction, float(np.linalg.norm(scene.half)))
        truth = unshadowed(scene, hits, direction, np.ones(3)) * seen[..., None]
        drawn = renderer.picture(LightSet.of(np.zeros(1), direction[None], np.ones((1, 3))))[..., :3]
        away = ~(near_edges(seen, 2) | near_edges(hits.triangle >= 0, 1))
        error += float(((drawn - truth)[away] ** 2).sum())
        power += float((truth[away] ** 2).sum())
        lost += float((truth[away] > 0.05)[drawn[away] < 0.02].sum())
    renderer.release()
    assert power > 0
    assert np.sqrt(error / power) <= 0.02  # 0.006 to 0.012 measured
    assert lost <= 5 * away.sum() * 1e-3  # no acne: at most one pixel in a thousand is dark that rays see lit


def test_a_skys_small_maps_agree_with_rays_over_the_whole_picture(tmp_path):
    scene, width, height, count = load_scene(SHAPES), 96, 72, 72
    tree = scene_tree(scene)
    hits = first_hits(scene, tree, width, height)
    k = np.arange(count) + 0.5
    directions = direction_from_angles(np.arccos(1 - 0.95 * k / count), k * 2.4)
    truth = np.zeros((height, width, 3))
    for direction in directions:
        seen = visible(tree, hits, direction, float(np.linalg.norm(scene.half)))
        truth += unshadowed(scene, hits, direction, np.full(3, 1 / count)) * seen[..., None]
    renderer = SceneRenderer(scene, Settings(width=width, height=height, shadows="maps"))
    drawn = renderer.picture(LightSet.of(np.arange(count), directions, np.full((count, 3), 1 / count)))[..., :3]
    assert set(renderer.plan.resolutions) == {64}
    renderer.release()
    inside = ~near_edges(hits.triangle >= 0, 1)
    off = np.sqrt(np.sum((drawn - truth)[inside] ** 2) / np.sum(truth[inside] ** 2))
    assert off <= 0.02  # 0.012 measured, edges and all
    # Where things stand on the ground as much light is lost as rays lose: no bright rim under them, nor a dark one.
    assert abs(drawn[inside].mean() / truth[inside].mean() - 1) < 0.005


def test_the_ray_caster_sees_a_sphere_where_it_is(tmp_path):
    camera = "[camera]\nfrom = [0.0, 0.0, 5.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 40.0\n"
    (tmp_path / "scene.toml").write_text(camera + '[[mesh]]\nshape = "sphere"\n')
    scene = load_scene(tmp_path / "scene.toml")
    hits = first_hits(scene, scene_tree(scene), 65, 65)
    assert hits.triangle[32, 32] >= 0
    assert np.abs(hits.position[32, 32] - [0, 0, 1]).max() < 1e-9
    # a sphere of radius 1 at distance 5 fills asin(1 / 5) of the half angle 20 degrees
    share = (np.tan(np.arcsin(0.2)) / np.tan(np.radians(20))) ** 2 * np.pi / 4
    assert np.mean(hits.triangle >= 0) == pytest.approx(share, rel=0.03)
