"""A camera's response from photographs of one view whose exposures are known."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.photographs import write_photograph
from vemlight.capture import camera_source
from vemlight.capture.calibration.bracket_response import calibrate_from_brackets
from vemlight.capture.calibration.webcam_response import calibrate_webcam
from vemlight.capture.pixel_formats import FORMATS
from vemlight.capture.planes import planes_from_image
from vemlight.capture.response import read_response
from vemlight.errors import UserError
from vemlight.light.colour import srgb_from_linear
from vemlight.light.colour_tags import ColourTags
from vemlight.settings import Capture

SIZE = 256


def filmic(light):
    """A gamma of 1.8 with a shoulder."""
    return (light * (1 + light) / (1 + light)) ** (1 / 1.8) * (1.3 - 0.3 * light)


CURVES = {"srgb": srgb_from_linear, "filmic": filmic, "linear": lambda light: light}


def view():
    """A smooth view of two decades with a hard edge."""
    y, x = np.mgrid[:SIZE, :SIZE] / SIZE
    light = 10.0 ** (1.7 * x - 1.6) * (1 + 0.3 * np.sin(9 * y))
    light[100:140, 60:200] *= 3
    return np.repeat(light[..., None], 3, axis=2) * [0.9, 1.0, 1.1]


def shots(folder, curve, noise=0.5, suffix="png", times=(1.0, 1 / 4, 1 / 16, 1 / 64), told=None, seed=0):
    rng = np.random.default_rng(seed)
    folder.mkdir(exist_ok=True)
    for k, time_s in enumerate(times):
        signal = 255 * CURVES[curve](np.clip(view() * time_s, 0, 1)) + rng.normal(0, noise, (SIZE, SIZE, 3))
        codes = np.clip(np.rint(signal), 0, 255).astype(np.uint8)
        write_photograph(folder / f"shot_{k}.{suffix}", codes, (told or times)[k])
    return folder


def errors(path, curve):
    """Relative error of the light of codes 11 to 244, but for one factor."""
    levels = np.linspace(0, 1, 2**18)
    light = np.interp(np.arange(11, 245), 255 * CURVES[curve](levels), levels)
    ratio = read_response(path).radiance(np.arange(11.0, 245.0)) / light
    return np.abs(ratio / np.median(ratio) - 1)


@pytest.mark.parametrize(("curve", "suffix"), [(curve, "png") for curve in CURVES] + [("srgb", "jpg"), ("filmic", "jpg")])
def test_the_curve_is_found(tmp_path, curve, suffix):
    report = calibrate_from_brackets(shots(tmp_path / "s", curve, suffix=suffix), tmp_path / "r.toml")
    wrong = errors(tmp_path / "r.toml", curve)
    assert np.median(wrong) < 0.003
    assert np.quantile(wrong, 0.95) < (0.011 if suffix == "png" else 0.015)  # codes of 11 to 20 suffer from JPEG's blocks
    assert report.error < 0.03
    assert read_response(tmp_path / "r.toml").radiance(np.array([255.0])) == pytest.approx(1)


def test_rounded_shutter_times_are_thirds_of_stops(tmp_path):
    folder = shots(tmp_path / "s", "srgb", times=(1.0, 1 / 4, 1 / 32, 1 / 64), told=(1.0, 1 / 4, 1 / 30, 1 / 60))
    assert calibrate_from_brackets(folder, tmp_path / "r.toml").exact_times
    assert np.quantile(errors(tmp_path / "r.toml", "srgb"), 0.95) < 0.011


def test_times_that_are_no_thirds_of_stops_hold_as_written(tmp_path):
    folder = shots(tmp_path / "s", "srgb", times=(0.9, 0.3, 0.1, 0.03))
    assert not calibrate_from_brackets(folder, tmp_path / "r.toml").exact_times
    assert np.quantile(errors(tmp_path / "r.toml", "srgb"), 0.95) < 0.011


def test_photographs_that_contradict_each_other_are_refused(tmp_path):
    """Automatic exposure that went on, for the third photograph alone."""
    folder = shots(tmp_path / "s", "srgb", told=(1.0, 1 / 4, 1 / 40, 1 / 64))
    with pytest.raises(UserError, match=r"s: ratios of exposures come out \d+\.\d% wrong, beyond 5%"):
        calibrate_from_brackets(folder, tmp_path / "r.toml")
    assert not (tmp_path / "r.toml").exists()


def test_what_shows_nothing_is_refused(tmp_path):
    folder = shots(tmp_path / "s", "srgb", times=(1.0, 1 / 4000))
    with pytest.raises(UserError, match=r"s: \d+ even places are well exposed in two photographs, and 500 are needed"):
        calibrate_from_brackets(folder, tmp_path / "r.toml")
    with pytest.raises(UserError, match="is no folder"):
        calibrate_from_brackets(folder / "shot_0.png", tmp_path / "r.toml")
    write_photograph(folder / "shot_2.png", np.zeros((8, 8, 3), np.uint8), 0.1)
    with pytest.raises(UserError, match=r"shot_2\.png: has another size"):
        calibrate_from_brackets(folder, tmp_path / "r.toml")


class Webcam:
    """Replaces V4l2Camera: a command takes effect three frames later. time_control, unit_s: as its controls say."""

    form_name, most, time_control, unit_s = "RGB3", 2000, "exposure_time_absolute", 1e-4

    def __init__(self, path, **_):
        self.path, self.fps, self.state, self.closed = path, 30.0, "streams", []
        self.form = next(form for form in FORMATS.values() if form.name == self.form_name)
        self.tags = self.unsaid = ColourTags("srgb", "bt709", "bt601", "full")
        self.log, self.rng = [0.0333 / self.unit_s] * 4, np.random.default_rng(1)
        self.controls = SimpleNamespace(
            limits=lambda _name: (1e-4 / self.unit_s, self.most), written=self.written, time_control=self.time_control, unit_s=self.unit_s
        )

    def written(self, name, value):
        assert name == self.time_control
        self.asked = value
        return value

    def read(self, _wait_s):
        self.log.append(self.asked)
        signal = 255 * filmic(np.clip(view() * self.log[-4] * self.unit_s * 40, 0, 1)) + self.rng.normal(0, 0.5, (SIZE, SIZE, 3))
        planes = planes_from_image(np.clip(np.rint(signal), 0, 255).astype(np.uint8), 8)
        return SimpleNamespace(planes=planes)

    def close(self):
        self.closed.append(True)


class MachineVision(Webcam):
    """Replaces GenicamCamera: exposures in us."""

    most, time_control, unit_s = 200_000, "ExposureTime", 1e-6


@pytest.mark.parametrize(("source", "shortest_s"), [("/dev/video0", 1e-4), ("genicam:1", 130e-6)])
def test_a_webcam_calibrates_itself(tmp_path, monkeypatch, source, shortest_s):
    monkeypatch.setattr(camera_source, "V4l2Camera", Webcam)
    monkeypatch.setattr(camera_source, "GenicamCamera", MachineVision)
    report, exposures = calibrate_webcam(Capture(source=source), tmp_path / "r.toml", accept=False)
    assert report.photographs == 9  # 1/30 s, and eight halves of it down to 0.1 ms
    assert exposures[0] == pytest.approx(0.0333, rel=2e-3)
    assert exposures[-1] == pytest.approx(shortest_s)
    wrong = errors(tmp_path / "r.toml", "filmic")
    assert np.median(wrong) < 0.003
    assert np.quantile(wrong, 0.95) < 0.011


def test_cameras_that_cannot_calibrate_themselves_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(camera_source, "V4l2Camera", Webcam)
    monkeypatch.setattr(Webcam, "most", 1)
    with pytest.raises(UserError, match="exposure_time_absolute has one value alone"):
        calibrate_webcam(Capture(source="/dev/video0"), tmp_path / "r.toml", accept=False)
    monkeypatch.setattr(Webcam, "form_name", "Y12")
    with pytest.raises(UserError, match=r"sends raw codes \(Y12\)"):
        calibrate_webcam(Capture(source="/dev/video0"), tmp_path / "r.toml", accept=False)
    assert not (tmp_path / "r.toml").exists()
