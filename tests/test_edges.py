"""Smooth edges live: found sample by sample while surfaces stand still, gone when they move, at any light."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.light_sets import lights_from
from tests.support.rendering import SceneRenderer
from vemlight.light.light_set import LightSet
from vemlight.renderer import frame, pass_table
from vemlight.renderer.output.tonemap import Adaptation
from vemlight.renderer.passes.edges.edges import SAMPLES
from vemlight.renderer.rays.edge_samples import NEIGHBOURS, nearest_neighbours
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.runtime.poses import Pose
from vemlight.settings import Renderer as Settings

SCENE = """
[camera]
from = [0.0, -6.0, 3.0]
at = [0.0, 0.0, 0.5]
fov_y = 30.0
[[mesh]]
shape = "plane"
scale = 1.5
[[mesh]]
name = "post"
shape = "box"
scale = [0.4, 0.05, 0.8]
at = [0.1, 0.0, 0.8]
rotate = [0.0, 20.0, 10.0]
material = {diffuse = [0.1, 0.2, 0.8]}
[[mesh]]
shape = "box"
scale = [0.006, 0.006, 1.0]
at = [-0.8, 0.0, 1.0]
rotate = [0.0, 8.0, 0.0]
"""
ABOVE = lights_from(np.array([[0.0, -0.3, 0.9539]]), 3.0)


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    (tmp_path / "scene.toml").write_text(SCENE)
    return load_scene(tmp_path / "scene.toml")


def renderer_of(scene: Scene, frame_ms: float = 1e4, samples: int = 1, shadows: str = "rays") -> SceneRenderer:
    return SceneRenderer(scene, Settings(width=96, height=72, shadows=shadows, frame_ms=frame_ms, bounces=0), samples)  # type: ignore[arg-type]


def still(renderer: SceneRenderer, lights: LightSet = ABOVE) -> np.ndarray:
    """The picture once its edges are found."""
    pictures = [renderer.picture(lights).copy() for _ in range(frame.EDGE_SAMPLES + 1)]
    return pictures[-1]


def error(picture: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean((picture - truth) ** 2) / np.mean(truth**2)))


def test_still_edges_are_those_of_sixteen_samples(scene):
    live, file = renderer_of(scene), renderer_of(scene, 0.0, 16)
    truth = file.picture(ABOVE).copy()
    rough, smooth = live.picture(ABOVE).copy(), still(live)
    assert error(smooth, truth) < 0.5 * error(rough, truth)  # what is left are edges of shadows
    off = [np.abs(each[:24, 8:34, 3].sum(axis=1) - truth[:24, 8:34, 3].sum(axis=1)).mean() for each in (rough, smooth)]
    assert off[1] < 0.5 * off[0]  # rows of a wire thinner than a pixel before nothing
    live.picture(ABOVE)
    assert not live.plan.runs(pass_table.EDGES)
    for renderer in (live, file):
        renderer.release()


def test_smooth_edges_stay_while_the_light_changes_and_go_when_surfaces_move(scene):
    live = renderer_of(scene)
    still(live)
    low = lights_from(np.array([[0.6, -0.6, 0.53]]), 2.0)
    changed = live.picture(low).copy()
    again = renderer_of(scene)
    assert np.array_equal(changed, still(again, low))
    moved = Pose(name="post", position=(0.4, 0.0, 0.8), rotation=(0.0, 0.0, 0.0, 1.0))
    live.place(0.0, [moved])
    first = live.picture(low).copy()
    assert live.state.edge_samples == 0
    again.place(0.0, [moved])
    assert np.array_equal(again.picture(low), first)
    assert not np.array_equal(live.picture(low), first)  # its first sample
    for renderer in (live, again):
        renderer.release()


def test_a_state_drawn_again_has_the_same_edges(scene):
    live = renderer_of(scene)
    for _ in range(4):
        expected = live.picture(ABOVE).copy()
        state = live.state
    live.place(0.0, [Pose(name="post", position=(0.4, 0.0, 0.8), rotation=(0.0, 0.0, 0.0, 1.0))])
    live.picture(ABOVE)
    live.place(0.0, [])
    live.state = state._replace(edge_samples=state.edge_samples - 1)
    assert np.array_equal(live.picture(ABOVE), expected)
    live.release()


@pytest.mark.parametrize(("frame_ms", "samples", "shadows"), [(0.0, 1, "rays"), (1e4, 4, "rays"), (1e4, 1, "maps")])
def test_files_pixels_of_several_samples_and_maps_have_edges_of_their_own(scene, frame_ms, samples, shadows):
    renderer = renderer_of(scene, frame_ms, samples, shadows)
    assert renderer.renderer.setup.edge_samples == 0
    renderer.release()


def test_an_uploaded_picture_is_shown_as_it_is(scene):
    live, plain = renderer_of(scene), renderer_of(scene, 0.0)
    still(live)
    picture = np.random.default_rng(1).random((72, 96, 4)).astype(np.float32)
    assert np.array_equal(live.tone_mapped(picture, Adaptation(), 0.0), plain.tone_mapped(picture, Adaptation(), 0.0))
    for renderer in (live, plain):
        renderer.release()


def test_samples_are_spread_over_the_pixel_and_look_to_the_nearest_neighbours():
    places = np.array([sample[:2] for sample in SAMPLES])
    assert len(SAMPLES) == frame.EDGE_SAMPLES
    assert places.mean(axis=0) == pytest.approx([0.5, 0.5])
    assert all(len(set((places[:, k] * 8).astype(int))) == 8 for k in (0, 1))  # one in each eighth, across and down
    assert tuple(NEIGHBOURS[nearest_neighbours(0.9, 0.6)[0]]) == (1, 0)
    assert tuple(NEIGHBOURS[nearest_neighbours(0.4, 0.05)[0]]) == (0, -1)
