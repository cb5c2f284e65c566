"""Edges of shadows in pictures of one sample a pixel: rays that begin all over a pixel, and never below what is beside it."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.rendering import SceneRenderer
from vemlight.light.light_set import LightSet
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

SIDE, FOV_DEG = 64, 10.0
CAMERA = f"[camera]\nfrom = [0.0, -3.9, 0.8]\nat = [0.0, 0.0, -0.5]\nfov_y = {FOV_DEG}\n"
GROUND = '[[mesh]]\nshape = "plane"\nscale = 40.0\nat = [0.0, 0.0, -0.5]\nmaterial = {diffuse = [1.0, 1.0, 1.0]}\n'
PLATE = '[[mesh]]\nshape = "plane"\nscale = 20.0\nat = [%.6f, 0.0, 1.0]\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'
PIXEL_M = 2 * np.hypot(3.9, 1.3) * np.tan(np.radians(FOV_DEG / 2)) / SIDE  # in the middle of the picture
BOX = '[[mesh]]\nshape = "box"\nscale = 0.5\nat = [0.0, 0.0, 0.0]\nmaterial = {diffuse = [1.0, 1.0, 1.0]}\n'


@pytest.fixture(autouse=True)
def one_sample(monkeypatch):
    monkeypatch.setattr("vemlight.renderer.frame.EDGE_SAMPLES", 0)


def narrow(direction: tuple[float, float, float], faint: int = 0) -> LightSet:
    """A light of irradiance pi that is a ten-thousandth of a radian wide, and so many that have next to none of its power."""
    d = np.array(direction) / np.linalg.norm(direction)
    c = 1e-8 * (np.eye(3) - np.outer(d, d))[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    count, irradiance = 1 + faint, np.full((1 + faint, 3), 1e-6)
    irradiance[0] = np.pi
    return LightSet.of(np.arange(count), np.tile(d, (count, 1)), irradiance, np.tile(c, (count, 1)))


def picture(folder: Path, text: str, lights: LightSet) -> np.ndarray:
    (folder / "scene.toml").write_text(text)
    wanted = Settings(width=SIDE, height=SIDE, shadows="rays", frame_ms=1e4, bounces=0)
    renderer = SceneRenderer(load_scene(folder / "scene.toml"), wanted, 1)
    made = renderer.picture(lights)[..., 0].copy()
    renderer.release()
    return made


@pytest.mark.parametrize(("faint", "covered"), [(0, 0.5), (8, 0.25), (8, 0.75)])
def test_a_pixel_takes_the_part_of_the_light_that_reaches_it(tmp_path, faint, covered):
    # The plate's shadow ends so far into the 33rd column. One light of its power has four rays in two columns, a strong one 16 in four.
    made = picture(tmp_path, CAMERA + GROUND + PLATE % (covered * PIXEL_M - 20), narrow((0.0, 0.0, 1.0), faint))
    assert made[32, 31:34] == pytest.approx([0, 1 - covered, 1], abs=0.02)


@pytest.mark.parametrize("fov_deg", [26, 28, 30, 32, 34])  # the box's foot lies elsewhere in its pixels
def test_rays_begin_above_what_stands_beside_their_pixel(tmp_path, fov_deg):
    # The light is steeper than the view, so the box hides its own shadow, and all that is seen is lit: its top, its face, the floor.
    view = f"[camera]\nfrom = [0.0, -4.0, 3.0]\nat = [0.0, 0.0, -0.2]\nfov_y = {fov_deg}.0\n"
    made = picture(tmp_path, view + GROUND + BOX, narrow((0.0, -0.6, 0.8), faint=8))
    assert np.minimum(abs(made - 0.8), abs(made - 0.6)).max() < 0.01
    assert (abs(made - 0.6) < 0.01).sum() > 100
