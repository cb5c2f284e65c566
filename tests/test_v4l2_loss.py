"""Cameras that lose frames, disappear, return and change: the kernel's driver is replaced by a pipe that the test fills."""

import errno
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from vemlight.capture import v4l2 as module
from vemlight.capture.camera_source import CameraSource
from vemlight.capture.lens import Lens, write_lens
from vemlight.capture.manifest import read_manifest
from vemlight.capture.response import Linear, write_response
from vemlight.capture.v4l2 import V4l2Camera
from vemlight.errors import UserError
from vemlight.settings import Capture

device = pytest.importorskip("linuxpy.video.device", reason="linuxpy is for Linux")
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the kernel's video interface is Linux's")
Y12 = next(code for code, form in module.FORMATS.items() if form.name == "Y12")
OPEN = os.open
SIZE = (12, 10)
FRAME = np.arange(120, dtype="<u2").reshape(10, 12)


class Driver:
    """A camera that gives the frames in `coming`: (sequence, bytes, flags); plugged in or not."""

    def __init__(self) -> None:
        self.size: tuple[int, int] = SIZE
        self.code = Y12
        self.plugged, self.coming, self.maps = True, [], []
        self.ready, self.signal = os.pipe()

    def put(self, sequence: int, data: bytes = FRAME.tobytes(), flags: int = 0) -> None:
        self.coming.append((sequence, data, flags))
        os.write(self.signal, b"!")

    def open(self, path: str, *rest: int) -> int:
        if path != "/dev/video0":
            return OPEN(path, *rest)
        if not self.plugged:
            raise OSError(errno.ENOENT, "No such file or directory")
        return os.dup(self.ready)

    def unplug(self) -> None:
        self.plugged = False
        os.write(self.signal, b"!")

    def dequeue(self, *_: object) -> SimpleNamespace:
        os.read(self.ready, 1)
        if not self.plugged:
            raise OSError(errno.ENODEV, "No such device")
        sequence, data, flags = self.coming.pop(0)
        for mapped in self.maps:
            mapped[: len(data)] = data
        stamp = SimpleNamespace(secs=sequence, usecs=0)
        return SimpleNamespace(index=0, bytesused=len(data), flags=flags, sequence=sequence, timestamp=stamp)

    def map(self, *_: object) -> bytearray:
        self.maps.append(Mapped(4096))
        return self.maps[-1]

    def set_format(self, _device: int, _kind: object, _width: int, _height: int, code: int) -> None:
        self.code = code

    def format(self, *_: object) -> SimpleNamespace:
        width, height = self.size
        pix = SimpleNamespace(width=width, height=height, pixelformat=self.code, bytesperline=2 * width, sizeimage=2 * width * height)
        return SimpleNamespace(fmt=SimpleNamespace(pix=pix))


class Mapped(bytearray):
    def close(self) -> None: ...


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    simulated = Driver()
    monkeypatch.setattr(module.os, "open", simulated.open)
    monkeypatch.setattr(module, "_capabilities", lambda _: ("a simulated camera", True))
    monkeypatch.setattr(module, "_offered", lambda _: [simulated.code])
    monkeypatch.setattr(module, "_is_multiplanar", lambda _: False)
    for name, call in {
        "get_raw_format": simulated.format, "dequeue_buffer": simulated.dequeue, "mmap_from_buffer": simulated.map,
        "set_format": simulated.set_format, "get_fps": lambda *_: 25.0,
        "request_buffers": lambda *asked: SimpleNamespace(count=asked[-1]),
        **dict.fromkeys(("set_fps", "query_buffer", "enqueue_buffer_raw", "stream_on"), lambda *_: None),
    }.items():  # fmt: skip
        monkeypatch.setattr(device, name, call)
    return simulated


def test_frames_come_with_number_and_stamp(driver: Driver) -> None:
    camera = V4l2Camera("/dev/video0")
    driver.put(7)
    raw = camera.read(1.0)
    assert raw is not None
    assert raw.codes is not None
    assert np.array_equal(raw.codes, FRAME)
    assert (raw.sequence, raw.monotonic_ns, raw.lost, raw.mosaic) == (7, 7 * 10**9, 0, "mono")
    assert camera.read(0.01) is None
    assert "Y12 12x10 at 25 a second" in camera.state


def test_lost_and_damaged_frames_are_counted(driver: Driver) -> None:
    camera = V4l2Camera("/dev/video0")
    for sequence, flags in ((3, 0), (4, int(device.BufferFlag.ERROR)), (5, 0), (9, 0)):
        driver.put(sequence, flags=flags)
    got = [camera.read(1.0) for _ in range(4)]
    assert [raw and (raw.sequence, raw.lost) for raw in got] == [(3, 0), None, (5, 1), (9, 3)]


