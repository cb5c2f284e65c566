import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.light.light_set import LightSet
from vemlight.renderer.passes.lights.light_regions import CUBE_SIDE, light_regions, region_rows
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings


def unit_vectors(count: int, seed: int) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return (v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)


def region_of(regions, normals: np.ndarray) -> np.ndarray:
    """Cube map lookup as OpenGL 4.3, section 8.13, says: the face of the largest coordinate."""
    axis = np.argmax(np.abs(normals), axis=1)
    major = normals[np.arange(len(normals)), axis]
    x, y, z = normals.T
    face = 2 * axis + (major < 0)
    s = np.choose(face, [-z, z, x, x, x, -x]) / np.abs(major)
    t = np.choose(face, [-y, -y, z, -z, -y, -y]) / np.abs(major)
    column, row = (np.clip(((v + 1) / 2 * CUBE_SIDE).astype(int), 0, CUBE_SIDE - 1) for v in (s, t))
    return regions.cube[face, row, column]


@pytest.mark.parametrize("count", [0, 1, 2, 6, 24, 100, 256])
def test_no_light_that_a_normal_sees_is_left_out(count):
    regions = light_regions(count)
    normals, lights = unit_vectors(4000, 1), unit_vectors(200, 2)
    member = np.zeros((max(count, 1), 200), bool)
    for region, row in enumerate(region_rows(regions, lights)):
        member[region, row] = True
    assert not np.any((normals @ lights.T > 0) & ~member[region_of(regions, normals)])


@given(st.integers(1, 256), st.integers(0, 40))
def test_rows_keep_the_order_so_that_prefixes_stay_prefixes(count, first):
    lights = unit_vectors(60, 3)
    regions = light_regions(count)
    for row, prefix in zip(region_rows(regions, lights), region_rows(regions, lights[:first]), strict=True):
        assert np.all(np.diff(row) > 0)
        assert np.array_equal(row[row < first], prefix)


def test_regions_leave_lights_out():
    lights = unit_vectors(1000, 4)
    share = [np.mean([len(row) for row in region_rows(light_regions(count), lights)]) / 1000 for count in (1, 24, 256)]
    assert share[0] == 1
    # a cap of angle r sees (1 + sin r) / 2 of the sphere: r is near 30 degrees for 24 caps and 10 for 256
    assert share[1] < 0.8
    assert share[2] < 0.65


@pytest.mark.parametrize("count", [1, 24, 100])
def test_the_picture_with_regions_is_the_picture_without(count):
    scene = load_scene(SHAPES)
    lights = LightSet.of(np.arange(60), unit_vectors(60, 5), np.random.default_rng(6).uniform(0, 0.2, (60, 3)))
    pictures = []
    for regions in (0, count):
        renderer = SceneRenderer(scene, Settings(width=96, height=72, shadow_map=64, light_regions=regions), samples=2)
        pictures.append(renderer.picture(lights).copy())
        renderer.release()
    assert np.array_equal(pictures[0][..., 3], pictures[1][..., 3])
    assert np.allclose(*pictures, rtol=1e-5, atol=1e-6)  # lights left out would have added exact zeros
