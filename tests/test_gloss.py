from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.rendering import SceneRenderer
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.passes.gloss.gloss import CONE, MAX_GLOSS_LIGHTS, NEIGHBOURS, gloss_rows, spread
from vemlight.renderer.passes.lights.light_regions import light_regions
from vemlight.renderer.passes.shadow_maps import shadow_map_plan
from vemlight.renderer.scene.scene import load_scene
from vemlight.renderer.scene.view import ray_from_pixel
from vemlight.renderer.stage import RendererStage
from vemlight.runtime import wire
from vemlight.settings import Renderer as Settings
from vemlight.settings import Settings as AllSettings

CAMERA = "[camera]\nfrom = [0.0, -6.0, 3.0]\nat = [0.0, 0.0, 0.4]\nfov_y = 30.0\n"
METAL = "material = {base_color = [1.0, 1.0, 1.0], metallic = 1.0, roughness = 0.25}"
PHONG = "material = {diffuse = [0.3, 0.3, 0.3], specular = [0.6, 0.5, 0.4], exponent = 60.0}"
SPHERE = '[[mesh]]\nshape = "sphere"\nscale = 0.6\nat = [0.0, 0.0, 0.8]\n'
GROUND = '[[mesh]]\nshape = "plane"\nscale = 3.0\n'


def pictures(folder: Path, text: str, *sets: tuple[LightSet, LightSet | None], **wanted) -> list[np.ndarray]:
    (folder / "scene.toml").write_text(CAMERA + text)
    renderer = SceneRenderer(load_scene(folder / "scene.toml"), Settings(**{"width": 64, "height": 64, "shadow_map": 128, **wanted}))
    made = [renderer.picture(*pair).copy() for pair in sets]
    renderer.release()
    return made


def sky(count: int, lowest_z: float = 0.0) -> LightSet:
    """Radiance 1 from all directions above lowest_z."""
    z = lowest_z + (1 - lowest_z) * (np.arange(count) + 0.5) / count
    directions = direction_from_angles(np.arccos(z), np.arange(count) * np.pi * (3 - np.sqrt(5)))
    return LightSet.of(np.arange(count), directions, np.full((count, 3), 2 * np.pi * (1 - lowest_z) / count))


def random_lights(count: int, seed: int) -> LightSet:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3)) * [1, 1, 1] + [0, 0, 1]
    return LightSet.of(np.arange(count), directions / np.linalg.norm(directions, axis=1, keepdims=True), rng.uniform(0, 1, (count, 3)))


@pytest.mark.parametrize("frame_ms", [0.0, 1e4])
@pytest.mark.parametrize("material", [METAL, PHONG])
def test_a_second_set_like_the_first_changes_nothing(tmp_path, material, frame_ms):
    # no more lights than neighbours are asked for, and so without a spread
    for seed in range(6):
        lights = random_lights(NEIGHBOURS, seed)
        one, two = pictures(tmp_path, SPHERE + material + "\n" + GROUND + material, (lights, None), (lights, lights), frame_ms=frame_ms)
        assert one[..., :3].max() > 0.1
        # two orders of float32 sums; with a target frame time lookups are kept in 8 bits, and the second set looks at the maps itself
        assert np.allclose(one, two, rtol=1e-4, atol=one[..., :3].max() * (1 / 255 if frame_ms else 1e-5))


def test_more_strong_lights_than_the_atlas_holds_share_their_cones_too(tmp_path, monkeypatch):
    lights = random_lights(NEIGHBOURS, 3)
    monkeypatch.setattr(shadow_map_plan, "MAX_ATLAS_SIDE", 256)  # 2 x 2 tiles of 128
    many = LightSet.of(np.arange(12), np.repeat(lights.directions, 3, axis=0), np.repeat(lights.irradiance, 3, axis=0) / 3)
    one, two = pictures(tmp_path, SPHERE + METAL, (lights, None), (many._replace(ids=np.arange(12)), lights))
    inside = one[..., 3] > 0
    # the first four of twelve hold two of the directions: a sphere alone has no shadow but its own terminator
    assert np.mean(np.abs(one - two)[inside].max(axis=-1) > 0.02 * one.max()) < 0.02


