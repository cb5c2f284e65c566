"""A camera as a source. Runs where /dev/video0 is the kernel's test driver (vivid)."""

import os
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vemlight.capture.camera_source import CameraSource
from vemlight.capture.lens import Lens, write_lens
from vemlight.capture.response import Linear, write_response
from vemlight.capture.source import open_source
from vemlight.capture.v4l2 import list_cameras
from vemlight.errors import UserError
from vemlight.settings import Capture

pytestmark = pytest.mark.skipif(not any("vivid" in camera.card for camera in list_cameras()), reason="no vivid test device here")
LENS = Lens(size=(320, 180), f=(55.0, 55.0), c=(159.5, 89.5), k1=0.0, k2=0.0, k3=0.0, k4=0.0, rim_deg=95.0)


def live_settings(folder: Path, form: str = "Y12", bits: int = 12, **changes) -> Capture:
    write_lens(folder / "l.toml", LENS)
    write_response(folder / "r.toml", Linear(bits=bits, a=0.0, b=100.0))
    names: dict[str, Any] = {"lens": str(folder / "l.toml"), "response": str(folder / "r.toml")}
    return Capture(source="/dev/video0", format=form, fps=10.0, rows=30, cols=90, **names, **changes)


def some_frames(live: CameraSource, count: int, patience_s: float = 120.0) -> list:
    frames, until = [], time.monotonic() + patience_s
    while len(frames) < count and time.monotonic() < until:
        frame = live.next(0.5)
        if frame is not None:
            frames.append(frame)
    return frames


@pytest.mark.parametrize(("form", "bits"), [("Y12", 12), ("RG12", 12), ("Y16-BE", 16)])
def test_recording_replays_to_the_same_maps(tmp_path: Path, form: str, bits: int) -> None:
    live = CameraSource(live_settings(tmp_path, form, bits, record=str(tmp_path / "out")))
    frames = some_frames(live, 10)
    live.close()
    assert len(frames) == 10
    files: dict[str, Any] = {"lens": str(tmp_path / "l.toml"), "response": str(tmp_path / "r.toml")}
    again = open_source(Capture(source=str(tmp_path / "out"), rows=30, cols=90, **files))
    assert live.recorder is not None
    assert len(again) + live.recorder.dropped == 10
    if not live.recorder.dropped:
        assert [again.frame(k).radiance.tobytes() for k in range(10)] == [f.radiance.tobytes() for f in frames]
        assert [again.frame(k).time_s for k in range(10)] == [f.time_s for f in frames]
    # vivid's picture moves and is no darkness
    assert frames[0].radiance.max() > 0
    assert all(np.isfinite(f.radiance).all() for f in frames)
    assert all(f.monotonic_ns is not None and abs(time.monotonic_ns() - f.monotonic_ns) < 600e9 for f in frames)


def test_lens_of_another_size_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="lens file is for 320x180"):
        CameraSource(live_settings(tmp_path, width=640, height=360))


@pytest.mark.skipif(os.environ.get("V4L2_UNPLUG") != "1", reason="V4L2_UNPLUG=1 lets this test unload the driver")
def test_unplugged_camera_is_waited_for(tmp_path: Path) -> None:
    live = CameraSource(live_settings(tmp_path, record=str(tmp_path / "out")))
    before = some_frames(live, 5)
    subprocess.run(["v4l2-ctl", "-d", "/dev/video0", "-c", "disconnect=1"], check=False)
    gone = time.monotonic() + 30
    while "is gone" not in live.state and time.monotonic() < gone:
        live.next(0.2)
    assert "/dev/video0: is gone" in live.state
    subprocess.run(["modprobe", "-r", "vivid"], check=True)
    assert live.next(0.2) is None
    options = Path("/lab-vivid").read_text().split() if Path("/lab-vivid").exists() else []
    subprocess.run(["modprobe", "vivid", *options], check=True)
    after = some_frames(live, 5)
    live.close()
    assert len(before) == len(after) == 5
    assert after[0].time_s > before[-1].time_s
    assert live.recorder is not None
    assert len(open_source(Capture(source=str(tmp_path / "out"), rows=30, cols=90))) == live.recorder.written >= 10 - live.recorder.dropped
