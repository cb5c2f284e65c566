"""`vemlight lights` and `vemlight render` from options to settings."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from vemlight.capture.frames import Frame
from vemlight.commands import offline
from vemlight.commands.offline import open_frames, sampler_settings, write_lights_file
from vemlight.commands.options import LightsOptions, RenderOptions
from vemlight.commands.rendering import renderer_settings
from vemlight.errors import UserError
from vemlight.light.images import write_exr
from vemlight.light.lights_reader import lights_frames
from vemlight.setting_keys import MAX_PICTURE_SIDE
from vemlight.settings import Renderer

HERE = Path()


@pytest.mark.parametrize(("coverage", "rows"), [("hemisphere", 90), ("sphere", 180)])
def test_rows_of_the_map_are_a_degree_high_whatever_it_covers(tmp_path, coverage, rows):
    write_exr(tmp_path / "sky.exr", np.ones((8, 16, 3), np.float32))
    frames = open_frames(LightsOptions(source=tmp_path / "sky.exr", out=HERE, coverage=coverage))
    assert frames.frame(0).radiance.shape == (rows, 360, 3)


@pytest.mark.parametrize(("asked", "said"), [(None, False), (2, False), (3, True)])
def test_fewer_frames_than_asked_for_are_said(tmp_path, capsys, asked, said):
    for k in range(2):
        write_exr(tmp_path / f"{k}.exr", np.ones((8, 16, 3), np.float32))
    open_frames(LightsOptions(source=tmp_path, out=HERE, frames=asked))
    assert ("has 2 frames, and --frames asks for 3" in capsys.readouterr().err) == said


@pytest.mark.parametrize(("asked", "frames", "used"), [(None, 1, "none"), (None, 2, "auto"), ("adaptive", 1, "adaptive")])
def test_a_single_map_is_not_filtered_unless_asked(asked, frames, used):
    assert sampler_settings(LightsOptions(source=HERE, out=HERE, filter=asked), frames).filter == used


def test_options_become_settings_of_the_sampler():
    options = LightsOptions(source=HERE, out=HERE, count=5, method="standard", deflicker=True)
    found = sampler_settings(options, 2, clusters=3, error_percent=None)
    assert (found.count, found.method, found.deflicker, found.clusters, found.error_percent) == (5, "standard", True, 3, None)


def test_options_become_settings_of_the_renderer():
    options = RenderOptions(source=HERE, size=(32, 24), exposure=1.5, tone="exponential", background="map", shadow_map=64)
    assert renderer_settings(options) == Renderer(
        width=32, height=24, exposure=1.5, tone="exponential", background="map", shadow_map=64, light_regions=0
    )
    assert renderer_settings(RenderOptions(source=HERE, coverage="sphere")).light_regions is None  # the renderer's own choice


@pytest.mark.parametrize("size", [(0, 24), (32, 0), (MAX_PICTURE_SIDE + 1, 24)])
def test_a_picture_of_no_size_or_beyond_the_limit_is_refused(size):
    assert renderer_settings(RenderOptions(source=HERE, size=(MAX_PICTURE_SIDE, 1))).width == MAX_PICTURE_SIDE == 8192
    with pytest.raises(UserError, match=f"--size {size[0]}x{size[1]}: a side has 1 to 8192 pixels"):
        renderer_settings(RenderOptions(source=HERE, size=size))


class _Watched:
    """A source whose frames see how much of the file is written while they are made."""

    fps = 25.0

    def __init__(self, part: Path, count: int) -> None:
        self._part, self._count, self.rows = part, count, []

    def __len__(self) -> int:
        return self._count

    def frame(self, k: int) -> Frame:
        self.rows.append(self._part.read_bytes().count(b"\n") if k else 0)  # the first is made before the file is
        return Frame(np.full((6, 24, 3), 1.0 + k, np.float32), "hemisphere", k / 25, None, 0, 0)


@pytest.mark.parametrize("score", [False, True])
def test_lights_are_written_as_they_are_made(tmp_path, monkeypatch, score):
    source = _Watched(tmp_path / "l.part.jsonl", 5)
    monkeypatch.setattr(offline, "open_frames", lambda _: source)
    report = write_lights_file(LightsOptions(source=HERE, out=tmp_path / "l.jsonl", count=4, score=score))
    assert source.rows == [0, 1, 2, 3, 4]
    assert (tmp_path / "l.jsonl").read_bytes().count(b"\n") == 5
    assert ("score" in report.values) == score


def test_lights_that_are_killed_leave_whole_lines_that_are_read(tmp_path, monkeypatch):
    class Killed(_Watched):
        def frame(self, k: int) -> Frame:
            if k == 3:
                os.kill(os.getpid(), signal.SIGKILL)
            return super().frame(k)

    part = tmp_path / "l.part.jsonl"
    monkeypatch.setattr(offline, "open_frames", lambda _: Killed(part, 5))
    child = os.fork()
    if not child:
        write_lights_file(LightsOptions(source=HERE, out=tmp_path / "l.jsonl", count=4))
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    assert [path.name for path in tmp_path.iterdir()] == [part.name]
    assert [frame.sequence for frame in lights_frames(part)] == [0, 1, 2]


def test_lights_of_a_frame_that_cannot_be_read_leave_no_file(tmp_path):
    for k, data in enumerate((None, b"no image")):
        path = tmp_path / "in" / f"{k}.exr"
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data) if data else write_exr(path, np.ones((8, 16, 3), np.float32))
    with pytest.raises(UserError, match=r"1\.exr"):
        write_lights_file(LightsOptions(source=tmp_path / "in", out=tmp_path / "l.jsonl", count=4))
    assert [path.name for path in tmp_path.iterdir()] == ["in"]
