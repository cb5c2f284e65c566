"""One bounce: closed forms, what a shadow ray stands for, what sends light on, and when a frame has it."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.gltf_files import TexturedSquare
from tests.support.light_sets import lights_from, uniform_lights
from tests.support.rendering import SceneRenderer
from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer import pass_table
from vemlight.renderer.frame import PlatePicture
from vemlight.renderer.frame_budget import LATE, MIN_LIGHTS, Budget, CostModel, MapDemand, bounce_affordable
from vemlight.renderer.passes.bounce import bounce as bounce_pass
from vemlight.renderer.rays.hits import PATTERN, hemisphere_pattern
from vemlight.renderer.rays.reflecting import REDUCED, reflecting_meshes
from vemlight.renderer.scene.scene import Scene, load_scene
from vemlight.settings import Renderer as Settings

CAMERA = "[camera]\nfrom = [{x}, {y}, {z}]\nat = [{u}, {v}, {w}]\nfov_y = 20.0\n"
# A wall in the plane x = 0 that is seen from +x, and a wide ground before it.
CORNER = """
[[mesh]]
name = "wall"
shape = "plane"
scale = 1.0
rotate = [0.0, 90.0, 0.0]
at = [0.0, 0.0, 1.0]
material = {diffuse = [0.5, 0.5, 0.5]}
[[mesh]]
name = "ground"
shape = "plane"
scale = 400.0
at = [400.0, 0.0, 0.0]
material = {diffuse = [0.8, 0.4, 0.2]}
"""
FACING_WALL = CAMERA.format(x=6.0, y=0.0, z=1.0, u=0.0, v=0.0, w=1.0)
SUN = lights_from(np.array([0.0, 0.0, 1.0]))


def scene_of(folder: Path, text: str) -> Scene:
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml")


def renderer_of(scene: Scene, bounces: int = 1, samples: int = 1, shadows: str = "rays") -> SceneRenderer:
    settings = Settings(width=32, height=32, shadows=shadows, bounces=bounces, frame_ms=0.0)  # type: ignore[arg-type]
    return SceneRenderer(scene, settings, samples)


def added(scene: Scene, lights: LightSet, near: NearLightSet | None = None, **options) -> np.ndarray:
    """What the bounce adds to a picture, (height, width, 3)."""
    pictures = []
    for bounces in (0, 1):
        renderer = renderer_of(scene, bounces, **options)
        renderer.near = near or NearLightSet.empty()
        pictures.append(renderer.picture(lights)[..., :3])
        renderer.release()
    return pictures[1] - pictures[0]


@pytest.mark.parametrize("rays", [16, 64])
def test_directions_are_spread_in_proportion_to_their_cosine(rays):
    directions = hemisphere_pattern(rays).astype(float)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-6)
    for own, off in (*((own, 0.5 / rays**0.5) for own in directions), (directions.reshape(-1, 3), 0.02)):  # each set, and all together
        np.testing.assert_allclose(own[:, 2].mean(), 2 / 3, atol=off)
        np.testing.assert_allclose((own[:, :2] ** 2).mean(axis=0), 1 / 4, atol=off)
        np.testing.assert_allclose(own[:, :2].mean(axis=0), 0, atol=off)
    assert len(directions) == PATTERN**2


def test_a_wall_before_a_wide_lit_ground_has_half_of_its_radiosity(tmp_path):
    scene = scene_of(tmp_path, FACING_WALL + CORNER)
    ground = np.array([0.8, 0.4, 0.2]) * SUN.irradiance[0]  # the ground's radiosity
    expected = 0.5 / np.pi * 0.5 * ground  # the wall's albedo over pi times half of that
    inner = added(scene, SUN)[12:20, 12:20]
    np.testing.assert_allclose(inner.mean(axis=(0, 1)), expected, rtol=0.02)
    np.testing.assert_allclose(inner, np.broadcast_to(expected, inner.shape), rtol=0.12)


@pytest.mark.parametrize(("height_m", "rms"), [(0.02, 0.4), (1.0, 0.08)])
def test_a_lamp_beside_the_ground_lights_the_wall_from_its_spot_without_sparks(tmp_path, height_m, rms):
    """The wall receives the integral over the ground, also of a spot that few of its rays meet; by points it is up to 17 times that."""
    near = NearLightSet.of(np.zeros(1), np.array([[1.3, -0.4, height_m]]), np.full((1, 3), 2.0), np.zeros(1), np.zeros(1))
    inner = added(scene_of(tmp_path, FACING_WALL + CORNER), LightSet.none(), near)[4:28, 4:28, 0]
    side = 2 * ((np.arange(4, 28) + 0.5) / 32 - 0.5) * 6.0 * np.tan(np.radians(10.0))
    wall_y, wall_z = (grid[..., None, None] for grid in np.meshgrid(side, 1 - side))
    # Within h sqrt(1 / (1 - t)^2 - 1) of the lamp's foot lies a part t of what a plane receives, which is 2 pi I: rings of equal light.
    t, turn = (np.arange(400) + 0.5) / 400, 2 * np.pi * (np.arange(64) + 0.5) / 64
    radius = height_m * np.sqrt(1 / (1 - t) ** 2 - 1)
    x, y = 1.3 + radius[:, None] * np.cos(turn), -0.4 + radius[:, None] * np.sin(turn)
    square = x**2 + (y - wall_y) ** 2 + wall_z**2
    received = 2 * np.pi * 2.0 * 0.8 / np.pi * (np.maximum(x, 0) * wall_z / square**2).mean(axis=(-1, -2))
    expected = 0.5 / np.pi * received
    assert np.sqrt(np.mean((inner - expected) ** 2)) < rms * expected.mean()
    assert (inner / expected).max() < 1.5


def test_what_lies_in_shadow_sends_nothing(tmp_path):
    roof = '[[mesh]]\nname = "roof"\nshape = "plane"\nscale = 900.0\nat = [0.0, 0.0, 50.0]\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'
    assert np.abs(added(scene_of(tmp_path, FACING_WALL + CORNER + roof), SUN)).max() == 0


def test_shadow_rays_to_some_of_the_lights_stand_for_all(tmp_path, monkeypatch):
    scene, lights = scene_of(tmp_path, FACING_WALL + CORNER), uniform_lights(60, 0.0)
    monkeypatch.setattr(bounce_pass, "STILL_SHADOW_RAYS", 60)
    whole = added(scene, lights)
    monkeypatch.setattr(bounce_pass, "STILL_SHADOW_RAYS", 2)
    some = added(scene, lights)
    assert whole.mean() > 0.01
    np.testing.assert_allclose(some.mean(), whole.mean(), rtol=0.02)
    assert not np.array_equal(some, whole)


def test_a_live_bounce_has_as_many_blocks_whatever_the_size():
    assert [bounce_pass.block_side(size, True) for size in ((160, 120), (320, 240), (640, 360), (1280, 960))] == [4, 4, 7, 16]
    assert bounce_pass.block_side((1280, 960), False) == 4


def test_pictures_of_the_same_light_are_the_same(tmp_path):
    renderer = renderer_of(scene_of(tmp_path, FACING_WALL + CORNER))
    first = renderer.picture(uniform_lights(60, 0.0))
    renderer.picture(SUN)
    again = renderer.picture(uniform_lights(60, 0.0))
    renderer.release()
    np.testing.assert_array_equal(first, again)


LOOKING_DOWN = "[camera]\nfrom = [0.0, 0.0, 1.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 20.0\n"
FLOOR = '[[mesh]]\nname = "floor"\nshape = "plane"\nscale = 5.0\nmaterial = {diffuse = [0.5, 0.5, 0.5]}\n'
CEILING = '[[mesh]]\nname = "ceiling"\nfile = "ceiling.gltf"\ny_up = false\nscale = 600.0\nat = [0.0, 0.0, 1.5]\n'


def under(ceiling: TexturedSquare, folder: Path, floor: str = FLOOR) -> np.ndarray:
    """What a floor without other light receives from a wide ceiling above it, over what an even ceiling of radiance 1 would send."""
    ceiling.write(folder / "ceiling.gltf")
    return added(scene_of(folder, LOOKING_DOWN + floor + CEILING), LightSet.none()).mean(axis=(0, 1)) / 0.5


def test_what_emits_lights_its_surroundings(tmp_path):
    np.testing.assert_allclose(under(TexturedSquare(emissiveFactor=[1.0, 0.5, 0.25]), tmp_path), [1.0, 0.5, 0.25], rtol=2e-3)


def test_an_emissive_texture_lights_with_its_own_colours(tmp_path):
    square = TexturedSquare(emissiveFactor=[1.0, 1.0, 1.0])
    pixels = np.zeros((4, 4, 3), np.uint8)
    pixels[:, :, 0] = 255  # red everywhere, green in one half: the floor's middle is below the border
    pixels[:, 2:, 1] = 255
    square.material["emissiveTexture"] = square.image(pixels)
    np.testing.assert_allclose(under(square, tmp_path), [1.0, 0.5, 0.0], atol=0.03)


def test_an_unlit_surface_sends_its_colour_times_its_vertices(tmp_path):
    square = TexturedSquare(pbrMetallicRoughness={"baseColorFactor": [1.0, 0.5, 0.5, 1.0]}, extensions={"KHR_materials_unlit": {}})
    square.attribute("COLOR_0", np.tile(np.array([[0.5, 1.0, 1.0]], np.float32), (4, 1)))
    square.document["extensionsUsed"] = ["KHR_materials_unlit"]
    np.testing.assert_allclose(under(square, tmp_path), [0.5, 0.5, 0.5], rtol=2e-3)


def test_holes_send_nothing(tmp_path):
    square = TexturedSquare(emissiveFactor=[1.0, 1.0, 1.0], alphaMode="MASK")
    pixels = np.full((4, 4, 4), 255, np.uint8)
    pixels[:, 2:, 3] = 0
    square.material["pbrMetallicRoughness"] = {"baseColorTexture": square.image(pixels)}
    np.testing.assert_allclose(under(square, tmp_path), [0.5, 0.5, 0.5], atol=0.03)


def test_a_catcher_receives_and_under_light_from_above_alone_does_not_send(tmp_path):
    catcher = '[[mesh]]\nshape = "plane"\nscale = 5.0\nmaterial = {catcher = true}\n'
    TexturedSquare(emissiveFactor=[1.0, 1.0, 1.0]).write(tmp_path / "ceiling.gltf")
    renderer = renderer_of(scene_of(tmp_path, LOOKING_DOWN + catcher + CEILING))
    renderer.plate = PlatePicture(np.full((4, 4, 3), 0.25, np.float16))
    picture = renderer.picture(SUN)
    renderer.release()
    # The ceiling keeps all of the sun from it, and brings pi times its radiance in place of the sun's irradiance.
    np.testing.assert_allclose(picture[..., :3], 0.25 * np.pi / SUN.irradiance[0, 1], rtol=0.01)
    ball = '[[mesh]]\nname = "ball"\nshape = "sphere"\nscale = 0.2\nat = [0.0, 0.0, 0.3]\nmaterial = {diffuse = [0.5, 0.5, 0.5]}\n'
    assert np.abs(added(scene_of(tmp_path, LOOKING_DOWN + catcher + ball), SUN)[14:18, 14:18]).max() == 0


def two_hemispheres(up: list[float]) -> LightSet:
    """A sky of lights of the same strength and below it a ground of lights that are `up` times as strong."""
    lights = uniform_lights(400, -1.0)
    below = lights.directions[:, 2:] < 0
    return lights._replace(irradiance=np.where(below, lights.irradiance * np.array(up), lights.irradiance).astype(np.float32))


def test_a_catcher_sends_what_the_light_from_below_says_of_its_ground(tmp_path):
    albedo, lights = np.array([0.4, 0.2, 0.1]), two_hemispheres([0.4, 0.2, 0.1])
    normal = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(bounce_pass.ground_albedo(normal, lights), albedo, rtol=0.02)
    np.testing.assert_array_equal(bounce_pass.ground_albedo(None, lights), 0)
    np.testing.assert_array_equal(bounce_pass.ground_albedo(normal, lights_from(-normal)), 0)  # nothing falls on it
    np.testing.assert_array_equal(bounce_pass.ground_albedo(normal, two_hemispheres([3.0, 3.0, 3.0])), 1)
    _, wall, ground = CORNER.split("[[mesh]]")
    grounds = {"real": "diffuse = [0.4, 0.2, 0.1]", "caught": "catcher = true"}
    received = {}
    for name, material in grounds.items():
        text = f"{FACING_WALL}[[mesh]]{wall}[[mesh]]{ground}".replace("diffuse = [0.8, 0.4, 0.2]", material)
        received[name] = added(scene_of(tmp_path, text), lights)
    np.testing.assert_allclose(received["caught"][12:20, 12:20], received["real"][12:20, 12:20], rtol=0.02)
    assert received["real"][12:20, 12:20].min() > 0.01


def test_a_metal_sends_its_colour_and_a_dielectric_its_reflectance_too(tmp_path):
    text = LOOKING_DOWN + "".join(
        f'[[mesh]]\nname = "{name}"\nshape = "plane"\nmaterial = {{{material}}}\n'
        for name, material in {
            "metal": "base_color = [0.9, 0.5, 0.3], metallic = 1.0",
            "dielectric": "base_color = [0.5, 0.0, 1.0]",
            "phong": "diffuse = [0.5, 0.2, 0.0], specular = [0.3, 0.3, 0.3]",
        }.items()
    )
    meshes = reflecting_meshes(scene_of(tmp_path, text))
    metallic = meshes.metallic[:, None]
    r = meshes.reflectance * (1 - metallic) + metallic * meshes.colour
    reflected = r + (1 - r) * (1 - metallic) * meshes.colour
    np.testing.assert_allclose(reflected, [[0.9, 0.5, 0.3], [0.52, 0.04, 1.0], [0.8, 0.5, 0.3]], atol=1e-6)


def test_a_reduced_texture_keeps_its_mean(tmp_path):
    square = TexturedSquare()
    pixels = np.random.default_rng(0).integers(0, 256, (200, 131, 3)).astype(np.uint8)
    square.material["pbrMetallicRoughness"] = {"baseColorTexture": square.image(pixels)}
    square.write(tmp_path / "ceiling.gltf")
    scene = scene_of(tmp_path, LOOKING_DOWN + CEILING)
    meshes = reflecting_meshes(scene)
    first, rows, columns, *_ = meshes.textures[0]
    assert (first, rows, columns) == (0, REDUCED, REDUCED)
    texels = scene.meshes[0].material.colour_map.texels.astype(float)  # type: ignore[union-attr]
    np.testing.assert_allclose(meshes.texels.mean(axis=0), texels.mean(axis=(0, 1)), rtol=0.01)


@pytest.mark.parametrize("roughness", [0.3, 0.6])  # by rays of its own, and by the blocks'
def test_metal_shows_the_ground_below(tmp_path, roughness):
    text = CAMERA.format(x=0.0, y=-4.0, z=1.0, u=0.0, v=0.0, w=1.0) + (
        '[[mesh]]\nname = "ball"\nshape = "sphere"\nscale = 0.5\nat = [0.0, 0.0, 1.0]\n'
        f"material = {{base_color = [1.0, 1.0, 1.0], metallic = 1.0, roughness = {roughness}}}\n"
        '[[mesh]]\nname = "ground"\nshape = "plane"\nscale = 300.0\nmaterial = {diffuse = [0.6, 0.6, 0.6]}\n'
    )
    picture = added(scene_of(tmp_path, text), SUN)[..., 1]
    ground = 0.6 / np.pi * SUN.irradiance[0, 1]
    assert picture[21, 16] == pytest.approx(ground, rel=0.15)  # the lower half mirrors the ground
    assert picture[9, 16] < 0.2 * ground  # the upper half the sky


def test_frames_have_a_bounce_where_shadows_are_by_rays_and_it_is_wanted(tmp_path):
    scene = scene_of(tmp_path, FACING_WALL + CORNER)
    for bounces, shadows, has in ((1, "rays", True), (0, "rays", False), (1, "maps", False)):
        renderer = renderer_of(scene, bounces, shadows=shadows)
        assert renderer.renderer.setup.bounces == has
        timings = renderer.frame(SUN).timings
        assert ("bounce" in timings.timers_ms) == has or not timings.timers_ms
        renderer.release()


def test_a_live_frame_gives_up_the_bounce_when_the_fewest_lights_leave_no_time_for_it():
    costs = CostModel(fixed_ms=40.0, light_ms=1.0, lookup_ms=0.0, bounce_ms=30.0, frames=10)
    needed_ms = 70.0 + MIN_LIGHTS
    assert bounce_affordable(Budget(needed_ms + 1, costs, MapDemand()))
    assert not bounce_affordable(Budget(needed_ms - 1, costs, MapDemand()))
    # Where it was drawn before, a frame may be a little late for it.
    assert bounce_affordable(Budget(needed_ms - 1, costs, MapDemand(), bounce=True))
    assert not bounce_affordable(Budget(needed_ms / LATE - 1, costs, MapDemand(), bounce=True))


def test_a_bounce_is_gathered_once_for_all_samples(tmp_path):
    renderer = renderer_of(scene_of(tmp_path, FACING_WALL + CORNER), samples=4)
    gathered: list[int] = []
    bounce = renderer.renderer._interreflection._bounce
    assert bounce
    original = bounce.gather
    bounce.gather = lambda *of: (gathered.append(1), original(*of))  # type: ignore[method-assign]
    picture = renderer.picture(SUN)
    renderer.release()
    assert len(gathered) == 1
    np.testing.assert_allclose(picture[12:20, 12:20, 1].mean(), 0.25 / np.pi * 0.4 * SUN.irradiance[0, 1], rtol=0.03)
    assert pass_table.BOUNCE in pass_table.PASSES
