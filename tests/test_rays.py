"""Shadows by rays: exact from everything that casts them, at every scale, kept while nothing changes."""

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.support.gltf_files import TexturedSquare
from tests.support.light_sets import lights_from, uniform_lights
from tests.support.ray_casting import first_hits, near_edges, scene_tree, visible
from tests.support.rendering import SceneRenderer
from tests.support.scenes import SHAPES
from vemlight.errors import UserError
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer import pass_table, shadows
from vemlight.renderer.passes.lights.traced_lights import KEPT_RAD
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.runtime.poses import Pose
from vemlight.settings import Renderer as Settings

ABOVE = "[camera]\nfrom = [0.0, 0.0, 10.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 11.0\n"  # sees x, y from -0.963 to 0.963
GROUND = '[[mesh]]\nshape = "plane"\nscale = 4.0\nat = [0.0, 0.0, -0.5]\nmaterial = {diffuse = [1.0, 1.0, 1.0]}\n'
SHEET = '[[mesh]]\nname = "sheet"\nfile = "sheet.gltf"\ny_up = false\n'
SUN = LightSet.of(np.zeros(1), np.array([[0.0, 0.0, 1.0]]), np.full((1, 3), np.pi))
SLANTED = LightSet.of(np.zeros(1), np.array([[0.48, 0.0, np.sqrt(1 - 0.48**2)]]), np.full((1, 3), np.pi))
ROOM = """
[camera]
from = [1.2, 0.0, 0.2]
at = [-2.0, 0.1, 0.0]
fov_y = 80.0
[[mesh]]
shape = "box"
scale = 2.0
material = {diffuse = [0.5, 0.5, 0.5]}
"""


@pytest.fixture(autouse=True)
def rough_edges(monkeypatch):
    """Pictures change by their lights alone, not while their edges are found (test_edges.py)."""
    monkeypatch.setattr("vemlight.renderer.frame.EDGE_SAMPLES", 0)


def renderer_of(scene: Scene, side: int = 64, frame_ms: float = 0.0, samples: int = 1, shadows: str = "rays") -> SceneRenderer:
    wanted = Settings(width=side, height=side, shadows=shadows, frame_ms=frame_ms, bounces=0)  # type: ignore[arg-type]
    return SceneRenderer(scene, wanted, samples)


def scene_of(folder: Path, text: str) -> Scene:
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml")


def scaled(scene: Scene, scale: float, offset: tuple[float, float, float]) -> Scene:
    """The scene `scale` times as large, moved by `offset` metres."""
    meshes = (mesh._replace(geometry=mesh.geometry.moved(scale * np.eye(3), np.array(offset))) for mesh in scene.meshes)
    position, at = (tuple(scale * np.array(point) + offset) for point in (scene.camera.position, scene.camera.at))
    camera = msgspec.structs.replace(scene.camera, position=position, at=at)
    return scene._replace(meshes=tuple(meshes), camera=camera, centre=scale * scene.centre + offset, half=scale * scene.half)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("offset", [0.0, 200.0])
def test_rays_are_exact_at_every_scale_and_far_from_the_origin(scale, offset):
    scene = scaled(load_scene(SHAPES), scale, (scale * offset, -scale * offset, 0.0))
    tree = scene_tree(scene)
    hits = first_hits(scene, tree, 96, 96)
    renderer, wrong, seen_by_light = renderer_of(scene, 96), 0, 0
    inside = (hits.triangle >= 0) & ~near_edges(hits.triangle >= 0, 1)
    for theta, phi in [(0.2, 1.0), (0.9, 2.2), (1.45, 0.3)]:
        direction = direction_from_angles(theta, phi)
        lit = renderer.picture(lights_from(direction))[..., :3].max(axis=-1) > 0
        truth = visible(tree, hits, direction, float(np.linalg.norm(scene.half)))
        wrong += np.count_nonzero((lit != truth) & inside & ~near_edges(truth, 1))
        seen_by_light += np.count_nonzero(truth & inside)
    renderer.release()
    assert seen_by_light > 1000
    assert wrong <= seen_by_light / 2000  # 3 of 10,000 at most measured: acne would be every other pixel, a leak a line


def test_no_light_enters_a_closed_box(tmp_path):
    renderer = renderer_of(scene_of(tmp_path, ROOM), 96)
    picture = renderer.picture(uniform_lights(300, -1.0))
    renderer.release()
    assert picture[..., 3].min() == 1
    assert picture[..., :3].max() == 0


