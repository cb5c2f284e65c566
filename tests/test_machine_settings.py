"""`vemlight doctor --write`: the largest pictures that keep up and hold their rate, in a file that a run reads."""

from collections.abc import Generator
from pathlib import Path

import msgspec
import pytest

from tests.support.processes import vemlight
from vemlight.commands.doctor import Finding
from vemlight.commands.machine_settings import (
    ENOUGH_LIGHTS,
    HOLDS,
    SIDES,
    WATCH_S,
    WINDOW_S,
    Fit,
    Window,
    candidates,
    check_new,
    fitting,
    settings_text,
    tried,
    wanted_hz,
    write_fit,
)
from vemlight.errors import UserError
from vemlight.settings import Capture, Fixtures, Renderer, Settings, Wire
from vemlight.settings_file import read_settings

SETTINGS = Settings(renderer=Renderer(width=480, height=270))


class Machine:
    """One that draws so many megapixels a second, with rates that swing by a part, and these lights."""

    def __init__(self, megapixels_s: float, swing: float = 0.0, lights: int = 60) -> None:
        self.megapixels_s, self.swing, self.lights = megapixels_s, swing, lights
        self.tried: list[int] = []
        self.ended = 0

    def windows(self, settings: Settings) -> Generator[Window, None, None]:
        drawn = settings.renderer
        self.tried.append(drawn.width)
        rate_hz = min(wanted_hz(settings), self.megapixels_s * 1e6 / (drawn.width * drawn.height))
        try:
            for k in range(100):
                yield Window(rate_hz * (1 + self.swing * (-1) ** k), self.lights)
        finally:
            self.ended += 1


def test_the_largest_picture_that_keeps_up_is_taken_and_every_run_is_ended():
    machine, said = Machine(0.95), []
    fit = fitting(SETTINGS, False, machine.windows, said.append)
    assert machine.tried == [480, 360]  # 7.3 a second are less than 0.75 of 10; none larger without a GPU
    assert (fit.settings.renderer.width, fit.settings.renderer.height) == (360, 202)
    assert fitting(SETTINGS, False, Machine(1.0).windows, said.append).settings.renderer.width == 480  # 7.7 a second
    assert machine.ended == len(machine.tried)


def test_a_gpu_starts_with_more():
    machine = Machine(1000.0)
    fit = fitting(SETTINGS, True, machine.windows, lambda _: None)
    assert machine.tried == [960]
    assert fit.rate_hz == pytest.approx(25.0)  # the source's
    assert len(fit.windows) == WATCH_S / WINDOW_S


def test_a_rate_that_swings_is_not_held():
    assert fitting(SETTINGS, False, Machine(100.0, 0.9 * HOLDS).windows, lambda _: None).departure <= HOLDS
    machine = Machine(100.0, 1.2 * HOLDS)
    with pytest.raises(UserError, match=r"no size of the picture holds its rate .*departs by 12%"):
        fitting(SETTINGS, False, machine.windows, lambda _: None)
    assert len(machine.tried) == sum(side <= 1 for side in SIDES) == machine.ended


def test_too_few_lights_are_not_enough():
    with pytest.raises(UserError, match="with 19 lights"):
        fitting(SETTINGS, False, Machine(100.0, lights=ENOUGH_LIGHTS - 1).windows, lambda _: None)
    assert fitting(SETTINGS, False, Machine(100.0, lights=ENOUGH_LIGHTS).windows, lambda _: None)


def test_candidates_keep_the_target_that_the_settings_name():
    for candidate in candidates(msgspec.structs.replace(SETTINGS, renderer=Renderer(frame_ms=50.0)), True):
        assert candidate.renderer.frame_ms == 50.0
        assert candidate.renderer.width % 2 == candidate.renderer.height % 2 == 0
    assert wanted_hz(Settings(capture=Capture(fps=5.0))) == 5.0


def test_what_is_written_is_read_again(tmp_path: Path):
    path = tmp_path / "vemlight.toml"
    fit = Fit(msgspec.structs.replace(SETTINGS, renderer=Renderer(width=360, height=202, frame_ms=100.0)), 6 * (Window(9.5, 33),))
    write_fit(path, fit, [Finding("pass", "camera", "/dev/video0: a camera, YUYV, MJPG"), Finding("pass", "disk", "1 GB free")])
    written = path.read_text()
    assert read_settings(path).renderer == fit.settings.renderer
    assert "# camera: /dev/video0: a camera, YUYV, MJPG" in written
    assert "disk" not in written
    assert "# 360 x 202: 9.5 pictures a second for 60 s, within 0%, with 33 lights or more" in written
    assert list(tmp_path.iterdir()) == [path]


def test_a_trial_writes_no_files_and_does_not_end(tmp_path: Path):
    """And its settings can be read: what it leaves out, nothing else asks for."""
    capture = Capture(record="rec", recordings="recs", frames=30)
    wanted = Settings(out="out", capture=capture, renderer=Renderer(width=480, height=270, video="film.mp4"))
    (tmp_path / "tried.toml").write_bytes(settings_text(tried(wanted, 8090)))
    found = read_settings(tmp_path / "tried.toml")
    assert (found.out, found.capture.record, found.capture.recordings, found.capture.frames, found.renderer.video) == ("", "", "", 0, "")
    assert (found.viewer.port, found.renderer.width) == (8090, 480)


def test_what_cannot_be_tried_is_refused_before_anything_runs(tmp_path: Path):
    there = tmp_path / "there.toml"
    there.write_text("")
    for path, settings, words in (
        (there, SETTINGS, "exists already"),
        (tmp_path / "no" / "file.toml", SETTINGS, "no folder"),
        (tmp_path / "new.toml", Settings(mode="lossless"), "lossless"),
        (tmp_path / "new.toml", Settings(wire=Wire(elsewhere=("capture",))), "leave out elsewhere"),
        (tmp_path / "new.toml", Settings(fixtures=Fixtures(rig="rig.toml")), "rig"),
    ):
        with pytest.raises(UserError, match=words):
            check_new(path, settings)
    ended = vemlight("doctor", "--write", str(there))
    assert (ended.returncode, ended.stdout) == (2, "")
    assert ended.stderr.count("\n") == 1
