"""What the page saves: a run with that file gives the same lights and the same picture as the settings and what was chosen."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.renderer_steps import picture_of
from vemlight.capture.stage import CaptureSource
from vemlight.errors import UserError
from vemlight.light.images import write_exr
from vemlight.light.mask import Mask
from vemlight.light.sphere import latlong_directions
from vemlight.light.virtual_lamp import VirtualLamp
from vemlight.renderer.stage import RendererStage
from vemlight.runtime import wire
from vemlight.runtime.poses import Pose, View
from vemlight.runtime.session import SESSION
from vemlight.sampler.stage import SamplerStage
from vemlight.settings import Settings
from vemlight.settings_file import read_settings
from vemlight.viewer.saved_settings import saved_settings, settings_file

SCENE = """
[camera]
from = [0.0, -7.0, 4.0]
at = [0.0, 0.0, 0.4]
[[mesh]]
shape = "plane"
scale = 3.0
[[mesh]]
shape = "box"
scale = 0.4
at = [0.0, 0.0, 0.4]
"""
CHOSEN = wire.ControlMessage(
    count=20,
    exposure=0.5,
    filtered=False,
    poses=(Pose(name="box", position=(1.0, 0.5, 0.8), rotation=(0.0, 0.0, 0.6, 0.8), scale=1.5),),
    masks=(Mask(points=((80.0, 20.0), (160.0, 25.0), (120.0, 70.0))), Mask(points=((300.0, 50.0),), width_deg=20.0, mode="dark")),
    lamps=(VirtualLamp(id=2, azimuth_deg=200.0, elevation_deg=40.0, irradiance=(2.0, 1.0, 0.5)),),
    camera=View(eye=(3.0, -5.0, 2.0), at=(0.0, 0.0, 0.4), fov_y=50.0),
)


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    (tmp_path / "scene.toml").write_text(SCENE)
    sky = (1 + 4 * np.maximum(latlong_directions(32, 64) @ np.array([[0.5, 0.1, 0.8]] * 3).T, 0) ** 20).astype(np.float32)
    write_exr(tmp_path / "sky.exr", sky, {})
    (tmp_path / "first.toml").write_text(
        '[capture]\nsource = "sky.exr"\nrows = 18\ncols = 72\n[[capture.masks]]\npoints = [[0.0, 90.0]]\nwidth_deg = 5.0\n'
        '[renderer]\nscene = "scene.toml"\nwidth = 48\nheight = 36\npicture = "linear16"\nframe_ms = 0.0\n'
        '[[renderer.poses]]\nname = "box"\nposition = [-1.0, 0.0, 0.4]\n'
    )
    return read_settings(tmp_path / "first.toml")


def seen(settings: Settings, control: wire.ControlMessage | None) -> tuple[np.ndarray, np.ndarray]:
    """The lights' irradiance and the picture of the first frame."""
    capture, sampler, renderer = CaptureSource(settings), SamplerStage(settings), RendererStage(settings)
    lit, shown = sampler.start_at(0)[0], renderer.start_at(0)[0]
    if control:
        capture.on_control(control)
        lit, shown = sampler.on_message(lit, (control, ())), renderer.on_message(shown, (control, ()))
    _, lights = sampler.step(lit, capture.message(0, 0, 0.0))
    shown, _ = renderer.step(shown, lights)
    return lights[1][2], picture_of(shown)


def test_a_run_with_it_shows_the_same(settings, tmp_path):
    (tmp_path / "vemlight.toml").write_bytes(settings_file(settings, CHOSEN))
    lights, picture = seen(settings, CHOSEN)
    saved_lights, saved_picture = seen(read_settings(tmp_path / "vemlight.toml"), None)
    assert np.array_equal(lights, saved_lights)
    assert np.array_equal(picture, saved_picture)
    plain_lights, plain_picture = seen(settings, wire.ControlMessage())
    assert len(plain_lights) != len(lights)
    assert not np.allclose(plain_picture, picture, atol=0.02)


@pytest.mark.parametrize("control", [CHOSEN, wire.ControlMessage(), wire.ControlMessage(masks=(), lamps=())])
def test_it_is_read_as_what_was_meant(settings, tmp_path, control):
    (tmp_path / "vemlight.toml").write_bytes(settings_file(settings, control))
    assert read_settings(tmp_path / "vemlight.toml") == saved_settings(settings, control)
    if control.masks is None:
        assert saved_settings(settings, control) == settings


def test_poses_of_settings_and_page_are_joined_by_name(settings):
    other = Pose(name="plane", position=(0.0, 0.0, 0.1))
    joined = saved_settings(settings, wire.ControlMessage(poses=(other,))).renderer.poses
    assert {pose.name: pose.position for pose in joined} == {"box": (-1.0, 0.0, 0.4), "plane": (0.0, 0.0, 0.1)}


def test_no_secret_is_in_it(monkeypatch):
    monkeypatch.setenv(SESSION, "/run/1/session")
    source, token = "rtsp://me:secret@camera/live?key=secret", "0123456789secret"
    given = {"capture": {"source": source}, "viewer": {"token": token}, "wire": {"folder": "/run/1"}}
    settings = msgspec.convert(given, Settings)
    text = settings_file(settings, wire.ControlMessage()).decode()
    assert "secret" not in text
    assert 'source = "rtsp://camera/live"' in text
    assert text.count("# Left out:") == 2
    assert "/run/1" not in text


