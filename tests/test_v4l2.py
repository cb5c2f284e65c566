"""Cameras of the kernel. What needs one runs where /dev/video0 is the kernel's test driver (vivid)."""

import os
from pathlib import Path

import numpy as np
import pytest

from vemlight.capture.colour_coding import colour_coding
from vemlight.capture.pixel_formats import FORMATS, PICTURES, PixelFormat, codes_from_bytes
from vemlight.capture.planes import linear_from_planes
from vemlight.capture.scatter import ONE_THREAD
from vemlight.capture.v4l2 import V4l2Camera, frames_between, list_cameras
from vemlight.capture.v4l2_buffers import FrameBuffers
from vemlight.errors import UserError
from vemlight.light.colour import luminance_from_rgb
from vemlight.settings import Capture

BY_NAME = {form.name: form for form in FORMATS.values()}


def has_vivid() -> bool:
    return any("vivid" in camera.card for camera in list_cameras())


def test_formats_by_the_kernels_letters() -> None:
    assert FORMATS[0x59455247] == PixelFormat("GREY", "<u1", "mono", 8)
    assert FORMATS[0x20363159] == PixelFormat("Y16", "<u2", "mono", 16)
    assert FORMATS[0x20363159 | 1 << 31] == PixelFormat("Y16-BE", ">u2", "mono", 16)
    assert BY_NAME["BA10"].mosaic == "GRBG"
    assert BY_NAME["BYR2"] == PixelFormat("BYR2", "<u2", "BGGR", 16)
    assert len(BY_NAME) == len(FORMATS)


@pytest.mark.parametrize("name", ["GREY", "Y12", "Y16-BE", "RG12"])
@pytest.mark.parametrize("padding", [0, 6])
def test_codes_of_bytes(name: str, padding: int) -> None:
    form = BY_NAME[name]
    codes = np.random.default_rng(1).integers(0, 2**form.bits, (5, 7)).astype(form.dtype)
    data = b"".join(row.tobytes() + b"\xee" * padding for row in codes)
    stride = 7 * codes.dtype.itemsize + padding
    got = codes_from_bytes(data[: len(data) - padding], form, 7, 5, stride)
    assert got.dtype in (np.uint8, np.uint16)
    assert np.array_equal(got, codes)


def test_too_few_bytes_are_no_frame() -> None:
    with pytest.raises(ValueError, match="no frame of 7x5"):
        codes_from_bytes(b"x" * 69, BY_NAME["Y16"], 7, 5, 14)


@pytest.mark.parametrize(
    ("last", "now", "lost"),
    [
        (-1, 17, 0), (3, 4, 0), (3, 8, 4), (2**32 - 1, 0, 0), (2**32 - 2, 1, 2), (5, 5, 0), (9, 2, 0),
        (0, 2**31, 2**31 - 1), (0, 2**31 + 1, 0),  # half the range ahead, and half of it back
    ],
)
def test_lost_frames_are_known_by_number(last: int, now: int, lost: int) -> None:
    assert frames_between(last, now) == lost


def test_what_is_no_camera_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "file", tmp_path / "nothing"):
        with pytest.raises(UserError, match=r"cannot be opened as a camera|no such|no camera"):
            V4l2Camera(str(path))


@pytest.mark.skipif(not has_vivid(), reason="no vivid test device here")
@pytest.mark.parametrize("name", ["Y16", "Y12", "GREY", "RG12", "Y10", "Y16-BE", "RGGB", "RG16"])
def test_200_frames_without_an_unreported_gap(name: str) -> None:
    camera = V4l2Camera("/dev/video0", form=name, width=320, height=180, fps=15.0)
    frames = []
    try:
        assert (camera.form.name, camera.width, camera.height) == (name, 320, 180)
        for _ in range(2000):
            raw = camera.read(1.0)
            if raw is not None:
                assert raw.codes is not None
                assert raw.codes.shape == (180, 320)
                assert raw.codes.max() < 2**camera.form.bits
                frames.append((raw.sequence, raw.monotonic_ns, raw.lost))
            if len(frames) == int(os.environ.get("V4L2_FRAMES", "200")):
                break
    finally:
        camera.close()
    sequence, stamps, lost = map(np.array, zip(*frames, strict=True))
    # under load the driver has been seen to give two frames one number
    assert np.array_equal(np.maximum(np.diff(sequence) - 1, 0), lost[1:])
    assert np.all(np.diff(stamps) >= 0)
    # stamps keep step with the numbers: the driver's clock ticks by a frame each
    assert np.polyfit(sequence, stamps, 1)[0] == pytest.approx(1e9 / camera.fps, rel=0.05)


