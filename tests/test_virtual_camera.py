"""The virtual camera, and the way back from its frames."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from vemlight.capture.lens import Lens, direction_from_pixel, pixel_solid_angles
from vemlight.capture.response import Log, Response
from vemlight.capture.simulation.environment import Environment, SunDisc
from vemlight.capture.simulation.optics import fisheye_radiance
from vemlight.capture.simulation.sensor import VirtualCamera
from vemlight.capture.simulation.simulate import Lighting, simulate
from vemlight.capture.source import Frame, open_source
from vemlight.errors import UserError
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.images import read_radiance, write_exr
from vemlight.light.sphere import (
    angle_between,
    cell_directions,
    cell_solid_angles,
    direction_from_angles,
    latlong_from_direction,
    map_irradiance,
    rotation_xyz,
)
from vemlight.settings import Capture

LENS = Lens(
    size=(240, 240), f=(69.0, 69.0), c=(119.3, 119.8), k1=-0.01, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0, vignetting=(-0.05,)
)
PIXEL = 1 / 69
B = 4095 / np.log(1e9)
LOG = Log(bits=12, a=float(-B * np.log(1e-3)), b=float(B), c=1e-3)
DARK = np.zeros((64, 128, 3))


def flux_centre(image: np.ndarray, lens: Lens) -> np.ndarray:
    """Direction to the centre of an image's light, in camera axes."""
    pixels = np.stack(np.meshgrid(np.arange(lens.size[0]), np.arange(lens.size[1])), -1)
    total = np.einsum("ij,ijc->c", luminance_from_rgb(image) * pixel_solid_angles(lens), direction_from_pixel(pixels, lens))
    return total / np.linalg.norm(total)


def sun_direction(frame: Frame, degrees: float = 4.0) -> np.ndarray:
    """Direction to the centre of the light near the brightest cell."""
    rows, cols, _ = frame.radiance.shape
    directions, y = cell_directions(rows, cols, frame.coverage), luminance_from_rgb(frame.radiance)
    near = directions @ directions[np.unravel_index(int(y.argmax()), y.shape)] > np.cos(np.radians(degrees))
    flux = np.where(near, y, 0) * cell_solid_angles(rows, cols, frame.coverage)[:, None]
    total = np.einsum("ij,ijc->c", flux, directions)
    return total / np.linalg.norm(total)


@pytest.mark.parametrize(("radius_deg", "p1"), [(0.135, 0.0), (0.2665, 0.0), (0.2665, 0.03)])
def test_no_sun_falls_between_the_pixels(radius_deg: float, p1: float) -> None:
    rng = np.random.default_rng(7)
    lens = msgspec.structs.replace(LENS, p1=p1, p2=-p1 / 2)
    for theta, phi in zip(rng.uniform(0, 1.5, 30), rng.uniform(0, 2 * np.pi, 30), strict=True):
        direction = direction_from_angles(theta, phi)
        sun = SunDisc(direction, np.radians(radius_deg), np.array([1.0, 2.0, 3.0]))
        image = fisheye_radiance(Environment(DARK, [sun]), np.eye(3), lens)
        flux = np.einsum("ijc,ij->c", image, pixel_solid_angles(lens))
        np.testing.assert_allclose(flux, [1, 2, 3], rtol=1e-9)
        assert angle_between(flux_centre(image, lens), direction) < 0.75 * PIXEL  # half a pixel along its diagonal


def test_bright_pixel_of_a_map_keeps_its_flux() -> None:
    source = np.ones((64, 128, 3))
    row, col = latlong_from_direction(direction_from_angles(0.8, 1.0), 64, 128)
    source[int(row), int(col)] = 1e6
    even = fisheye_radiance(Environment(np.ones((64, 128, 3)), []), np.eye(3), LENS)
    image = fisheye_radiance(Environment(source, []), np.eye(3), LENS) - even
    solid = (np.cos(int(row) * np.pi / 64) - np.cos((int(row) + 1) * np.pi / 64)) * 2 * np.pi / 128
    flux = np.einsum("ijc,ij->c", image, pixel_solid_angles(LENS))
    # what lies under the level for bright light is gathered by 16 rays a pixel; it is 1e-3 of this source
    np.testing.assert_allclose(flux, (1e6 - 1) * solid, rtol=1e-4)