@pytest.mark.parametrize("roughness", [0.1, 0.2, 0.3, 0.45, 0.6, 1.0])
def test_a_white_furnace_stays_white_with_two_sets(tmp_path, roughness):
    sphere = SPHERE.replace("0.6", "1.2").replace("0.8", "0.4") + METAL.replace("0.25", str(roughness))
    one, both = pictures(tmp_path, sphere, (sky(3000, -1.0), None), (sky(100, -1.0), sky(1500, -1.0)), width=48, height=48)
    inside = np.hypot(*np.indices((48, 48)) - 23.5) < 11  # 70 % of its radius: farther out a pixel holds many normals
    assert one[inside][:, 3].min() == 1
    if roughness > 0.4:
        assert both[inside].mean(axis=0) == pytest.approx(one[inside].mean(axis=0), rel=0.01)
    else:
        # single bounces of smooth metal lose up to 3 %; lobes wider than the cone's core leave 2 % to the 100 lights
        assert both[inside][:, :3].mean() == pytest.approx(1, abs=0.05)
        dots = [np.std(image[inside][:, 0]) for image in pictures(tmp_path, sphere, (sky(100, -1.0), None), width=48, height=48)]
        assert np.std(both[inside][:, 0]) < 0.3 * dots[0]


def test_lambert_and_wide_lobes_do_not_ask_the_second_set(tmp_path):
    lights, other = random_lights(3, 1), random_lights(3, 2)
    for material in ("material = {diffuse = [0.5, 0.5, 0.5]}", METAL.replace("0.25", "0.7"), PHONG.replace("60.0", "3.0")):
        one, two = pictures(tmp_path, SPHERE + material, (lights, None), (lights, other))
        assert np.array_equal(one, two)


@pytest.mark.parametrize("power", [0.0, 1e6])
def test_darkness_and_a_huge_sun(tmp_path, power):
    directions, powers = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, -0.6, 0.8]]), np.array([[power], [1], [0]]) * np.ones(3)
    weak = LightSet.of(np.arange(3), directions, powers)
    strong = LightSet.of(np.arange(2), directions[:2], powers[:2])
    none = LightSet.none()
    for image in pictures(tmp_path, SPHERE + METAL, (strong, weak), (strong, none), (none, weak), (none, none)):
        assert np.all(np.isfinite(image))
        assert image.min() >= 0


def test_a_rows_sum_is_that_of_the_lights_in_reach():
    regions = light_regions(64)
    rng = np.random.default_rng(4)
    # crowded about one direction, with a sun among them, in three tints
    directions = rng.normal(size=(3000, 3)) * 0.3 + [0, 0.6, 0.8]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    irradiance = rng.lognormal(0, 2, (3000, 1)) * rng.uniform(0.5, 1, (3000, 3))
    irradiance[1234] = 1e6
    reach = regions.reach + 0.3
    strong = rng.integers(0, 72, 3000)
    rows = gloss_rows(regions.centres, reach, directions, irradiance, strong)
    within = regions.centres @ directions.T >= np.cos(reach)[:, None]
    assert within.sum(axis=1).max() > MAX_GLOSS_LIGHTS
    assert within.sum(axis=1).min() < MAX_GLOSS_LIGHTS
    of_direction = {tuple(direction): number for direction, number in zip(directions.astype(np.float32).tolist(), strong, strict=True)}
    for span, inside in zip(rows.spans, within, strict=True):
        groups = rows.groups[span["first"] : span["first"] + span["count"]]
        assert np.all(np.diff(groups["shadowing"]) > 0)
        found = [rows.lights[group["first"] : group["first"] + group["count"]] for group in groups]
        for group, own in zip(groups, found, strict=True):
            assert all(of_direction[tuple(direction)] == group["shadowing"] for direction in own["direction"].tolist())
        lights = np.concatenate(found) if found else rows.lights[:0]
        assert len(lights) == min(inside.sum(), MAX_GLOSS_LIGHTS)
        assert np.allclose(lights["irradiance"].sum(axis=0, dtype=np.float64), inside @ irradiance, rtol=1e-5)
        assert np.all(np.isin(lights["direction"][:, 0], directions[inside, 0].astype(np.float32)))
        if inside[1234]:
            assert lights["irradiance"][:, 0].max() == 1e6  # the sun is never scaled
    assert rows.groups["count"].sum() == len(rows.lights)


