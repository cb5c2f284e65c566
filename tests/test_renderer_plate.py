"""The renderer's plate and its catchers of shadows."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.rendering import SceneRenderer
from vemlight.errors import UserError
from vemlight.light.images import write_exr, write_png
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles
from vemlight.renderer.frame import PlatePicture
from vemlight.renderer.scene.plate_table import PlateTable, load_plate
from vemlight.renderer.scene.scene import load_scene
from vemlight.settings import Renderer as Settings

CAMERA = "[camera]\nfrom = [0.0, -6.0, 4.0]\nat = [0.0, 0.0, 0.2]\nfov_y = 40.0\n"
BOX = '[[mesh]]\nshape = "box"\nscale = 0.4\nat = [0.0, 0.0, 0.4]\n'
CATCHER = '[[mesh]]\nshape = "plane"\nscale = 20.0\nmaterial = {catcher = true}\n'
REAL = '[[mesh]]\nshape = "plane"\nscale = 20.0\nmaterial = {diffuse = [0.5, 0.5, 0.5]}\n'


def drawn(folder: Path, text: str, lights: LightSet, **settings) -> np.ndarray:
    (folder / "scene.toml").write_text(CAMERA + text)
    drawing = Settings(**{"width": 64, "height": 48, "shadow_map": 128, **settings})
    renderer = SceneRenderer(load_scene(folder / "scene.toml"), drawing, samples=4)
    picture = renderer.picture(lights).copy()
    renderer.release()
    return picture


def some_lights(count: int) -> LightSet:
    k = np.arange(count) + 0.5
    irradiance = np.random.default_rng(2).uniform(0, 1, (count, 1)) * np.ones(3)
    return LightSet.of(k, direction_from_angles(np.arccos(k / count), k * 2.4), irradiance)


@pytest.mark.parametrize("count", [1, 12])
def test_a_catcher_darkens_the_plate_as_a_real_ground_would_be_darkened(tmp_path, count):
    lights = some_lights(count)
    real, empty = drawn(tmp_path, REAL + BOX, lights), drawn(tmp_path, REAL, lights)
    caught = drawn(tmp_path, CATCHER + BOX, lights)
    ground = (np.abs(real[..., 3] - 1) < 1e-6) & ~caught[..., :3].any(axis=-1)  # where no part of the box is seen
    assert ground.sum() > 500
    left = real[ground][:, 0] / empty[ground][:, 0]
    assert np.abs((1 - caught[ground][:, 3]) - left).max() < 2e-3
    assert caught[ground][:, 3].max() > 0.3 / count


def test_the_plate_lies_behind_everything(tmp_path):
    pixels = np.random.default_rng(1).uniform(0, 2, (48, 64, 3)).astype(np.float32)
    write_exr(tmp_path / "plate.exr", pixels)
    lights = some_lights(5)
    over = drawn(tmp_path, CATCHER + BOX + '[plate]\nfile = "plate.exr"\nstops = 1.0', lights)
    alone = drawn(tmp_path, CATCHER + BOX, lights)
    assert np.all(over[..., 3] == 1)
    # half floats keep 11 bits of the plate
    assert np.allclose(over[..., :3], alone[..., :3] + 2 * pixels * (1 - alone[..., 3:]), rtol=2e-3, atol=1e-4)


def test_a_plate_as_png_is_taken_to_linear_light_upright(tmp_path):
    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0] = 188
    write_png(tmp_path / "plate.png", pixels)
    picture = drawn(tmp_path, CATCHER + '[plate]\nfile = "plate.png"', some_lights(1))
    assert np.allclose(picture[0, :, :3], 0.503, atol=2e-3)
    assert not picture[-1, :, :3].any()


@pytest.mark.parametrize(("name", "stops", "radiance"), [("plate.png", 15.0, 2.0**15), ("plate.png", 20.0, 6e4), ("plate.exr", 20.0, 6e4)])
def test_a_plate_is_as_bright_as_half_floats_allow(tmp_path, name, stops, radiance):
    write_png(tmp_path / "plate.png", np.full((2, 2, 3), 255, np.uint8))
    write_exr(tmp_path / "plate.exr", np.full((2, 2, 3), 1.0, np.float32))
    plate = load_plate(PlateTable(file=name, stops=stops), tmp_path, "here")
    assert np.all(plate == np.float16(radiance))


def test_shadows_on_the_plate_are_dark_in_the_colours_that_they_lack(tmp_path):
    red, blue = ([0.6, 0.0, 0.8], [0.9, 0.1, 0.0]), ([-0.6, 0.0, 0.8], [0.1, 0.3, 0.9])
    lights = LightSet.of(np.arange(2), np.array([red[0], blue[0]]), np.array([red[1], blue[1]]))
    real, empty = drawn(tmp_path, REAL + BOX, lights), drawn(tmp_path, REAL, lights)
    write_exr(tmp_path / "plate.exr", np.full((4, 4, 3), 0.5, np.float32))
    caught = drawn(tmp_path, CATCHER + BOX, lights)
    over = drawn(tmp_path, CATCHER + BOX + '[plate]\nfile = "plate.exr"', lights)
    ground = (np.abs(real[..., 3] - 1) < 1e-6) & ~caught[..., :3].any(axis=-1)
    left = real[ground][:, :3] / empty[ground][:, :3]
    assert np.ptp(left, axis=1).max() > 0.5  # the two shadows have different colours
    assert np.abs(over[ground][:, :3] - 0.5 * left).max() < 2e-3
    assert np.all(over[..., 3] == 1)


@pytest.mark.parametrize(("shadows", "power"), [("maps", 1e-3), ("traced", 1e-3)])
def test_a_lamp_brightens_the_plate_by_its_fraction_of_the_light(tmp_path, shadows, power):
    lamp = f'[[luminaire]]\nat = [0.5, 0.0, 1.5]\nrotate = [180.0, 0.0, 0.0]\npower = {power}\nshadows = "{shadows}"\n'
    lights = some_lights(3)
    real, empty = drawn(tmp_path, REAL + BOX + lamp, lights), drawn(tmp_path, REAL, lights)
    write_exr(tmp_path / "plate.exr", np.full((4, 4, 3), 0.5, np.float32))
    over = drawn(tmp_path, CATCHER + BOX + lamp + '[plate]\nfile = "plate.exr"', lights)
    alone = drawn(tmp_path, CATCHER + BOX + lamp, lights)
    ground = (np.abs(real[..., 3] - 1) < 1e-6) & ~alone[..., :3].any(axis=-1)
    ratio = real[ground][:, :3] / empty[ground][:, :3]
    assert 1.2 < ratio.max() < 20
    assert np.abs(over[ground][:, :3] / (0.5 * ratio) - 1).max() < 5e-3
    assert alone[..., 3].max() <= 1 + 1e-6  # without a plate a lamp's light on the ground is left out


def test_a_plate_is_replaced_while_it_runs(tmp_path):
    (tmp_path / "scene.toml").write_text(CAMERA + CATCHER)
    renderer = SceneRenderer(load_scene(tmp_path / "scene.toml"), Settings(width=64, height=48, shadow_map=128))
    none = LightSet.none()
    assert not renderer.picture(none).any()
    random = np.random.default_rng(3)
    for height, width in ((48, 64), (24, 32), (96, 128), (96, 128)):
        code = random.integers(0, 256, (3,))
        renderer.plate = PlatePicture(np.broadcast_to(code, (height, width, 3)).astype(np.uint8), 1.0)
        linear = np.where(code <= 10, code / 255 / 12.92, ((code / 255 + 0.055) / 1.055) ** 2.4)
        # a GL may keep 8-bit sRGB texels at 12 bits while it filters
        assert np.allclose(renderer.picture(none), [*(2 * linear), 1], rtol=0.01, atol=1e-3)
    half = np.zeros((48, 64, 3), np.uint8)
    half[:24] = 255
    renderer.plate = PlatePicture(half)
    picture = renderer.picture(none)
    assert np.allclose(picture[:24, :, :3], 1, atol=1e-3)
    assert not picture[24:, :, :3].any()
    renderer.release()


def test_without_light_a_catcher_is_clear(tmp_path):
    dark = some_lights(3)._replace(irradiance=np.zeros((3, 3), np.float32))
    assert drawn(tmp_path, CATCHER, dark).max() == 0


def test_a_target_frame_time_catches_the_same_shadows(tmp_path):
    lights = some_lights(6)
    assert np.allclose(drawn(tmp_path, CATCHER + BOX, lights, frame_ms=1e4), drawn(tmp_path, CATCHER + BOX, lights), atol=2e-2)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (CATCHER + CATCHER, "join them"),
        ('[[mesh]]\nshape = "sphere"\nmaterial = {catcher = true}', "not flat"),
        ('[[mesh]]\nshape = "plane"\nmaterial = {catcher = true, diffuse = [0.1, 0.1, 0.1]}', "no colour"),
        (CATCHER + '[plate]\nfile = "absent.png"', "absent.png"),
        (CATCHER + '[plate]\nfile = "absent.exr"', "absent.exr"),
        (CATCHER + '[plate]\nfile = "plate.gif"', "convert it"),
    ],
)
def test_bad_catchers_and_plates_are_named(tmp_path, text, words):
    (tmp_path / "scene.toml").write_text(CAMERA + text)
    with pytest.raises(UserError, match=words):
        load_scene(tmp_path / "scene.toml")
