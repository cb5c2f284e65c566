import numpy as np
import pytest

pytest.importorskip("mitsuba", reason="Mitsuba is in the bench extra")

from bench.rivals import mitsuba_picture
from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.light.extent import Extents, received
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.scene.materials import Phong
from vemlight.renderer.scene.meshes import shape_geometry
from vemlight.renderer.scene.scene import Mesh, Scene, ViewCamera, load_scene
from vemlight.settings import Renderer as Settings

SIZE = (48, 36)


@pytest.fixture(scope="module", autouse=True)
def mitsuba():
    try:
        mitsuba_picture.start()
    except ImportError as error:
        pytest.skip(f"Mitsuba finds no LLVM: {error}")


def relative(picture: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean((picture - truth) ** 2) / np.mean(truth**2)))


def drawn(lights: LightSet, samples: int) -> np.ndarray:
    renderer = SceneRenderer(load_scene(SHAPES), Settings(width=SIZE[0], height=SIZE[1], shadow_map=512), samples)
    picture = renderer.picture(lights)[..., :3].copy()
    renderer.release()
    return picture


def test_traced_lights_are_ours_but_for_the_shadows_edges():
    k = np.arange(12) + 0.5
    lights = LightSet.of(np.arange(12), direction_from_angles(np.arccos(1 - 0.9 * k / 12), 2.4 * k), np.full((12, 3), 0.3))
    traced = mitsuba_picture.TracedLights(mitsuba_picture.mitsuba_scene(load_scene(SHAPES), SIZE, None), SIZE)
    assert relative(traced.picture(lights), drawn(lights, 1)) < 0.02  # 0.006 measured against rays at 320 x 240


@pytest.mark.parametrize(("row", "col"), [(3, 10), (9, 40), (12, 63)])
def test_a_map_with_one_lit_pixel_is_a_light_where_it_is(row, col):
    latlong = np.zeros((32, 64, 3), np.float32)
    latlong[row, col - 1] = [30.0, 20.0, 10.0]
    theta, phi = np.pi * (row + 0.5) / 32, np.pi - 2 * np.pi * (col - 0.5) / 64
    # Linear between pixels of pi / 32: a light of that pixel's solid angle, as soft as the pixel is wide.
    power = latlong[row, col - 1] * (np.pi / 32) ** 2 * np.sin(theta)
    light = LightSet.of(np.arange(1), direction_from_angles(np.array([theta]), np.array([phi])), power[None])
    picture = mitsuba_picture.picture(mitsuba_picture.mitsuba_scene(load_scene(SHAPES), SIZE, latlong), 256)
    truth = drawn(light, 16)
    assert picture.sum(axis=(0, 1)) == pytest.approx(truth.sum(axis=(0, 1)), rel=0.05)
    assert relative(picture, truth) < 0.3  # edges as soft as a pixel of 5.6 degrees; 1 and more for a light elsewhere


def test_all_of_mitsubas_methods_have_the_same_mean():
    """Samples of the map, of the surface, of both, and paths without anything to bounce from: unbiased, so alike."""
    ball = Mesh("ball", shape_geometry("sphere"), Phong((0.3, 0.3, 0.3), (0.5, 0.4, 0.3), 20.0))
    scene = Scene(ViewCamera(position=(0.0, -6.0, 1.0), at=(0.0, 0.0, 0.0), fov_y=24.0), (ball,), np.zeros(3), np.ones(3))
    latlong = np.full((16, 32, 3), 1.0, np.float32)
    latlong[4, 9] = 20.0
    world = mitsuba_picture.mitsuba_scene(scene, (24, 24), latlong)
    pictures = {method: mitsuba_picture.picture(world, 400, method=method) for method in mitsuba_picture.METHODS}
    for method, picture in pictures.items():
        assert picture.mean() == pytest.approx(pictures["emitter"].mean(), rel=0.01), method
        assert relative(picture, pictures["mis"]) < 0.1, method


def test_traced_lights_with_extent_give_a_plane_what_they_must():
    plane = Mesh("plane", shape_geometry("plane"), Phong((1.0, 1.0, 1.0)))
    scene = Scene(ViewCamera(position=(0.0, 0.0, 3.0), at=(0.0, 0.01, 0.0), fov_y=20.0), (plane,), np.zeros(3), np.ones(3))
    directions = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
    lights = LightSet.of(np.arange(2), directions, np.ones((2, 3)), np.array([[0.04, 0, 0, 0.02, 0, 0], [0.01, 0, 0, 0.03, 0, 0]]))
    traced = mitsuba_picture.TracedLights(mitsuba_picture.mitsuba_scene(scene, (32, 32), None), (32, 32))
    expected = received(lights.directions[:, 2].astype(float), Extents.of(lights)).sum() / np.pi
    assert traced.picture(lights, 16).mean() == pytest.approx(expected, rel=0.02)
