"""A paused picture: the map as an endless supply of lights, and the mean that goes to the map's own integral."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.renderer_steps import controlled, picture_of, stepped
from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.light.bright_cells import NO_BRIGHT_CELLS
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import cell_from_direction, map_irradiance
from vemlight.renderer.accumulation import PASS_LIGHTS, PASSES, Accumulation, MapLights, spread_points
from vemlight.renderer.frame import AccumulationPass
from vemlight.renderer.scene.scene import load_scene
from vemlight.renderer.stage import RendererStage
from vemlight.runtime import stamps, wire
from vemlight.runtime.poses import Pose
from vemlight.settings import Renderer as Size
from vemlight.settings import Settings


def a_map(rows: int = 30, cols: int = 120) -> np.ndarray:
    """A sky brighter below, a window and a sun that gives half of the light."""
    radiance = np.broadcast_to(0.3 + np.linspace(0, 1, rows)[:, None, None] * np.array([0.5, 0.7, 1.0]), (rows, cols, 3)).astype(np.float32)
    radiance = radiance.copy()
    radiance[rows // 4, cols // 4] += 2500.0
    radiance[2 * rows // 3 : 3 * rows // 4, cols // 2 : 2 * cols // 3] += 5.0
    return radiance


def off(a: np.ndarray, b: np.ndarray) -> float:
    """Relative RMSE of colours."""
    return float(np.sqrt(np.mean((a[..., :3] - b[..., :3]) ** 2)) / np.sqrt(np.mean(b[..., :3] ** 2)))


@given(st.integers(0, 2**32 - 1), st.sampled_from(["hemisphere", "sphere"]))
def test_a_light_is_drawn_as_often_as_its_cell_gives(seed, coverage):
    rng = np.random.default_rng(seed)
    radiance = np.where(rng.random((6, 10, 1)) < 0.4, 0.0, rng.exponential(1.0, (6, 10, 3)) ** 4).astype(np.float32)
    radiance[2, 3] += 0.1
    light = MapLights(radiance, coverage)
    count = 20_000
    drawn = light.lights(np.stack([(np.arange(count) + 0.5) / count, spread_points(0, count)[:, 1]], axis=1))
    row, col = (np.floor(each).astype(int) for each in cell_from_direction(drawn.directions.astype(float), 6, 10, coverage))
    total = np.zeros((6, 10, 3))
    np.add.at(total, (np.minimum(row, 5), np.minimum(col, 9)), drawn.irradiance)
    cells = light.cells()
    wanted = np.zeros((60, 3))
    wanted[cells.ids] = cells.irradiance
    # directions are float32: few of them fall into the next cell
    assert np.allclose(total.reshape(-1, 3), wanted, atol=3e-3 * wanted.sum())
    assert np.allclose(cells.irradiance.sum(axis=0), map_irradiance(radiance, coverage), rtol=1e-5)


@pytest.mark.parametrize(("count", "discrepancy"), [(64, 0.06), (1024, 0.006)])
def test_points_are_spread_more_evenly_than_at_random(count, discrepancy):
    """In no box from the origin is the fraction of points far from its area: random points leave 0.13 and 0.035 in the median."""
    points = spread_points(0, count)
    sides = np.linspace(0, 1, 33)[1:]
    inside = (points[:, 0, None] < sides)[:, :, None] & (points[:, 1, None] < sides)[:, None, :]
    assert np.abs(inside.mean(axis=0) - sides[:, None] * sides).max() < discrepancy


def test_passes_share_no_light_and_add_up_to_the_map():
    light = MapLights(a_map(), "hemisphere")
    passes = [light.of_pass(k) for k in range(PASSES)]
    directions = np.concatenate([lights.directions for lights in passes])
    assert len(np.unique(directions, axis=0)) == PASSES * PASS_LIGHTS
    mean = np.mean([lights.irradiance.sum(axis=0) for lights in passes], axis=0)
    assert np.allclose(mean, map_irradiance(light.radiance, "hemisphere"), rtol=1e-3)


@pytest.mark.parametrize("spot", [None, (0, 0), (29, 119)])
def test_black_maps_and_single_cells(spot):
    radiance = np.zeros((30, 120, 3), np.float32)
    if spot is None:
        assert len(MapLights(radiance, "hemisphere").of_pass(0).ids) == 0
        return
    radiance[spot] = (1e6, 0.0, 0.0)
    lights = MapLights(radiance, "hemisphere").of_pass(0)
    assert np.allclose(lights.irradiance.sum(axis=0), map_irradiance(radiance, "hemisphere"), rtol=1e-5)
    assert np.isfinite(lights.directions).all()
    assert lights.irradiance[:, 1:].max() == 0


def test_the_error_falls_with_every_doubling_to_less_than_one_per_cent(monkeypatch):
    """Against a light for each cell of the map, and 36 for the sun's, at one place in each pixel: of the light alone."""
    monkeypatch.setattr("vemlight.renderer.frame_plan.spread_points", lambda first, count: np.full((count, 2), 0.5))
    light = MapLights(a_map(), "hemisphere")
    renderer = SceneRenderer(load_scene(SHAPES), Size(width=32, height=24, shadow_map=128))
    cells = light.cells()
    parts = MapLights(light.radiance.repeat(6, axis=0).repeat(6, axis=1), "hemisphere").cells()
    row, col = np.divmod(parts.ids, 720)
    sun, rest = (row // 6 == 7) & (col // 6 == 30), cells.ids != 7 * 120 + 30
    joined = [np.concatenate([whole[rest], fine[sun]]) for whole, fine in zip(cells[:3], parts[:3], strict=True)]
    exact = renderer.picture(LightSet(*joined)).copy()
    refined, errors = Accumulation.empty(), []
    while not refined.converged:
        refined = refined.with_pass(renderer.picture_of_pass(light, refined.passes))
        if refined.passes & (refined.passes - 1) == 0:
            errors.append(off(refined.picture, exact))
    renderer.release()
    assert all(later < earlier for earlier, later in pairwise(errors)), errors
    assert errors[-1] < 0.01
    assert errors[-1] < errors[0] / 6  # of random lights it would be an eighth with luck, of even ones it is a tenth and less


def test_pixels_become_means_over_their_area():
    light = MapLights(np.ones((4, 8, 3), np.float32), "hemisphere")
    renderer = SceneRenderer(load_scene(SHAPES), Size(width=24, height=18, shadow_map=32))
    refined = Accumulation.empty()
    while not refined.converged:
        refined = refined.with_pass(renderer.picture_of_pass(light, refined.passes))
    renderer.release()
    fine = SceneRenderer(load_scene(SHAPES), Size(width=24 * 16, height=18 * 16, shadow_map=32))
    area = fine.picture(light.of_pass(0))[..., 3].reshape(18, 16, 24, 16).mean(axis=(1, 3))
    fine.release()
    error = np.abs(refined.picture[..., 3] - area)
    # 64 even points see the share of a pixel that an edge cuts off to about 64 ** -0.75 = 0.044, at the worst edge to twice as much
    assert error.max() < 0.09
    assert error[error > 0].mean() < 0.03


def test_a_pause_refines_stops_and_begins_again_at_a_change(monkeypatch):
    monkeypatch.setattr("vemlight.renderer.accumulation.PASSES", 4)
    stage = RendererStage(Settings(renderer=Size(width=48, height=36, shadow_map=64, frame_ms=0.0, picture="linear16")))
    assert stage.side_inputs(controlled(stage, stage.start_at(0)[0], paused=True)) == ("map",)
    drawn = []
    draw = stage._renderer.draw

    def noted(frame):
        if isinstance(frame.shown.lights, AccumulationPass) and frame.uploaded is None:
            drawn.append(frame.shown.lights.number)
        return draw(frame)
    monkeypatch.setattr(stage._renderer, "draw", noted)

    def shown(state, sequence, radiance, **wish):
        header = wire.MapMessage(stamp=stamps.stamp(sequence, sequence / 10), rows=30, cols=120, coverage="hemisphere")
        state = stage.on_message(controlled(stage, state, **wish), (header, (radiance, *NO_BRIGHT_CELLS)))
        return stepped(stage, state, sequence)

    state, image = shown(stage.start_at(0)[0], 0, a_map())
    assert (image.report.drawn_lights, drawn) == (3, [])
    live = picture_of(state)
    for sequence in range(1, 8):
        state, image = shown(state, sequence, a_map(), paused=True)
    assert drawn == [0, 1, 2, 3]
    assert image.report.drawn_lights == 4 * PASS_LIGHTS
    assert (image.report.passes, image.report.max_passes) == (4, PASSES)
    assert 0 < image.report.pass_error_ratio < 1
    converged = picture_of(state)
    state, _ = shown(state, 8, a_map(), paused=True, exposure=1.0)  # of what is seen nothing changed
    assert drawn == [0, 1, 2, 3]
    assert picture_of(state) is converged
    moved = Pose(name="box", position=(0.0, 0.0, 0.42))
    state, _ = shown(state, 9, a_map(), paused=True, poses=(moved,))
    state, _ = shown(state, 10, 2 * a_map(), paused=True, poses=(moved,))
    assert drawn == [0, 1, 2, 3, 0, 0]
    state, image = shown(state, 11, a_map())
    assert image.report.drawn_lights == 3
    assert (image.report.passes, image.report.max_passes, image.report.pass_error_ratio) == (0, 0, 0.0)
    assert np.array_equal(picture_of(state), live)


def test_a_catcher_is_lit_by_the_whole_map_in_every_pass(tmp_path):
    camera = "[camera]\nfrom = [0.0, -6.0, 3.0]\nat = [0.0, 0.0, 0.4]\n"
    ground = '[[mesh]]\nshape = "plane"\nscale = 3.0\nmaterial = {catcher = true}\n'
    (tmp_path / "scene.toml").write_text(camera + ground + '[[mesh]]\nshape = "box"\nscale = 0.5\nat = [0.0, 0.0, 0.8]\n')
    renderer = SceneRenderer(load_scene(tmp_path / "scene.toml"), Size(width=32, height=24, shadow_map=64))
    light = MapLights(a_map(12, 48), "hemisphere")
    exact = renderer.picture(light.cells()).copy()
    refined = Accumulation.empty()
    while not refined.converged:
        refined = refined.with_pass(renderer.picture_of_pass(light, refined.passes))
    renderer.release()
    inside = np.abs(exact[..., 3] - refined.picture[..., 3])[exact[..., 3] < 0.9]
    assert exact[..., 3][exact[..., 3] < 0.9].max() > 0.3
    assert np.median(inside) < 0.01  # edges apart, where a pixel's mean is not its middle
    assert abs(inside.mean()) < 0.03


def test_the_error_told_is_about_the_error_there_is():
    renderer = SceneRenderer(load_scene(None), Size(width=48, height=36))
    light = MapLights(a_map(), "hemisphere")
    pictures = [renderer.picture_of_pass(light, number).copy() for number in range(4 * 16)]
    renderer.release()
    exact, refined = np.mean(pictures, axis=0)[..., :3], Accumulation.empty()
    told = []
    for picture in pictures[:16]:
        refined = refined.with_pass(picture)
        told.append(refined.error)
    error = np.abs(luminance_from_rgb(refined.picture[..., :3] - exact)).mean() / luminance_from_rgb(exact).mean()
    assert error / 2.5 < told[-1] < 2.5 * error
    assert told[0] == 0.0  # of one pass nothing is known
    assert told[8:15] == 7 * [told[7]]  # it is of the last power of two
    assert told[1] > told[7] > told[15]


def test_a_black_picture_has_no_error_to_tell():
    black = Accumulation.empty()
    for _ in range(4):
        black = black.with_pass(np.zeros((2, 2, 4), np.float32))
    assert black.error == 0.0
