"""How GenICam cameras are found, and refused; and the acquisition itself, against the virtual cameras that the package brings with it."""

import signal
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from vemlight.capture import genicam_producers
from vemlight.capture.camera_source import CameraSource
from vemlight.capture.genicam_camera import GenicamCamera
from vemlight.capture.genicam_producers import PRODUCERS, check_producers
from vemlight.commands import doctor
from vemlight.commands.run_checks import check_camera
from vemlight.errors import UserError
from vemlight.settings import Capture
from vemlight.source_names import is_camera, is_live, is_path, shown_source

SOURCE = "genicam:1"


@pytest.fixture
def virtual_producer(monkeypatch):
    """The folder of a producer with three cameras: gray or RGBa, up to 800 x 800, without exposure, chunks of it or stamps."""
    genicam = pytest.importorskip("genicam", reason="harvesters is not installed: pip install 'vemlight[genicam]'")
    pytest.importorskip("harvesters", reason="harvesters is not installed: pip install 'vemlight[genicam]'")
    folder = Path(genicam.__file__).parent
    monkeypatch.setenv(PRODUCERS, str(folder))
    return folder


@pytest.fixture
def installed(monkeypatch):
    """The package seems to be there."""
    package = ModuleType("harvesters")
    package.core = ModuleType("harvesters.core")  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "harvesters", package)
    monkeypatch.setitem(sys.modules, "harvesters.core", package.core)  # type: ignore[attr-defined]


def test_a_genicam_camera_is_live_and_has_no_path():
    assert is_camera(SOURCE)
    assert is_live(SOURCE)
    assert not is_path(SOURCE)
    assert shown_source("genicam:DEV_1AB/2") == "genicam:DEV_1AB/2"
    assert is_path("genicam")


def test_without_the_package_a_line_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "harvesters.core", None)
    with pytest.raises(UserError, match=r"genicam:1: .* harvesters is not installed; pip install 'vemlight\[genicam\]'"):
        check_camera(SOURCE)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, f"genicam:1: needs its maker's GenTL producer .* {PRODUCERS} is not set"),
        ("{folder}", f"{PRODUCERS} names no folder with one"),
        ("{folder}/nothing.cti", "nothing.cti: there is no such GenTL producer"),
        ("{folder}/cti", "damaged.cti: cannot be loaded as a GenTL producer .*; install"),
    ],
)
def test_producers_that_are_not_there_or_damaged_are_refused(installed, monkeypatch, tmp_path, value, words):
    (tmp_path / "cti").mkdir()
    (tmp_path / "cti" / "damaged.cti").write_bytes(b"no library")
    monkeypatch.delenv(PRODUCERS, raising=False)
    if value:
        monkeypatch.setenv(PRODUCERS, value.format(folder=tmp_path))
    with pytest.raises(UserError, match=words) as refused:
        check_camera(SOURCE)
    assert "\n" not in str(refused.value)


def test_a_library_that_is_no_producer_is_refused_and_beside_a_good_one_left_out(installed, monkeypatch, tmp_path, capsys):
    names = {"bad.cti": SimpleNamespace(), "good.cti": SimpleNamespace(GCInitLib=None)}
    monkeypatch.setattr(genicam_producers.ctypes, "CDLL", lambda path: names[Path(path).name])
    (tmp_path / "bad.cti").touch()
    monkeypatch.setenv(PRODUCERS, str(tmp_path))
    with pytest.raises(UserError, match=r"bad.cti: is no GenTL producer"):
        check_producers(SOURCE)
    (tmp_path / "good.cti").touch()
    assert check_producers(SOURCE) == [str(tmp_path / "good.cti")]
    assert "bad.cti: is no GenTL producer; the other producers are used" in capsys.readouterr().err


def test_the_doctor_says_what_is_missing(installed, monkeypatch, tmp_path):
    monkeypatch.setenv(PRODUCERS, str(tmp_path))
    (finding,) = doctor._genicam_cameras()
    assert finding.grade == "warn"
    assert f"{PRODUCERS} names no folder with one" in finding.found
    monkeypatch.delenv(PRODUCERS)
    assert list(doctor._genicam_cameras()) == []  # nobody has such cameras


def test_the_doctor_lists_cameras_and_formats(virtual_producer):
    findings = list(doctor._genicam_cameras())
    assert [finding.found.split(":")[1] for finding in findings] == ["0", "1", "2"]
    assert all("RGBa8, Mono8" in finding.found and finding.grade == "pass" for finding in findings)


@pytest.mark.parametrize("source", ["genicam:7", "genicam:"])
def test_no_such_camera_is_refused_with_those_that_there_are(virtual_producer, source):
    with pytest.raises(UserError, match=f"{source}: there is no such camera but genicam:0, genicam:1, genicam:2"):
        GenicamCamera(source)


def test_the_package_leaves_warnings_as_they_were(virtual_producer):
    script = "import warnings; from vemlight.capture.genicam_producers import check_producers as check; before = list(warnings.filters)"
    run = subprocess.run([sys.executable, "-c", f"{script}; check('genicam:1'); assert warnings.filters == before"], check=False)
    assert run.returncode == 0


def test_virtual_frames_arrive_numbered_and_ctrl_c_stays_ours(virtual_producer):
    before = signal.getsignal(signal.SIGINT)
    camera = GenicamCamera(SOURCE, form="Mono8", width=200, height=100, fps=50.0, response_bits=8)
    assert signal.getsignal(signal.SIGINT) is before
    assert (camera.width, camera.height, camera.fps, camera.form.mosaic) == (200, 100, 50.0, "mono")
    try:
        frames = [frame for _ in range(60) if (frame := camera.read(0.2)) is not None][:20]
    finally:
        camera.close()
    assert len(frames) == 20
    for one, next_one in pairwise(frames):
        assert next_one.sequence - one.sequence == next_one.lost + 1
        assert next_one.monotonic_ns > one.monotonic_ns
    assert abs(frames[-1].monotonic_ns - time.monotonic_ns()) < 5e9
    assert all(frame.codes is not None and frame.codes.shape == (100, 200) for frame in frames)
    assert frames[0].codes is not None
    assert np.ptp(frames[0].codes) > 0  # a picture
    again = GenicamCamera(SOURCE)
    assert (again.width, again.height) == (400, 400)  # as it was
    again.close()


def test_a_virtual_camera_gives_maps_of_light_in_colour(virtual_producer):
    settings = Capture(source="genicam:first", width=400, height=200, rows=10, cols=20, coverage="sphere", projection="equirect")
    source = CameraSource(settings)
    frames = [frame for _ in range(20) if (frame := source.next(0.5)) is not None][:3]
    source.close()
    assert len(frames) == 3
    for frame in frames:
        assert np.isfinite(frame.radiance).all()
        assert 0 < frame.radiance.mean() <= 1
    assert "closed" in source.state
