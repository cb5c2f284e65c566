"""What the virtual camera's sensor makes of light."""

import json
from pathlib import Path

import numpy as np
import pytest

from vemlight.capture.lens import Lens
from vemlight.capture.manifest import read_manifest
from vemlight.capture.response import Companding, Log, radiance_table
from vemlight.capture.simulation.sensor import VirtualCamera, exposed, fixed_pattern, through_mosaic
from vemlight.capture.simulation.simulate import Lighting, simulate
from vemlight.capture.source import open_source
from vemlight.light.images import read_radiance, write_exr
from vemlight.light.sphere import map_irradiance
from vemlight.settings import Capture

LENS = Lens(size=(96, 96), f=(28.0, 28.0), c=(47.5, 47.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0)
B = 4095 / np.log(1e8)
KNEES = Companding(bits=12, knees=((0.0, 20.0), (1.0, 1620.0), (50.0, 3600.0), (4e4, 4000.0)))
LOG = Log(bits=12, a=float(-B * np.log(1e-3)), b=float(B), c=1e-3)


def test_noise_and_pattern_have_their_sigmas() -> None:
    even = np.full((96, 96, 3), 1.0)
    camera = VirtualCamera(lens=LENS, response=LOG, noise_codes=2.0, pattern_codes=3.0)
    pattern = fixed_pattern(camera, 5)
    shots = [exposed(even, camera, pattern, (5, k)) for k in range(20)]
    mean = np.mean(shots, axis=0)
    # 96 x 96 pixels: a sigma is known to 1 / sqrt(2 x 9216) = 0.7 %; what is left of 20 frames' noise, 0.45, adds to the pattern's 3
    assert np.std(mean[..., 0]) == pytest.approx(np.hypot(3.0, 2 / np.sqrt(20)), rel=0.04)
    assert np.std(np.array(shots) - mean) == pytest.approx(2.0, rel=0.05)
    assert np.array_equal(pattern, fixed_pattern(camera, 5))


def test_radiance_above_the_half_floats_is_their_largest() -> None:
    pixels = exposed(np.full((4, 4, 3), 1e6), VirtualCamera(lens=LENS), np.zeros((1, 1, 1)), (0, 0))
    assert pixels.dtype == np.float16
    assert np.all(pixels == 65504)


def test_mosaic_takes_each_pixel_of_its_colour() -> None:
    rgb = np.random.default_rng(0).random((6, 8, 3))
    seen = through_mosaic(rgb, "GRBG")
    assert np.array_equal(seen[0::2, 0::2], rgb[0::2, 0::2, 1])
    assert np.array_equal(seen[0::2, 1::2], rgb[0::2, 1::2, 0])
    assert np.array_equal(seen[1::2, 0::2], rgb[1::2, 0::2, 2])
    assert np.array_equal(seen[1::2, 1::2], rgb[1::2, 1::2, 1])
    np.testing.assert_allclose(through_mosaic(rgb, "mono"), rgb.mean(-1))


@pytest.mark.parametrize("mosaic", ["RGGB", "mono", None])
@pytest.mark.parametrize("response", [LOG, KNEES], ids=["log", "knees"])
def test_every_sensor_comes_back_to_the_truth(tmp_path: Path, mosaic, response) -> None:
    camera = VirtualCamera(lens=LENS, response=response, mosaic=mosaic, noise_codes=0.5, exposure_s=0.01)
    simulate(Lighting(maps=("interior",)), camera, tmp_path, frames=1)
    truth = np.array(json.loads((tmp_path / "truth.jsonl").read_text())["irradiance"])
    frame = open_source(Capture(source=str(tmp_path), rows=45, cols=180)).frame(0)
    expected = np.full(3, truth.mean()) if mosaic == "mono" else truth
    # a mosaic's blue pixels see one in four of a 2 degree grid: the tubes' edges make 2 %
    np.testing.assert_allclose(map_irradiance(frame.radiance, "hemisphere"), expected, rtol=0.03 if mosaic == "RGGB" else 0.01)


@pytest.mark.parametrize("level", np.logspace(-2, 4, 13))
def test_radiance_comes_back_over_six_decades(level: float) -> None:
    sensor = Log(bits=12, a=float(4095 / 9 * 3), b=float(4095 / np.log(1e9)), c=1e-3)  # nine decades from 1e-3 on
    true = level * 10 ** np.random.default_rng(3).uniform(-0.02, 0.02, (64, 64, 3))  # all places between two codes
    camera = VirtualCamera(lens=LENS, response=sensor, noise_codes=0.5)
    codes = exposed(true, camera, np.zeros((1, 1, 1)), (0, 1)).astype(np.uint16)
    assert np.median(np.abs(radiance_table(sensor)[codes] / true - 1)) < 0.015


@pytest.mark.parametrize("hertz", [100.0, 120.0])
def test_flicker_beats_with_the_frames_unless_exposed_for_a_period(tmp_path: Path, hertz: float) -> None:
    write_exr(tmp_path / "even.exr", np.ones((16, 32, 3), np.float32))

    def totals(exposure_s: float) -> np.ndarray:
        camera = VirtualCamera(lens=LENS, fps=37.0, exposure_s=exposure_s)
        simulate(Lighting(maps=(str(tmp_path / "even.exr"),), flicker_hz=hertz), camera, tmp_path / "out", frames=6)
        rows = [json.loads(line) for line in (tmp_path / "out" / "truth.jsonl").read_text().splitlines()]
        return np.array([row["irradiance"][1] for row in rows])

    short, whole = totals(0.001), totals(1 / hertz)
    # 0.3 of the mean, averaged over the exposure in closed form
    phase = 2 * np.pi * hertz * (np.arange(6) / 37 + 0.0005)
    np.testing.assert_allclose(short, 2 * np.pi * (1 + 0.3 * np.cos(phase) * np.sinc(hertz * 0.001)), rtol=1e-9)
    assert np.ptp(short) / short.mean() > 0.2
    assert np.ptp(whole) / whole.mean() < 1e-9


def test_dropped_frames_are_missing_by_number(tmp_path: Path) -> None:
    simulate(Lighting(maps=("interior",)), VirtualCamera(lens=LENS, response=LOG, dropouts=0.4), tmp_path, frames=20, seed=2)
    numbers = [entry.sequence for entry in read_manifest(tmp_path)]
    assert 4 <= len(numbers) < 20
    assert numbers == sorted(set(numbers))
    source = open_source(Capture(source=str(tmp_path), rows=20, cols=40))
    assert len(source) == len(numbers)
    assert source.frame(1).time_s == numbers[1] / 25


def test_truth_is_a_sequence_of_its_own(tmp_path: Path) -> None:
    camera = VirtualCamera(lens=LENS, response=LOG, noise_codes=0.5)
    simulate(Lighting(maps=("sky",)), camera, tmp_path, frames=2, truth_maps=True)
    image, attributes = read_radiance(tmp_path / "truth" / "sky_0001.exr")
    assert attributes["vemlight:kind"] == "fisheye"
    assert image.max() > 1000
    true = open_source(Capture(source=str(tmp_path / "truth"), rows=20, cols=40)).frame(1).radiance
    seen = open_source(Capture(source=str(tmp_path), rows=20, cols=40)).frame(1).radiance
    # half a code and rounding make 0.6 codes of b = 222: 0.3 % a pixel, less in a cell's mean
    assert np.median(np.abs(seen / true - 1)) < 0.003
