"""From a file of light to a picture: directions, shadows, and frames that no camera should give."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.lights_files import light_set_from_row, read_lights
from vemlight.capture.lens import Lens, pixel_from_direction, write_lens
from vemlight.capture.source import open_source
from vemlight.commands.offline import write_lights_file
from vemlight.commands.options import LightsOptions, RenderOptions
from vemlight.commands.rendering import write_pictures
from vemlight.light.images import read_radiance, write_exr
from vemlight.light.sphere import angle_between, cell_from_direction, direction_from_angles, latlong_from_direction, map_irradiance
from vemlight.settings import Capture

# Light from theta, phi in degrees; the pole is 1 high, so its shadow is tan(theta) long and stays on the ground.
TOWARDS = [(30.0, 20.0), (45.0, 137.0), (40.0, 251.0), (50.0, 344.0)]
LENS = Lens(size=(256, 256), f=(80.0, 80.0), c=(127.5, 127.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=90.0)


def latlong_file(folder: Path, direction: np.ndarray) -> tuple[Path, float]:
    image = np.zeros((256, 512, 3), np.float32)
    row, column = latlong_from_direction(direction, 256, 512)
    image[int(row), int(column)] = 1000
    write_exr(folder / "spot.exr", image)
    return folder / "spot.exr", np.pi / 256


def polar_file(folder: Path, direction: np.ndarray) -> tuple[Path, float]:
    image = np.zeros((90, 360, 3), np.float32)
    row, column = cell_from_direction(direction, 90, 360, "hemisphere")
    image[int(row), int(column)] = 1000
    write_exr(folder / "spot.exr", image, {"vemlight:kind": "polar", "vemlight:coverage": "hemisphere"})
    return folder / "spot.exr", np.pi / 180


def fisheye_file(folder: Path, direction: np.ndarray) -> tuple[Path, float]:
    image = np.zeros((256, 256, 3), np.float32)
    x, y = pixel_from_direction(direction, LENS)
    image[round(float(y)), round(float(x))] = 1000
    write_exr(folder / "spot.exr", image, {"vemlight:kind": "fisheye"})
    write_lens(folder / "lens.toml", LENS)
    return folder / "spot.exr", 1 / 80


def pole_scene(folder: Path) -> Path:
    """A square pole, 0.04 wide and 1 high, on the ground, seen from above with +Y on top."""
    h = 0.02
    corners = [(x, y, z) for z in (0, 1) for x, y in ((-h, -h), (h, -h), (h, h), (-h, h))]
    faces = [(1, 2, 6, 5), (2, 3, 7, 6), (3, 4, 8, 7), (4, 1, 5, 8), (5, 6, 7, 8)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c} {d}" for a, b, c, d in faces]
    (folder / "pole.obj").write_text("\n".join(lines) + "\n")
    scene = folder / "scene.toml"
    scene.write_text(
        '[camera]\nfrom = [0.0, 0.0, 12.0]\nat = [0.0, 0.0, 0.0]\nfov_y = 24.0\n'
        '[[mesh]]\nshape = "plane"\nscale = 2.4\nmaterial = {diffuse = [0.7, 0.7, 0.7]}\n'
        '[[mesh]]\nfile = "pole.obj"\nmaterial = {diffuse = [0.0, 0.0, 0.0]}\n'
    )
    return scene


@pytest.mark.parametrize("make", [latlong_file, polar_file, fisheye_file])
@pytest.mark.parametrize("towards", TOWARDS)
def test_one_lit_pixel_gives_its_direction_and_the_shadow_on_the_other_side(make, towards, tmp_path):
    theta, phi = np.radians(towards)
    source, width = make(tmp_path, direction_from_angles(theta, phi))
    write_lights_file(LightsOptions(source=source, out=tmp_path / "lights.json", count=1))
    direction = light_set_from_row(read_lights(tmp_path / "lights.json")[0]).directions[0].astype(float)
    assert angle_between(direction, direction_from_angles(theta, phi)) < width

    out, scene = tmp_path / "picture.exr", pole_scene(tmp_path)
    write_pictures(RenderOptions(source=source, scene=scene, size=(240, 240), out=out, count=1))
    picture = read_radiance(tmp_path / "picture.exr")[0][..., 1]
    lit = np.median(picture[picture > 0])
    shadow = np.argwhere(picture[20:-20, 20:-20] < 0.5 * lit) + 20
    x, y = shadow[:, 1] - 119.5, 119.5 - shadow[:, 0]
    far = np.hypot(x, y) > 15  # beyond the pole itself as the camera sees it
    towards_shadow = np.arctan2(y[far].mean(), x[far].mean())
    turn = (towards_shadow - (phi + np.pi) + np.pi) % (2 * np.pi) - np.pi
    assert abs(np.degrees(turn)) < 2.0  # a pixel of 1/25 across at 30 pixels' distance


def test_frames_that_no_camera_should_give(tmp_path):
    """A plain sky, black, nan and inf and negative pixels, and a sun 10^6 times its sky: all pass, and each is what it should be."""
    sky = np.full((64, 128, 3), 0.5, np.float32)
    invalid, sunny = sky.copy(), sky.copy()
    invalid[5, 7], invalid[9, 40], invalid[20, 90] = np.nan, np.inf, -3
    sunny[10, 30] = 0.5e6
    frames = {"sky": sky, "black": 0 * sky, "invalid": invalid, "sunny": sunny}
    for k, (name, image) in enumerate(frames.items()):
        write_exr(tmp_path / f"{k}_{name}.exr", image)
    write_lights_file(LightsOptions(source=tmp_path, out=tmp_path / "lights.jsonl", count=32, filter="none"))
    lights = [light_set_from_row(row) for row in read_lights(tmp_path / "lights.jsonl")]
    source = open_source(Capture(source=str(tmp_path)))
    for k, found in enumerate(lights):
        radiance = source.frame(k).radiance
        good = np.isfinite(radiance) & (radiance >= 0)
        expected = map_irradiance(np.where(good, radiance, 0), "hemisphere")
        np.testing.assert_allclose(found.irradiance.sum(axis=0, dtype=float), expected, rtol=1e-3, atol=1e-12)
        assert np.isfinite(found.directions).all()
        np.testing.assert_allclose(np.linalg.norm(found.directions, axis=1), 1, atol=1e-5)
        assert (found.directions[:, 2] >= 0).all()
    (tmp_path / "out").mkdir()
    write_pictures(RenderOptions(source=tmp_path, size=(48, 36), out=tmp_path / "out" / "p.exr", count=32, filter="none"))
    pictures = [read_radiance(path)[0] for path in sorted((tmp_path / "out").glob("p_*.exr"))]
    assert all(np.isfinite(picture).all() for picture in pictures)
    assert pictures[1].max() == 0
    assert pictures[3].max() > 100 * pictures[0].max()
    lost = abs(pictures[2].mean() / pictures[0].mean() - 1)
    assert lost < 0.01  # three of 4096 pixels above the horizon, and their neighbours within a cell


def test_five_lamps_give_five_shadows(tmp_path):
    """Equal lamps all round, 35 degrees up: as many dark strokes from the foot of the pole."""
    image = np.zeros((256, 512, 3), np.float32)
    for phi in np.radians([10, 82, 154, 226, 298]):
        row, column = latlong_from_direction(direction_from_angles(np.radians(55), phi), 256, 512)
        image[int(row), int(column)] = 1000
    write_exr(tmp_path / "lamps.exr", image)
    lamps, scene, out = tmp_path / "lamps.exr", pole_scene(tmp_path), tmp_path / "picture.exr"
    write_pictures(RenderOptions(source=lamps, scene=scene, size=(240, 240), out=out, count=60))
    picture = read_radiance(tmp_path / "picture.exr")[0][..., 1]
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    radius = np.arange(40, 50)[:, None]
    rows, cols = np.rint(119.5 - radius * np.sin(angle)).astype(int), np.rint(119.5 + radius * np.cos(angle)).astype(int)
    ring = np.median(picture[rows, cols], axis=0)
    dark = ring < 0.9 * np.median(ring)  # one lamp of five gone takes a fifth
    starts = np.flatnonzero(dark & ~np.roll(dark, 1))
    assert len(starts) == 5
    turns = (np.degrees(angle[starts]) - np.array([82, 154, 226, 298, 10]).reshape(-1, 1)) % 360
    assert all(np.abs(turns[:, k] - 180).min() < 6 for k in range(5))