@settings(deadline=None, max_examples=20)
@given(st.integers(MAX_GLOSS_LIGHTS + 1, 2000))
def test_of_equal_lights_the_first_are_kept_and_scaled_alike(count):
    directions = np.tile([[0.0, 0.0, 1.0]], (count, 1))
    directions[:, 0] = np.arange(count) * 1e-6  # to tell them apart
    rows = gloss_rows(np.array([[0.0, 0.0, 1.0]]), np.array([0.5]), directions, np.ones((count, 3)), np.arange(count))
    assert rows.spans.tolist() == [(0, MAX_GLOSS_LIGHTS)]
    assert np.array_equal(rows.groups["shadowing"], np.arange(MAX_GLOSS_LIGHTS))
    assert np.allclose(rows.lights["irradiance"], count / MAX_GLOSS_LIGHTS)


def test_the_spread_of_an_even_sky_is_that_of_its_cells():
    for count in (100, 1000):
        cell = 2 * np.pi / count  # sr
        found = spread(sky(count).directions.astype(np.float64))
        # a square cell of side a has the half diagonal a / sqrt(2); a spiral's cells are square to some tenths, at the horizon one-sided
        assert np.median(found) == pytest.approx(np.sqrt(cell / 2), rel=0.15)
    assert not spread(sky(NEIGHBOURS).directions).any()


def test_the_stage_draws_the_gloss_set_of_a_message(tmp_path):
    (tmp_path / "scene.toml").write_text(CAMERA + SPHERE + METAL)
    wanted = Settings(scene=str(tmp_path / "scene.toml"), width=64, height=64, shadow_map=128, picture="linear16")
    stage = RendererStage(AllSettings(renderer=wanted))
    strong, weak = random_lights(5, 1), random_lights(40, 2)
    header = wire.LightsMessage(stamp=wire.stamp(0, 0.0), count=5, gloss_count=40, coverage="sphere")
    state, _ = stage.step(stage.start_at(0)[0], (header, (*strong[:3], weak.directions, weak.irradiance)))
    alone, both = pictures(tmp_path, SPHERE + METAL, (strong, None), (strong, weak))
    assert state.picture is not None
    assert np.array_equal(state.picture, both)
    assert not np.allclose(alone, both, atol=1e-3)


@pytest.mark.parametrize("exponent", [300.0, 10_000.0])
def test_a_phong_lobe_is_widened_by_the_variance_of_the_disc_that_a_light_stands_for(tmp_path, exponent):
    # One light of an even sky shines: on a plane seen from above its highlight falls off as cos^n with 1 / n = 1 / exponent + spread^2 / 4.
    lights = sky(1000)
    own = int(np.argmax(lights.directions[:, 2]))
    faint = np.where(np.arange(1000) == own, 1.0, 1e-9)[:, None].astype(np.float32)
    camera = "[camera]\nfrom = [0.0, 0.0, 5.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 10.0\n"
    plane = f'[[mesh]]\nshape = "plane"\nmaterial = {{diffuse = [0.0, 0.0, 0.0], specular = [1.0, 1.0, 1.0], exponent = {exponent}}}\n'
    (tmp_path / "scene.toml").write_text(camera + plane)
    renderer = SceneRenderer(load_scene(tmp_path / "scene.toml"), Settings(width=64, height=64, shadow_map=128))
    shadowed = LightSet.of(np.zeros(1), lights.directions[own : own + 1], np.ones((1, 3)))
    picture = renderer.picture(shadowed, lights._replace(irradiance=faint * np.ones((1, 3), np.float32)))[..., 0].astype(np.float64)
    scene = load_scene(tmp_path / "scene.toml")
    renderer.release()
    pixels = np.stack([*np.meshgrid(np.arange(64) + 0.5, np.arange(64) + 0.5), np.ones((64, 64))], axis=-1)
    rays = pixels @ ray_from_pixel(scene.camera, (64, 64)).T
    mirrored = rays / np.linalg.norm(rays, axis=-1, keepdims=True) * [1, 1, -1] @ lights.directions[own].astype(np.float64)
    near = mirrored > np.cos(np.radians(5.0))
    slope = np.polyfit(np.log(mirrored[near]), np.log(picture[near]), 1)[0]
    assert slope == pytest.approx(1 / (1 / exponent + spread(lights.directions)[own] ** 2 / 4), rel=0.02)


def test_the_gloss_set_fades_out_between_12_and_20_degrees():
    # A narrower rim shows as a ring where dots of the shadowed lights begin; a smaller core leaves rough metal's lobe to them.
    inside = np.clip((np.cos(np.radians([11.9, 16.0, 20.1])) - CONE[0]) / (CONE[1] - CONE[0]), 0, 1)
    assert inside.tolist() == pytest.approx([1, 0.56, 0], abs=0.02)
