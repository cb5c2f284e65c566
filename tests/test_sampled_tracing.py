"""Rays of pictures of several samples a pixel: none for what the first sample settled, and the picture that all rays give."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.light_sets import sky_and_sun
from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.renderer.passes.lights.traced_visibility import TracedVisibility
from vemlight.renderer.rays.soft_filter import SEEN_DARK, SEEN_LIT
from vemlight.renderer.rays.soft_pattern import soft_pattern
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.settings import Renderer as Settings

GROUND = """[camera]
from = [0.0, -3.0, 1.0]
at = [0.0, 0.0, 1.0]
fov_y = 40.0
[[mesh]]
shape = "plane"
scale = 100.0
"""
WIRE = '[[mesh]]\nshape = "box"\nscale = 0.002\nat = [{x}, {y}, 1.0]\n'
SAMPLES = 4


def all_rays(self: TracedVisibility, lights, sample: int, samples: int, _number: int) -> np.ndarray:
    return self._tracer.trace(lights, soft_pattern(sample, samples), whole=True)


def scene_of(folder: Path, text: str) -> Scene:
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml")


def pictures(scene: Scene, monkeypatch, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """As it is drawn, by all rays, and the states of tiles."""
    renderer = SceneRenderer(scene, Settings(width=128, height=height, bounces=0, light_regions=0), SAMPLES)
    drawn = renderer.picture(sky_and_sun()).copy()
    states = renderer.renderer._rays._settled[0].states  # type: ignore[union-attr]
    with monkeypatch.context() as patch:
        patch.setattr(TracedVisibility, "_trace", all_rays)
        whole = renderer.picture(sky_and_sun()).copy()
    again = renderer.picture(sky_and_sun())
    renderer.release()
    assert np.array_equal(again, drawn)
    return drawn[..., :3], whole[..., :3], states


def test_settled_tiles_look_as_if_all_rays_were_traced(monkeypatch):
    drawn, whole, states = pictures(load_scene(SHAPES), monkeypatch, 96)
    mixed = (states == SEEN_DARK | SEEN_LIT).mean()
    assert 0.05 < mixed < 0.6
    assert np.sqrt(np.mean((drawn - whole) ** 2)) < 0.004 * np.sqrt(np.mean(whole**2))
    assert np.isclose(drawn.mean(), whole.mean(), rtol=0.002)


@pytest.mark.parametrize("height", [94, 95, 96, 97])
def test_a_horizon_that_the_first_sample_does_not_see_is_lit(tmp_path, monkeypatch, height):
    """Tiles in which only another sample sees the ground, whatever row of a tile the horizon is in."""
    drawn, whole, _ = pictures(scene_of(tmp_path, GROUND), monkeypatch, height)
    assert np.abs(drawn - whole).max() < 0.01 * whole.max()


def test_what_only_another_sample_sees_has_rays_of_its_own(tmp_path, monkeypatch):
    """Specks of a sixth of a pixel before the horizon, each in another's shade as the case may be."""
    specks = [WIRE.format(x=round(-0.9 + 0.02 * k, 3), y=round(-0.001 * (k % 7), 3)) for k in range(90)]
    drawn, whole, _ = pictures(scene_of(tmp_path, GROUND + "".join(specks)), monkeypatch, 96)
    assert np.sqrt(np.mean((drawn - whole) ** 2)) < 0.01 * np.sqrt(np.mean(whole**2))