def chessboard(alpha: float, low: int) -> np.ndarray:
    """White, with an alpha in 4 x 4 fields: `alpha`, and `low` of 255 in every other one."""
    pixels = np.full((64, 64, 4), 255, np.uint8)
    pixels[..., 3] = np.where((np.indices((64, 64)) // 16).sum(axis=0) % 2, low, round(255 * alpha))
    return pixels


def shadow_of(folder: Path, mode: str, image: np.ndarray | None, alpha: float, samples: int, shadows: str) -> np.ndarray:
    """The ground beside a sheet in slanted light, which its shadow falls on."""
    base: dict[str, Any] = {"baseColorFactor": [1.0, 1.0, 1.0, alpha]}
    sheet = TexturedSquare(pbrMetallicRoughness=base, alphaMode=mode)
    if image is not None:
        base["baseColorTexture"] = sheet.image(image)
    sheet.write(folder / "sheet.gltf")
    scene = scene_of(folder, ABOVE.replace("0.0, 0.0, 1", "-2.5, 0.0, 1").replace("at = [0.0", "at = [-2.5") + GROUND + SHEET)
    settings = Settings(width=64, height=64, shadow_map=1024 if shadows == "maps" else None, shadows=shadows)  # type: ignore[arg-type]
    renderer = SceneRenderer(scene, settings, samples)
    picture = renderer.picture(lights_from([0.98, 0.0, 0.199], np.pi))[..., 0].copy()
    renderer.release()
    return picture


@pytest.mark.parametrize(("mode", "low"), [("MASK", 0), ("BLEND", 0)])
def test_light_falls_through_holes_as_it_does_in_maps(tmp_path, mode, low):
    image = chessboard(1.0, low)
    rays, maps = (shadow_of(tmp_path, mode, image, 1.0, 4, kind) for kind in ("rays", "maps"))
    level = maps.max()
    assert 0.2 < np.mean(rays > level / 2) < 0.8  # holes and what is between them
    assert np.abs(rays - maps).mean() < 0.03 * level  # the maps' edges are a texel wide


def test_partial_coverage_takes_its_fraction_of_the_light(tmp_path):
    half, whole = (shadow_of(tmp_path, "BLEND", None, alpha, 1, "rays") for alpha in (0.25, 1.0))
    lit = half.max()
    assert set(np.unique(half.round(3))) == {np.float32(0.75 * lit).round(3), lit.round(3)} or np.ptp(half) < 0.01
    shaded = whole < lit / 2
    assert shaded.any()
    assert half[shaded].mean() == pytest.approx(0.75 * lit, rel=0.01)


def test_what_is_moved_casts_its_shadow_where_it_is(tmp_path):
    text = ABOVE + GROUND + '[[mesh]]\nname = "box"\nshape = "box"\nscale = 0.2\nat = [0.0, 0.0, 1.0]\n'
    renderer = renderer_of(scene_of(tmp_path, text), 32, frame_ms=1e4)
    before = renderer.picture(SLANTED).copy()
    for _ in range(2):  # with the first the surfaces come to their places
        renderer.place(0.0, [Pose(name="box", position=(0.3, 0.2, 1.2), rotation=(0.0, 0.0, 0.0, 1.0))])
        moved = renderer.picture(SLANTED).copy()
    renderer.release()
    fresh = renderer_of(scene_of(tmp_path, text.replace("[0.0, 0.0, 1.0]", "[0.3, 0.2, 1.2]")), 32)
    truth = fresh.picture(SLANTED)
    fresh.release()
    assert not np.array_equal(before, moved)
    np.testing.assert_allclose(moved, truth, atol=1e-6)


@pytest.fixture
def in_time():
    renderer = renderer_of(load_scene(SHAPES), 48, frame_ms=1e4)
    yield renderer
    renderer.release()


def turned(angle: float, count: int = 20) -> LightSet:
    k = np.arange(count) + 0.5
    return lights_from(direction_from_angles(np.arccos(1 - 0.9 * k / count), k * 2.4 + angle), np.pi / count)


def test_lights_at_rest_are_traced_once(in_time):
    traced, pictures = [], []
    for _ in range(3):
        pictures.append(in_time.picture(turned(0.0)).copy())
        traced.append(in_time.plan.batches[0].unknown.count)
    assert traced == [20, 0, 0]
    assert np.array_equal(pictures[0], pictures[2])
    assert not in_time.plan.runs(pass_table.SHADOW_MAPS)


@pytest.mark.parametrize(("fraction", "traced"), [(0.5, 0), (2.0, 20)])
def test_a_light_that_turns_is_traced_again_from_a_tenth_of_a_degree_on(in_time, fraction, traced):
    level = lights_from(direction_from_angles(np.full(20, 1.5), np.arange(20) * 0.3), 0.1)
    in_time.picture(level)
    angle = np.radians(0.1) * fraction
    rotation = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    in_time.picture(level._replace(directions=(level.directions @ rotation.T).astype(np.float32)))
    assert in_time.plan.batches[0].unknown.count == traced
    assert np.radians(0.1) == KEPT_RAD


def test_fewer_more_and_no_lights_as_if_each_picture_were_the_first(in_time):
    fresh = renderer_of(load_scene(SHAPES), 48)
    for count in (20, 5, 40, 0, 40, 1):
        lights = turned(0.0, count) if count else LightSet.none()
        for _ in range(2):
            picture = in_time.picture(lights).copy()
        np.testing.assert_allclose(picture, fresh.picture(lights), atol=1e-6)
    fresh.release()


def test_a_state_drawn_again_gives_the_same_picture(in_time):
    in_time.picture(turned(0.0))
    state = in_time.state
    expected = in_time.picture(turned(0.0002)).copy()  # reads what was traced for the lights before
    in_time.picture(turned(1.0))
    in_time.state = state
    assert np.array_equal(in_time.picture(turned(0.0002)), expected)


def test_lights_that_wait_read_what_fits_them_best(in_time, monkeypatch):
    in_time.picture(turned(0.0))
    monkeypatch.setattr("vemlight.renderer.frame_plan.affordable_traces", lambda *_: 4)
    in_time.picture(turned(0.01))
    batch = in_time.plan.batches[0]
    assert batch.unknown.count == 4
    assert len(set(batch.of(batch.every)["map"].tolist())) == 20
    for _ in range(5):
        in_time.picture(turned(0.01))
    assert in_time.plan.batches[0].unknown.count == 0


def test_more_lights_than_layers_are_drawn_in_turns(monkeypatch):
    renderer = renderer_of(load_scene(SHAPES), 32)
    truth = renderer.picture(turned(0.0)).copy()
    monkeypatch.setattr("vemlight.renderer.frame_plan.MAX_CACHE_BYTES", 8 * 32 * 32)
    parts = renderer.picture(turned(0.0))
    assert [batch.every.count for batch in renderer.plan.batches] == [8, 8, 4]
    np.testing.assert_allclose(parts, truth, atol=1e-6)
    renderer.release()


def test_four_samples_are_each_traced(tmp_path):
    text = ABOVE + GROUND + '[[mesh]]\nshape = "box"\nscale = 0.3\nrotate = [0.0, 0.0, 20.0]\nat = [0.0, 0.0, 1.0]\n'
    scene = scene_of(tmp_path, text)
    fine, four = (renderer_of(scene, side, samples=samples) for side, samples in ((128, 1), (32, 16)))
    truth = fine.picture(SLANTED).reshape(32, 4, 32, 4, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(four.picture(SLANTED), truth, atol=0.07)
    live = renderer_of(scene, 32, frame_ms=1e4, samples=16)
    np.testing.assert_allclose(live.picture(SLANTED), four.picture(SLANTED), atol=1e-6)
    for renderer in (fine, four, live):
        renderer.release()


@pytest.mark.parametrize(
    ("wanted", "shadow_map", "on_processor", "embree", "kind"),
    [
        ("auto", None, True, True, "rays"), ("auto", None, False, True, "maps"), ("auto", 256, True, True, "maps"),
        ("auto", None, True, False, None), ("auto", None, False, False, "maps"), ("maps", None, True, True, "maps"),
        ("rays", None, False, True, "rays"), ("rays", None, False, False, None),
    ],
)  # fmt: skip
def test_rays_where_the_processor_draws_and_maps_where_a_gpu_does(wanted, shadow_map, on_processor, embree, kind):
    assert shadows.shadows_of(wanted, shadow_map, on_processor, embree) == kind


def test_without_embree_auto_draws_maps_and_says_so_and_rays_are_refused(monkeypatch, capsys):
    monkeypatch.setattr(shadows, "library", lambda: None)
    renderer = renderer_of(load_scene(SHAPES), 16, shadows="auto")
    renderer.picture(SUN)
    assert renderer.plan.runs(pass_table.SHADOW_MAPS)
    renderer.release()
    (line,) = capsys.readouterr().err.splitlines()
    assert "embreex is not installed" in line
    with pytest.raises(UserError, match="embreex, which is not installed; install it, or choose \"maps\""):
        renderer_of(load_scene(SHAPES), 16)


def test_a_resolution_of_maps_is_refused_where_there_are_none():
    with pytest.raises(ValueError, match="shadow_map is the resolution of maps"):
        Settings(shadows="rays", shadow_map=64)


def sky_light(spread: float, direction: tuple[float, float, float] = (0.0, 0.0, 1.0), light_id: int = 7) -> LightSet:
    """A light of irradiance pi whose directions vary by `spread` rad about one, alike on all sides."""
    d = np.array(direction) / np.linalg.norm(direction)
    c = spread**2 * (np.eye(3) - np.outer(d, d))
    return LightSet.of(np.array([light_id]), d[None], np.full((1, 3), np.pi), c[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]][None])


@pytest.mark.parametrize("frame_ms", [0.0, 1e4])
def test_the_penumbra_of_a_soft_light_is_as_wide_as_its_light(tmp_path, frame_ms):
    # The edge of a plate 1.5 m over the ground, along y at x = 0: of a Gaussian light the ground receives Phi(x / (1.5 m spread)).
    spread, height_m = 0.08, 1.5
    camera = "[camera]\nfrom = [0.0, -3.9, 0.8]\nat = [0.0, 0.0, -0.5]\nfov_y = 10.0\n"
    plate = '[[mesh]]\nshape = "plane"\nscale = 20.0\nat = [-20.0, 0.0, 1.0]\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'
    renderer = renderer_of(scene_of(tmp_path, camera + GROUND + plate), 64, frame_ms=frame_ms, samples=1 if frame_ms else 4)
    row = renderer.picture(sky_light(spread))[31:33, :, 0].mean(axis=0)
    renderer.release()
    x = (np.arange(64) - 31.5) / 32 * np.hypot(3.9, 1.3) * np.tan(np.radians(5.0))
    arriving = np.array([0.5 + 0.5 * math.erf(each / (height_m * spread) / np.sqrt(2)) for each in x])
    concentration = np.sqrt(1 - 2 * spread**2)
    assert np.abs(row - concentration * arriving).max() < 0.1  # 0.08 measured; one of 16 rays is 0.06, and twice the spread would be 0.17
    assert abs(row.mean() / (concentration * arriving).mean() - 1) < 0.03


def test_the_irradiance_of_a_soft_light_falls_beyond_its_horizon(tmp_path):
    text = ABOVE + '[[mesh]]\nshape = "plane"\nscale = 4.0\nmaterial = {diffuse = [1.0, 1.0, 1.0]}\n'
    renderer = renderer_of(scene_of(tmp_path, text), 16)
    low, below = (renderer.picture(sky_light(0.2, (1.0, 0.0, height)))[8, 8, 0] for height in (0.0, -0.2))
    renderer.release()
    assert low == pytest.approx(np.sqrt(1 - 2 * 0.2**2) * 0.2 / np.sqrt(2 * np.pi), rel=0.12)  # the mean of what is above, by a box
    assert 0 < below < low


def test_a_kept_soft_light_is_traced_again_when_it_widens(in_time):
    in_time.picture(sky_light(0.1))
    for spread, traced in ((0.1, 0), (0.11, 0), (0.2, 1)):
        in_time.picture(sky_light(spread))
        assert in_time.plan.batches[0].unknown.count == traced


def test_a_still_soft_picture_is_still_and_drawn_again_the_same(in_time):
    first = in_time.picture(sky_light(0.2, (0.3, 0.2, 1.0))).copy()
    state = in_time.state
    assert np.array_equal(in_time.picture(sky_light(0.2, (0.3, 0.2, 1.0))), first)
    in_time.picture(sky_light(0.4, (-0.3, 0.2, 1.0)))
    in_time.state = state
    assert np.array_equal(in_time.picture(sky_light(0.2, (0.3, 0.2, 1.0))), first)
