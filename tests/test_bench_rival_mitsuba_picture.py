import numpy as np
import pytest

pytest.importorskip("mitsuba", reason="Mitsuba is in the bench extra")

from bench.rivals import mitsuba_picture
from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.scene.scene import load_scene
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