@pytest.mark.skipif(not has_vivid(), reason="no vivid test device here")
def test_format_that_the_camera_lacks_is_refused() -> None:
    with pytest.raises(UserError, match="has no format Y10-BE but"):
        V4l2Camera("/dev/video0", form="Y10-BE")


OSD_TEXT, NO_TEXT = 0x00F0F001, 2  # vivid's control of the clock that it writes into its picture


def mean_light(name: str) -> np.ndarray:
    """Mean linear light of vivid's still picture in the format `name`; skips where it is not offered."""
    from linuxpy.video import device as v4l2

    if not any(name in camera.formats for camera in list_cameras()):
        pytest.skip(f"vivid offers no {name} here: VIVID='multiplanar=2' has the formats whose planes lie apart")
    camera = V4l2Camera("/dev/video0", form=name, width=320, height=180, fps=15.0)
    try:
        v4l2.set_control(camera._device, OSD_TEXT, NO_TEXT)
        raw = None
        for _ in range(100):
            raw = camera.read(1.0) or raw
            if raw and raw.sequence > 3:
                break
        assert raw is not None
        assert raw.planes is not None
        coding = colour_coding(Capture(), camera.path, camera.tags, camera.unsaid)
        spans = np.tile([0, 320], (180, 1))
        return linear_from_planes(raw.planes, coding, spans, ONE_THREAD).pixels.mean(axis=(0, 1))
    finally:
        camera.close()


@pytest.mark.skipif(not has_vivid(), reason="no vivid test device here")
@pytest.mark.parametrize("name", [name for name, *_ in PICTURES if name not in ("RGB3", "MJPG", "JPEG")])
def test_pictures_in_colour_are_alike_in_every_format(name: str) -> None:
    """Of 75 % colour bars. vivid scales by 255 / 256 and truncates when it makes Y'CbCr: red comes out 2.7 % low, in every format alike."""
    found, wanted = mean_light(name), mean_light("RGB3")
    np.testing.assert_allclose(luminance_from_rgb(found), luminance_from_rgb(wanted), rtol=0.02)
    np.testing.assert_allclose(found, wanted, rtol=0.03)


@pytest.mark.skipif(not has_vivid(), reason="no vivid test device here")
def test_automatic_gain_is_switched_off_and_restored() -> None:
    from linuxpy.video import device as v4l2

    watching = os.open("/dev/video0", os.O_RDWR | os.O_NONBLOCK)
    try:
        v4l2.set_control(watching, 0x00980912, 1)
        camera = V4l2Camera("/dev/video0", form="YUYV", controls={"gain": 77})
        assert camera.controls is not None
        assert camera.controls.values["gain_automatic"] == 0
        assert camera.controls.values["gain"] == 77
        camera.close()
        assert v4l2.get_control(watching, 0x00980912) == 1
    finally:
        os.close(watching)


@pytest.mark.parametrize("granted", [2, 4, 6])
def test_a_driver_grants_as_many_buffers_as_it_likes(monkeypatch: pytest.MonkeyPatch, granted: int) -> None:
    """The kernel's loopback has two."""
    from linuxpy.video import device as v4l2

    enqueued = []
    monkeypatch.setattr(v4l2, "request_buffers", lambda *_: v4l2.raw.v4l2_requestbuffers(count=granted))
    monkeypatch.setattr(v4l2, "query_buffer", lambda _device, _kind, _memory, index: v4l2.raw.v4l2_buffer(index=index))
    monkeypatch.setattr(v4l2, "mmap_from_buffer", lambda _device, buffer: buffer.index)
    monkeypatch.setattr(v4l2, "enqueue_buffer_raw", lambda _device, buffer: enqueued.append(buffer.index))
    FrameBuffers(-1, is_multiplanar=False, planes=1)
    assert enqueued == list(range(granted))