def test_an_unplugged_camera_is_waited_for(driver: Driver) -> None:
    camera = V4l2Camera("/dev/video0")
    driver.put(1)
    assert camera.read(1.0) is not None
    driver.unplug()
    assert [camera.read(0.01) for _ in range(3)] == [None] * 3
    assert "is gone (No such device); waiting for it" in camera.state
    driver.plugged = True
    driver.put(0)
    raw = camera.read(1.0)
    assert raw is not None
    assert (raw.sequence, raw.lost) == (0, 0)  # it counts anew
    assert "at 25 a second" in camera.state


def test_a_camera_of_another_size_is_refused_when_it_comes_back(driver: Driver) -> None:
    camera = V4l2Camera("/dev/video0")
    driver.unplug()
    assert camera.read(1.0) is None
    driver.plugged, driver.size = True, (24, 20)
    with pytest.raises(UserError, match="came back with Y12 24x20 instead of Y12 12x10; start again"):
        camera.read(1.0)


def test_too_few_bytes_mid_stream_are_refused(driver: Driver) -> None:
    camera = V4l2Camera("/dev/video0")
    driver.put(1, FRAME.tobytes()[:100])
    with pytest.raises(UserError, match="100 bytes are no frame of 12x10, which it had agreed to send"):
        camera.read(1.0)


def test_an_unexpected_error_of_the_driver_is_raised(driver: Driver, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise OSError(errno.EFAULT, "Bad address")

    monkeypatch.setattr(device, "dequeue_buffer", broken)
    camera = V4l2Camera("/dev/video0")
    driver.put(1)
    with pytest.raises(OSError, match="Bad address"):
        camera.read(1.0)


@pytest.fixture
def live(driver: Driver, tmp_path: Path) -> CameraSource:
    write_lens(tmp_path / "l.toml", Lens(size=SIZE, f=(3.0, 3.0), c=(5.5, 4.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0))
    write_response(tmp_path / "r.toml", Linear(bits=12, a=0.0, b=1.0))
    named = {"lens": str(tmp_path / "l.toml"), "response": str(tmp_path / "r.toml"), "record": str(tmp_path / "out")}
    return CameraSource(Capture(source="/dev/video0", rows=4, cols=8, **named))  # type: ignore[arg-type]


def test_nothing_recorded_is_lost_when_the_camera_changes(driver: Driver, live: CameraSource, tmp_path: Path) -> None:
    for sequence in (1, 2, 4):
        driver.put(sequence)
        assert live.next(1.0) is not None
    driver.unplug()
    assert live.next(1.0) is None
    assert "is gone" in live.state
    driver.plugged, driver.size = True, (24, 20)
    with pytest.raises(UserError, match="came back"):
        live.next(1.0)
    live.close()
    entries = read_manifest(tmp_path / "out")
    assert [(entry.sequence, entry.time_s) for entry in entries] == [(0, 0.0), (1, 1.0), (3, 3.0)]  # one was lost, and is missing by number


def test_a_lens_of_another_size_frees_the_camera(driver: Driver, tmp_path: Path) -> None:
    write_lens(tmp_path / "l.toml", Lens(size=(64, 64), f=(9.0, 9.0), c=(31.5, 31.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0))
    write_response(tmp_path / "r.toml", Linear(bits=12, a=0.0, b=1.0))
    closed = []
    monkey = pytest.MonkeyPatch()
    monkey.setattr(module.V4l2Camera, "close", lambda self: closed.append(self.path))
    try:
        with pytest.raises(UserError, match="is 12x10 and the lens file is for 64x64"):
            CameraSource(Capture(source="/dev/video0", lens=str(tmp_path / "l.toml"), response=str(tmp_path / "r.toml")))
    finally:
        monkey.undo()
    assert closed == ["/dev/video0"]


@pytest.mark.parametrize(("asked", "fps"), [(0.0, 25.0), (12.0, 12.0)])
def test_a_triggered_camera_has_the_rate_that_was_asked_for(
    driver: Driver, monkeypatch: pytest.MonkeyPatch, asked: float, fps: float
) -> None:
    def no_rate(*_: object) -> float:
        raise OSError(errno.ENOTTY, "Inappropriate ioctl for device")

    monkeypatch.setattr(device, "get_fps", no_rate)
    assert V4l2Camera("/dev/video0", fps=asked).fps == fps


@pytest.mark.parametrize(
    ("offered", "chosen"),
    [(("GREY", "Y12", "Y10"), "Y12"), (("RG12", "Y12", "GREY"), "Y12"), (("Y10", "RG12"), "RG12"), (("BA81",), "BA81")],
)
def test_the_deepest_format_is_chosen_and_gray_before_a_mosaic(
    driver: Driver, monkeypatch: pytest.MonkeyPatch, offered: tuple[str, ...], chosen: str
) -> None:
    codes = [code for name in offered for code, form in module.FORMATS.items() if form.name == name]
    monkeypatch.setattr(module, "_offered", lambda _: codes)
    assert V4l2Camera("/dev/video0").form.name == chosen
