"""The fuse service among processes: cameras that die and come back, and lossless runs that are equal to the byte."""

import os
import signal
import time
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest
import tomli_w

from tests.support.lights_files import read_lights
from tests.support.processes import LOADED_S, wait_until
from vemlight.fuse.check import warm
from vemlight.fuse.fusing import FuseState
from vemlight.fuse.rest import Layout, cells_in_world
from vemlight.fuse.rig_file import read_camera_rig
from vemlight.fuse.service import fused_messages
from vemlight.light.images import write_exr
from vemlight.runtime import stamps, wire
from vemlight.runtime.demand import Pull
from vemlight.runtime.reports import MapReport
from vemlight.runtime.service_stats import ServiceStats
from vemlight.runtime.source_protocols import LISTENERS
from vemlight.runtime.transport import Transport

NAMES = ("a", "b", "c")
FRAMES = 12
STAMP = stamps.stamp(7, 0.25)


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory) -> Path:
    """Three cameras, a metre apart, each with its own recording: grey, and a sun that walks."""
    folder = tmp_path_factory.mktemp("rig")
    for c, name in enumerate(NAMES):
        (folder / name).mkdir()
        for k in range(FRAMES):
            image = np.full((16, 32, 3), 0.25, np.float32)
            image[4, (10 + k + c) % 32] = 200
            write_exr(folder / name / f"f_{k:02d}.exr", image)
    cameras = [{"name": name, "source": name, "at": [c, 0, 1]} for c, name in enumerate(NAMES)]
    (folder / "rig.toml").write_text(tomli_w.dumps({"camera": cameras}))
    return folder / "rig.toml"


@pytest.fixture
def make_rig(make_settings, rig_file):
    def make(**sections):
        capture = {"source": "", "rows": 8, "cols": 32, "fps": 8.0, **sections.pop("capture", {})}
        return make_settings(rig={"file": str(rig_file)}, capture=capture, **sections)

    return make


class Fused:
    """What fuse publishes, in order."""

    def __init__(self, settings) -> None:
        self._transport = Transport(settings.wire)
        self._socket = self._transport.subscribe("fuse", "points", "map")
        self.headers: list[wire.FrameHeader] = []

    def until(self, true) -> wire.PointsMessage:
        """The first `points` from now on for which `true` holds."""
        until_s = time.monotonic() + LOADED_S
        while time.monotonic() < until_s:
            if self._socket.poll(200):
                header, _ = wire.unpack(self._socket.recv_multipart())
                assert isinstance(header, wire.FrameHeader)
                self.headers.append(header)
                if isinstance(header, wire.PointsMessage) and true(header.report):
                    return header
        raise AssertionError("no such frame came")

    def close(self) -> None:
        self._transport.close()


def test_each_camera_may_die_and_come_back_while_the_others_go_on(make_rig, services):
    settings, path = make_rig()
    captures = {name: services.start("vemlight.capture", str(path), name) for name in NAMES}
    fuse = services.start("vemlight.fuse", str(path))
    fused = Fused(settings)
    try:
        fused.until(lambda report: report.cameras == 3)
        for name in NAMES:
            captures[name].send_signal(signal.SIGKILL)
            captures[name].wait()
            fused.until(lambda report: report.silent_cameras == 1 and report.cameras == 2)
            captures[name] = services.start("vemlight.capture", str(path), name)
            fused.until(lambda report: report.cameras == 3)
            assert fuse.poll() is None
        maps = [header.stamp for header in fused.headers if isinstance(header, wire.MapMessage)]
        points = [header.stamp for header in fused.headers if isinstance(header, wire.PointsMessage)]
        assert sum(stamp in points for stamp in maps) >= 0.8 * len(maps), "both are on one stamp"  # but where a queue was full
        for a, b in pairwise(points):
            assert b.time_s > a.time_s
            assert b.monotonic_ns > a.monotonic_ns
            assert b.sequence > a.sequence
    finally:
        fused.close()


def test_of_so_many_frames_no_more_are_fused_when_a_camera_comes_late(make_rig, services, monkeypatch):
    monkeypatch.setenv(LISTENERS, "fuse")
    settings, path = make_rig(capture={"frames": 4})
    transport = Transport(settings.wire)
    fused, late = transport.subscribe("fuse", "points", "end"), transport.subscribe("capture.c", "end")
    numbers: list[int] = []

    def has_ended(socket) -> bool:
        ended = False
        while socket.poll(50):
            header, _ = wire.unpack(socket.recv_multipart())
            if isinstance(header, wire.PointsMessage):
                numbers.append(header.stamp.sequence)
            ended |= isinstance(header, wire.EndMessage)
        return ended

    for name in ("a", "b"):
        services.start("vemlight.capture", str(path), name)
    services.start("vemlight.fuse", str(path))
    wait_until(lambda: has_ended(fused), "the end of two cameras")
    services.start("vemlight.capture", str(path), "c")
    wait_until(lambda: has_ended(late), "the end of the third")
    wait_until(lambda: has_ended(fused), "the end of all")
    assert 2 <= max(numbers) < 4
    transport.close()