def test_even_light_gives_an_even_image() -> None:
    image = fisheye_radiance(Environment(np.full((64, 128, 3), 0.3), []), np.eye(3), LENS)
    np.testing.assert_allclose(image[pixel_solid_angles(LENS) > 0], 0.3, rtol=1e-12)
    assert not image[pixel_solid_angles(LENS) == 0].any()


def test_maps_turn_from_x_to_y() -> None:
    quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    sun = SunDisc(np.array([0.8, 0, 0.6]), 0.005, np.ones(3))
    image = fisheye_radiance(Environment(DARK, [sun]), quarter, LENS)
    assert angle_between(flux_centre(image, LENS), np.array([0, 0.8, 0.6])) < PIXEL


@pytest.mark.parametrize("response", [None, LOG], ids=["radiance", "codes"])
@pytest.mark.parametrize("scene", ["sky", "interior"])
def test_simulate_and_back(tmp_path: Path, scene: str, response: Response | None) -> None:
    camera = VirtualCamera(lens=LENS, response=response, noise_codes=0.5, exposure_s=0.002)
    simulate(Lighting(maps=(scene,), rotate_deg_per_frame=30.0), camera, tmp_path, frames=2, seed=1)
    truth = [json.loads(line) for line in (tmp_path / "truth.jsonl").read_text().splitlines()]
    source = open_source(Capture(source=str(tmp_path)))
    assert (len(source), len(truth), source.fps) == (2, 2, 25.0)
    for k, row in enumerate(truth):
        frame = source.frame(k)
        assert frame.time_s == row["time_s"] == k / 25
        np.testing.assert_allclose(row["world_from_map"], rotation_xyz((0, 0, 30 * k)), atol=1e-12)
        np.testing.assert_allclose(map_irradiance(frame.radiance, frame.coverage), row["irradiance"], rtol=0.01)
        if scene == "sky":
            assert angle_between(sun_direction(frame), np.array(row["sun"])) < 0.5 * PIXEL
        assert frame.saturated == 0
    assert (tmp_path / f"{scene}_0001.exr").exists()


def test_files_as_maps(tmp_path: Path) -> None:
    for k, phi in enumerate((0.5, 2.5)):
        image = np.full((64, 128, 3), 0.2, np.float32)
        row, col = latlong_from_direction(direction_from_angles(0.6, phi), 64, 128)
        image[int(row), int(col)] = 500.0
        image[40, 3] = np.nan
        write_exr(tmp_path / f"map{k}.exr", image)
    lighting = Lighting(maps=(str(tmp_path / "map0.exr"), str(tmp_path / "map1.exr")))
    simulate(lighting, VirtualCamera(lens=LENS, response=LOG), tmp_path / "out")
    truth = [json.loads(line) for line in (tmp_path / "out" / "truth.jsonl").read_text().splitlines()]
    source = open_source(Capture(source=str(tmp_path / "out")))
    for k, phi in enumerate((0.5, 2.5)):
        assert angle_between(np.array(truth[k]["sun"]), direction_from_angles(0.6, phi)) < np.radians(2.5)  # a pixel is 2.8 degrees
        assert angle_between(sun_direction(source.frame(k)), np.array(truth[k]["sun"])) < 0.5 * PIXEL


def test_seed_makes_the_same_codes(tmp_path: Path) -> None:
    pixels = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        camera = VirtualCamera(lens=LENS, response=LOG, noise_codes=1.0)
        simulate(Lighting(maps=("interior",)), camera, tmp_path / name, frames=1, seed=seed)
        pixels.append(read_radiance(tmp_path / name / "interior_0000.exr")[0])
    assert np.array_equal(pixels[0], pixels[1])
    assert not np.array_equal(pixels[0], pixels[2])


def test_saturated_sun_is_counted(tmp_path: Path) -> None:
    low = Log(bits=12, a=float(-B * np.log(1e-3)), b=float(4095 / np.log(1e5)), c=1e-3)
    simulate(Lighting(maps=("sky",)), VirtualCamera(lens=LENS, response=low), tmp_path, frames=1)
    assert open_source(Capture(source=str(tmp_path))).frame(0).saturated > 0


@pytest.mark.parametrize(("maps", "word"), [((), "no map"), (("moon",), "moon"), (("sky", "interior"), "sky")])
def test_maps_that_are_none(tmp_path: Path, maps: tuple[str, ...], word: str) -> None:
    with pytest.raises(UserError, match=word):
        simulate(Lighting(maps=maps), VirtualCamera(lens=LENS), tmp_path)
