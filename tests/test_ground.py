"""The light that a ground sends up: closed forms, and pictures with a ground in the map and one in the scene."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.light_sets import lights_from
from tests.support.rendering import SceneRenderer
from vemlight.capture.ground import horizontal_irradiance, with_ground
from vemlight.capture.lens import Lens
from vemlight.capture.simulation.sensor import VirtualCamera
from vemlight.capture.simulation.simulate import Lighting, simulate
from vemlight.capture.source import open_source
from vemlight.commands.offline import write_lights_file
from vemlight.commands.options import LightsOptions
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells
from vemlight.light.images import write_exr
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import map_irradiance
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Capture, Renderer


def test_an_even_sky_of_radiance_1_has_the_irradiance_pi_and_the_ground_its_albedo():
    sky = np.ones((9, 16, 3), np.float32) * np.array([1.0, 2.0, 4.0], np.float32)
    np.testing.assert_allclose(horizontal_irradiance(sky, NO_BRIGHT_CELLS), np.pi * np.array([1, 2, 4]), rtol=1e-6)
    closed = with_ground(sky, NO_BRIGHT_CELLS, 0.25)
    assert closed.dtype == np.float32
    assert closed.shape == (18, 16, 3)
    np.testing.assert_array_equal(closed[:9], sky)
    np.testing.assert_allclose(closed[9:], np.broadcast_to([0.25, 0.5, 1.0], (9, 16, 3)), rtol=1e-6)


def test_a_white_ground_sends_up_all_that_arrives():
    sky = np.random.default_rng(0).random((30, 60, 3)).astype(np.float32) ** 4
    closed = with_ground(sky, NO_BRIGHT_CELLS, 1.0)
    below = horizontal_irradiance(closed[:29:-1], NO_BRIGHT_CELLS)  # of a level surface that faces down
    np.testing.assert_allclose(below, horizontal_irradiance(sky, NO_BRIGHT_CELLS), rtol=1e-5)


def test_a_sun_counts_from_where_it_lies_in_its_cell_and_no_ground_is_less_than_dark():
    sky = np.zeros((3, 4, 3), np.float32)
    sky[2, 1] = 6.0
    directions = np.array([[0.0, 0.8, 0.6], [0.0, 1.0, 0.0]], np.float32)
    bright = BrightCells(np.array([9, 9]), directions, np.array([0.75, 0.25], np.float32))
    expected = map_irradiance(sky, "hemisphere") * (0.75 * 0.6)
    np.testing.assert_allclose(horizontal_irradiance(sky, bright), expected, rtol=1e-6)
    sky[0, 0] = np.nan, -5.0, np.inf
    np.testing.assert_allclose(horizontal_irradiance(sky, bright), expected, rtol=1e-6)
    assert horizontal_irradiance(np.zeros((3, 4, 3), np.float32), NO_BRIGHT_CELLS).tolist() == [0, 0, 0]


def test_no_light_from_below_the_horizon_reaches_a_surface_that_faces_up():
    """Of a sphere of 5 rings, whose middle one is half above the horizon; bright cells below it, too."""
    whole = np.ones((5, 16, 3), np.float32)
    np.testing.assert_allclose(horizontal_irradiance(whole, NO_BRIGHT_CELLS, "sphere"), np.pi, rtol=1e-6)
    whole[:3] = 0
    bright = BrightCells(np.array([3 * 16 + 5]), np.array([[0.0, 0.8, -0.6]], np.float32), np.ones(1, np.float32))
    np.testing.assert_array_equal(horizontal_irradiance(whole, bright, "sphere"), 0)


def test_a_source_with_a_ground_gives_spheres(tmp_path):
    write_exr(tmp_path / "map.exr", np.full((32, 64, 3), 0.5, np.float32))
    source = str(tmp_path / "map.exr")
    bare = open_source(Capture(source=source, rows=10, cols=20)).frame(0)
    frame = open_source(Capture(source=source, rows=10, cols=20, ground=0.3)).frame(0)
    assert (bare.coverage, frame.coverage) == ("hemisphere", "sphere")
    np.testing.assert_array_equal(frame.radiance[:10], bare.radiance)
    np.testing.assert_allclose(frame.radiance[10:], 0.15, rtol=1e-3)
    with pytest.raises(ValueError, match="leave one of them out"):
        Capture(ground=0.2, coverage="sphere")


def test_lights_of_a_map_with_a_ground_come_from_below_too(tmp_path):
    write_exr(tmp_path / "map.exr", np.full((32, 64, 3), 0.5, np.float32))
    for ground, below in ((None, 0.0), (0.4, 0.4 * np.pi)):
        out = tmp_path / "lights.json"
        write_lights_file(LightsOptions(source=tmp_path / "map.exr", out=out, count=40, soft=False, ground=ground))
        row = json.loads(out.read_text())
        assert row["coverage"] == ("sphere" if ground else "hemisphere")
        power = np.array([light["irradiance"][1] for light in row["lights"]])
        is_below = np.array([light["direction"][2] for light in row["lights"]]) < 0
        np.testing.assert_allclose(power[is_below].sum(), below, rtol=0.35)  # a light at the horizon has some of both
        np.testing.assert_allclose(power.sum(), np.pi + below, rtol=1e-3)


@pytest.mark.parametrize("scene", ["sky", "interior"])
def test_what_a_fisheye_sees_agrees_with_the_truth_of_level_ground(tmp_path, scene):
    lens = Lens(size=(200, 200), f=(58.0, 58.0), c=(99.5, 99.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0)
    simulate(Lighting(maps=(scene,)), VirtualCamera(lens=lens), tmp_path, frames=1)
    truth = json.loads((tmp_path / "truth.jsonl").read_text())
    frame = open_source(Capture(source=str(tmp_path), ground=0.5)).frame(0)
    np.testing.assert_allclose(frame.radiance[-1, 0] * np.pi / 0.5, truth["level_irradiance"], rtol=0.01)


CAMERA = "[camera]\nfrom = [0.0, 0.0, {z}]\nat = [0.0, 0.0, 1.0]\nfov_y = 20.0\n"
BOARD = '[[mesh]]\nname = "board"\nshape = "box"\nscale = [1.0, 1.0, 0.05]\nat = [0.0, 0.0, 1.0]\nmaterial = {diffuse = [0.5, 0.5, 0.5]}\n'


def middle(folder: Path, text: str, lights: LightSet, bounces: int = 0) -> float:
    (folder / "scene.toml").write_text(text)
    renderer = SceneRenderer(load_scene(folder / "scene.toml"), Renderer(width=16, height=16, shadows="rays", bounces=bounces), 1)
    picture = renderer.picture(lights)
    renderer.release()
    return float(picture[6:10, 6:10, 1].mean())


def test_light_from_below_ends_at_the_ground_of_a_scene(tmp_path):
    """So that a map with a ground and a scene with one do not count it twice."""
    sun, below = lights_from(np.array([0.0, 0.0, 1.0])), lights_from(np.array([0.3, 0.0, -0.95]))
    seen_from_below, seen_from_above = CAMERA.format(z=-3.0) + BOARD, CAMERA.format(z=5.0) + BOARD
    ground = '[[mesh]]\nname = "ground"\nshape = "plane"\nscale = 50.0\nmaterial = {diffuse = [0.5, 0.5, 0.5]}\n'
    below_board = CAMERA.format(z=0.3) + BOARD
    assert middle(tmp_path, seen_from_below, below) > 0.1
    assert middle(tmp_path, seen_from_below, sun) == 0
    assert middle(tmp_path, below_board + ground, below) == 0
    assert middle(tmp_path, seen_from_above + ground, sun) > 0.1