def pulled(settings, count: int, at=lambda k: None) -> list[int]:
    """The numbers of `count` frames of lights, requested as a renderer does."""
    transport, numbers = Transport(settings.wire), []
    try:
        pull = Pull(transport.request_from("sampler"), "lights", ServiceStats("renderer", 0))

        def came() -> bool:
            if frame := pull.frame(len(numbers)):
                assert isinstance(frame[0], wire.LightsMessage)
                numbers.append(frame[0].stamp.sequence)
                at(len(numbers))
            return len(numbers) == count or pull.end is not None

        wait_until(came, f"frame {len(numbers)}")
        while pull.end is None and len(numbers) < count + 1:
            pull.frame(count)
        return numbers
    finally:
        transport.close()


def test_lossless_runs_are_equal_to_the_byte_whoever_is_killed(make_rig, services, tmp_path):
    written = []
    for run in ("undisturbed", "killed"):
        out = tmp_path / run
        settings, path = make_rig(name=f"{run}.toml", mode="lossless", out=str(out))
        running = {name: services.start("vemlight.capture", str(path), name) for name in NAMES}
        running |= {name: services.start(f"vemlight.{name}", str(path)) for name in ("fuse", "sampler")}

        def kill(k: int, running=running, path=path, run=run) -> None:
            if run == "killed" and k in (3, 6):
                name = {3: "fuse", 6: "b"}[k]
                os.kill(running[name].pid, signal.SIGKILL)
                running[name].wait()
                running[name] = services.start(*(["vemlight.fuse", str(path)] if name == "fuse" else ["vemlight.capture", str(path), "b"]))

        assert pulled(settings, FRAMES, kill) == list(range(FRAMES))
        for process in running.values():
            process.terminate()
            assert process.wait(timeout=20) == 0
        written.append((out / "lights.jsonl").read_bytes())
    assert written[0] == written[1]
    rows = read_lights(tmp_path / "killed" / "lights.jsonl")
    assert [row.sequence for row in rows] == list(range(FRAMES))
    assert all(row.at == (1.0, 0.0, 1.0) for row in rows), "the rig's centre"
    assert all(isinstance(row.points, list) for row in rows)


def map_of(scale: float | None, saturated: int = 0) -> wire.Message:
    radiance = np.full((8, 32, 3), 0.25, np.float32)
    report = MapReport(saturated_pixels=saturated, invalid_cells=1)
    header = wire.MapMessage(stamp=STAMP, rows=8, cols=32, coverage="hemisphere", luminance_scale=scale, report=report)
    return header, (radiance, np.zeros(0, np.int64), np.zeros((0, 3), np.float32), np.zeros(0, np.float32))


@pytest.mark.parametrize(
    ("scales", "gain", "expected"),
    [
        ((179.0, 179.0), None, 179.0), ((179.0, 90.0), None, None), ((179.0, None), None, None), ((None, None), None, None),
        ((179.0, 90.0), (0.5, 0.5, 0.5), 179.0), ((90.0, 179.0), (0.5, 0.5, 0.5), 90.0),
    ],
)  # fmt: skip
def test_the_fused_map_has_the_scale_of_the_cameras_whose_unit_it_has(rig_file, scales, gain, expected):
    rig = read_camera_rig(rig_file)
    cameras = rig.camera[0], msgspec.structs.replace(rig.camera[1], gain=gain)
    state = FuseState.start(msgspec.structs.replace(rig, camera=cameras))
    _, fused = fused_messages(state, tuple(map_of(scale) for scale in scales), STAMP, 0.0)
    header = fused.map[0]
    assert isinstance(header, wire.MapMessage)
    assert header.luminance_scale == expected


def test_the_first_frame_waits_for_nothing_that_could_be_known_before(rig_file):
    rig = read_camera_rig(rig_file)
    turned = msgspec.structs.replace(rig, camera=tuple(msgspec.structs.replace(each, turn=(0.0, 0.1, 0.0, 0.995)) for each in rig.camera))
    cells_in_world.cache_clear()
    warm(turned, Layout(8, 32, "hemisphere"))
    before = cells_in_world.cache_info()
    fused_messages(FuseState.start(turned), (map_of(None),) * 3, STAMP, 0.0)
    after = cells_in_world.cache_info()
    assert (after.misses, after.hits) == (before.misses, before.hits + 6), "of each camera's map and of its blocks"


def test_a_fused_frame_says_what_its_maps_said_and_who_is_silent(rig_file):
    state = FuseState.start(read_camera_rig(rig_file))
    _, fused = fused_messages(state, (map_of(None, 2), None, map_of(None, 3)), STAMP, 1.5)
    wire.unpack(wire.pack(*fused.points))
    header, _ = wire.unpack(wire.pack(*fused.map))
    assert isinstance(header, wire.MapMessage)
    assert (header.report.saturated_pixels, header.report.invalid_cells) == (5, 2)
    points = fused.points[0]
    assert isinstance(points, wire.PointsMessage)
    assert points.stamp == header.stamp == STAMP
    assert (points.report.cameras, points.report.silent_cameras, points.report.spread_ms) == (2, 1, 1.5)
    assert points.at == (1.0, 0.0, 1.0), "the rig's centre"