def test_a_second_runs_file_names_the_folder_that_it_shares_with_the_first(monkeypatch):
    """Without it the saved file is refused, since its sampler is elsewhere, in sockets of that folder."""
    monkeypatch.setenv(SESSION, "/run/1/session")
    wired = {"folder": "/run/studio", "names": {"renderer": "renderer.wall"}, "elsewhere": ["capture", "sampler"]}
    text = settings_file(msgspec.convert({"wire": wired}, Settings), wire.ControlMessage()).decode()
    assert msgspec.toml.decode(text)["wire"] == wired


def test_what_ends_with_the_run_is_left_out_in_a_line_each(settings):
    control = wire.ControlMessage(scene="0123456789abcdef", source="upload 0123456789abcdef", in_s=1.0)
    text = settings_file(settings, control).decode()
    assert [line.split(",")[0] for line in text.splitlines() if line.startswith("# Left out:")] == [
        "# Left out: the source that was chosen", "# Left out: the range that was played", "# Left out: the scene that was dropped"
    ]  # fmt: skip
    assert "0123456789abcdef" not in text
    assert "# Left out: that it was played once" in settings_file(settings, wire.ControlMessage(loop=False)).decode()


@pytest.mark.parametrize(("in_s", "out_s", "frames"), [
    (0.4, 1.0, range(7, 14)), (None, 0.5, range(3, 9)), (2.0, None, range(23, 33)), (99.0, 100.0, range(32, 33)),
])  # fmt: skip
def test_the_range_that_is_played_is_saved_in_frames(in_s, out_s, frames):
    """Of 30 frames at 10 a second, the first of which is number 3 of its folder."""
    own = msgspec.convert({"capture": {"source": "/own", "start": 3}}, Settings)
    plays = wire.SourceMessage(name="own", frames=30, fps=10.0)
    control = wire.ControlMessage(in_s=in_s, out_s=out_s)
    saved = saved_settings(own, control, plays).capture
    assert range(saved.start, saved.end) == frames
    assert "# Left out" not in settings_file(own, control, plays).decode()
    of_another = msgspec.structs.replace(plays, choice="bundled")  # which the capture has not left yet: its frames are others
    assert saved_settings(own, control, of_another) == own
    assert settings_file(own, control, of_another).decode().count("# Left out: the range that was played") == 1


def test_names_are_no_more_than_names(settings, tmp_path):
    """A name from a page stands in the file as text, whatever is in it."""
    name = '"]\n[viewer]\ninsecure = true\n# [ 1, ]'
    control = wire.ControlMessage(poses=(Pose(name=name, position=(1.0, 2.0, 3.0)),))
    (tmp_path / "vemlight.toml").write_bytes(settings_file(settings, control))
    saved = read_settings(tmp_path / "vemlight.toml")
    assert saved.renderer.poses[-1].name == name
    assert not saved.viewer.insecure


@pytest.mark.parametrize(("text", "line"), [
    ("[[capture.masks]]\npoints = [[0, 0], [1, 1]]\n", "3 points or more"),
    ("[[capture.masks]]\npoints = [[0, 0], [1, 95], [3, 3]]\n", "must be a number <= 90"),
    ('[[capture.masks]]\npoints = [[0, 0]]\nwidth_deg = 3\nmode = "drak"\n', "did you mean dark"),
    ("[[sampler.lamp]]\nid = 1\nazimuth_deg = 1\nelevation_deg = 2\nirradiance = [1, nan, 1]\n", "nan"),
    ("[[sampler.lamp]]\nid = 1\nazimuth_deg = 1\nelevation_deg = 2\n", "irradiance"),
    (2 * "[[sampler.lamp]]\nid = 1\nazimuth_deg = 1\nelevation_deg = 2\nirradiance = [1, 1, 1]\n", "give each its own"),
    ('[[renderer.poses]]\nname = "box"\nposition = [0, 0, 0]\nscale = 0\n', "must be a number >= 0.001"),
    ('[[renderer.poses]]\nname = "box"\nposition = [0, 0, 0]\nrotation = [0, 0, 0, 3]\n', "not a unit quaternion"),
])  # fmt: skip
def test_what_is_wrong_in_settings_is_said_in_a_line(tmp_path, text, line):
    (tmp_path / "wrong.toml").write_text(text)
    with pytest.raises(UserError, match=line) as refused:
        read_settings(tmp_path / "wrong.toml")
    assert str(refused.value).startswith(str(tmp_path / "wrong.toml"))


@pytest.mark.parametrize(("choice", "source"), [
    ("bundled", ""), ("recording monday", "/recordings/monday"), ("camera video2", "/dev/video2"),
    ("upload 0123456789abcdef", "/own.exr"), ("recent", "/own.exr"), ("camera ../sda", "/own.exr"), ("recording ..", "/own.exr"),
])  # fmt: skip
def test_a_chosen_source_is_kept_where_it_lasts(choice, source):
    own = msgspec.convert({"capture": {"source": "/own.exr", "rows": 45, "recordings": "/recordings", "layer": "own"}}, Settings)
    saved = saved_settings(own, wire.ControlMessage(source=choice))
    assert (saved.capture.source, saved.capture.rows) == (source, 45)
    assert (saved.capture.layer == "own") == (source == "/own.exr")
    left_out = b"# Left out: the source that was chosen" in settings_file(own, wire.ControlMessage(source=choice))
    assert left_out == (source == "/own.exr")


def test_the_speed_is_kept_and_a_range_is_said_not_to_be():
    control = wire.ControlMessage(speed=2.0, in_s=1.0)
    assert saved_settings(Settings(), control).capture.speed == 2.0
    assert b"# Left out: the range" in settings_file(Settings(), control)
