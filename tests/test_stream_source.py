"""Streams of a network: their light, the newest picture, lost connections, and servers that refuse or say nothing."""

import itertools
import time
from typing import Any

import numpy as np
import pytest

from tests.support.films import lamp_room
from tests.support.stream_server import jpeg, serving
from vemlight.capture import stream_source
from vemlight.capture.live_frames import LiveFrames, open_live
from vemlight.capture.polar import latlong_to_polar, polar_from_latlong
from vemlight.errors import UserError
from vemlight.light.colour import srgb_from_linear
from vemlight.light.sphere import map_irradiance
from vemlight.runtime.output_folder import run_start
from vemlight.settings import Capture, Settings
from vemlight.source_names import shown_source

HEIGHT = 64
SRGB: dict[str, Any] = {"transfer": "srgb", "primaries": "bt709", "matrix": "bt601", "range": "full"}


def picture(power=0.9):
    """Linear light, and its JPEG."""
    light = lamp_room(HEIGHT, power)
    return light, jpeg(np.rint(255 * srgb_from_linear(light)).astype(np.uint8))


def irradiance(light):
    weights = latlong_to_polar(HEIGHT, 2 * HEIGHT, 90, 360, "hemisphere")
    return map_irradiance(polar_from_latlong(light.astype(np.float32), weights), "hemisphere")


def next_frame(source, limit_s=10.0):
    until_s = time.monotonic() + limit_s
    while time.monotonic() < until_s:
        if frame := source.next(0.1):
            return frame
    raise AssertionError(f"no frame came: {source.state}")


def test_light_of_a_stream():
    light, data = picture()
    with serving([data]) as server:
        frames = LiveFrames(Capture(source=server.address, **SRGB), 5)
        got = [frames.frame(k) for k in range(len(frames))]
    for frame in got:
        np.testing.assert_allclose(map_irradiance(frame.radiance, "hemisphere"), irradiance(light), rtol=0.02)
    assert got[0].time_s == 0
    assert all(a.time_s < b.time_s for a, b in itertools.pairwise(got))
    assert all(frame.monotonic_ns for frame in got)


def test_the_newest_picture_wins_and_what_is_passed_over_is_counted():
    with serving([picture(0.1 + 0.02 * k)[1] for k in range(40)], fps=50) as server:
        source = open_live(Capture(source=server.address, **SRGB))
        next_frame(source)
        time.sleep(0.5)
        frame = next_frame(source)
        assert 10 <= frame.lost <= 40
        assert frame.monotonic_ns is not None
        assert time.monotonic_ns() - frame.monotonic_ns < 0.2e9
        source.close()


def test_a_connection_that_ends_is_made_again(monkeypatch):
    monkeypatch.setattr(stream_source, "RETRY_S", 0.05)
    with serving([picture()[1]], fps=50, hang_up_after=10) as server:
        source = open_live(Capture(source=server.address, **SRGB))
        until_s = time.monotonic() + 20
        frames = 0
        while server.connections < 3 and time.monotonic() < until_s:
            frames += source.next(0.1) is not None
        assert server.connections >= 3
        assert frames >= 2
        source.close()


def test_an_outage_is_told_and_counted(monkeypatch):
    monkeypatch.setattr(stream_source, "RETRY_S", 0.05)
    with serving([picture()[1]], fps=50) as server:
        source = open_live(Capture(source=server.address, **SRGB))
        next_frame(source)
    until_s = time.monotonic() + 10
    while "outage" not in source.state and time.monotonic() < until_s:
        source.next(0.05)
    assert "is gone" in source.state
    assert "outage 1" in source.state or "outage 2" in source.state
    source.close()


def test_a_server_that_refuses_is_one_line_without_the_password():
    with serving([picture()[1]], password="me:secret") as server:
        address = server.address.replace("http://", "http://me:wrong@")
        with pytest.raises(UserError) as error:
            open_live(Capture(source=address, **SRGB))
        assert server.address in str(error.value)
        assert "wrong" not in str(error.value)
        assert "401" in str(error.value)
        source = open_live(Capture(source=server.address.replace("http://", "http://me:secret@"), **SRGB))
        assert next_frame(source)
        assert "secret" not in source.state
        source.close()
    with pytest.raises(UserError, match="cannot be played"):
        open_live(Capture(source=server.address, **SRGB))


def test_a_server_that_says_nothing_is_given_up(monkeypatch):
    monkeypatch.setattr(stream_source, "OPEN_S", 0.7)
    with (
        serving([picture()[1]], silent=True) as server,
        pytest.raises(UserError, match=r"127\.0\.0\.1.*(sent no picture|cannot be played)"),
    ):
        open_live(Capture(source=server.address, **SRGB))


def test_a_stream_that_falls_silent_ends_a_command(monkeypatch):
    from vemlight.capture import live_frames

    monkeypatch.setattr(live_frames, "SILENT_S", 1.0)
    with serving([picture()[1]], fps=50) as server:
        frames = LiveFrames(Capture(source=server.address, **SRGB), 500)
        frames.frame(0)
    with pytest.raises(UserError, match="fell silent after"):
        [frames.frame(k) for k in range(1, 500)]


@pytest.mark.parametrize(("source", "shown"), [
    ("http://u:p@host:80/a/b?token=x#y", "http://host:80/a/b"), ("rtsp://host/live", "rtsp://host/live"),
    ("rtsp://a@b:c@host/live@2x", "rtsp://host/live@2x"), ("/dev/video0", "/dev/video0"), ("films/a@b.mp4", "films/a@b.mp4"),
])  # fmt: skip
def test_what_is_shown_of_an_address(source, shown):
    assert shown_source(source) == shown


def test_no_password_in_what_a_run_leaves():
    start = run_start(Settings(out="out", capture=Capture(source="http://u:secret@host/x?key=secret")))
    assert "secret" not in str(start)
    assert "http://host/x" in str(start)


def test_a_stream_of_another_shape_is_refused():
    with serving([jpeg(np.full((64, 64, 3), 99, np.uint8))]) as server, pytest.raises(UserError, match="twice as wide"):
        open_live(Capture(source=server.address, **SRGB))


def test_a_recording_of_a_stream(tmp_path):
    from vemlight.capture.recording import record
    from vemlight.capture.source import open_files

    light, data = picture()
    with serving([data]) as server:
        done = record(Capture(source=server.address, record=str(tmp_path / "rec"), **SRGB), 3)
    assert done.written >= 3
    replayed = open_files(Capture(source=str(tmp_path / "rec"))).frame(2)
    np.testing.assert_allclose(map_irradiance(replayed.radiance, "hemisphere"), irradiance(light), rtol=0.02)
