"""The source that plays: chosen by names that lead nowhere else, opened beside the one that goes on, left when it fails; and recording."""

import errno
import os
import time
from collections import namedtuple
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.stream_server import jpeg, serving
from vemlight.capture import live_recording, recent, recorder
from vemlight.capture.choosing import BUNDLED_CHOICE, OFFERED, RECENT_CHOICE, ChosenSources, chosen_capture, recordings
from vemlight.capture.frames import Frame
from vemlight.capture.live_recording import MIN_FREE, NO_CAMERA, NO_FOLDER
from vemlight.capture.recent import RECENT_S, RecentFrames, frame_bytes
from vemlight.capture.stage import CaptureCamera, CaptureSource, source_name
from vemlight.errors import UserError
from vemlight.light.images import write_exr
from vemlight.runtime.session import READY, SESSION, make_session
from vemlight.runtime.wire import ControlMessage, SourceMessage, pack, unpack
from vemlight.settings import Capture, Settings

SRGB: dict[str, Any] = {"transfer": "srgb", "primaries": "bt709", "matrix": "bt601", "range": "full"}
UPLOAD = "0123456789abcdef"
PATIENCE_S = 30.0


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    make_session(tmp_path / "session")
    monkeypatch.setenv(SESSION, str(tmp_path / "session"))
    return tmp_path / "session"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A recordings folder beside a file that nobody may play."""
    folder = tmp_path / "recordings"
    (folder / "dusk").mkdir(parents=True)
    for k in range(3):
        write_exr(folder / "dusk" / f"dusk_{k}.exr", np.full((8, 16, 3), 1.0 + k, np.float32))
    write_exr(tmp_path / "secret.exr", np.ones((8, 16, 3), np.float32))
    (folder / "broken.hdr").write_bytes(b"no picture")
    (folder / "notes.txt").write_text("no source")
    return folder


@pytest.fixture
def sources(folder: Path, session: Path) -> Iterator[ChosenSources]:
    made = ChosenSources(Settings(capture=Capture(source=str(folder / "dusk"), rows=8, cols=32, recordings=str(folder))))
    yield made
    made.close()


def about(sources: ChosenSources) -> SourceMessage:
    header, _ = sources.about()
    assert isinstance(header, SourceMessage)
    return header


def settled(sources: ChosenSources, **control) -> SourceMessage:
    """What is said when a choice was opened or refused."""
    sources.on_control(ControlMessage(**control))
    until_s = time.monotonic() + PATIENCE_S
    while sources._opening and time.monotonic() < until_s:
        if sources.changed():
            sources.advance()
        time.sleep(0.01)
    return about(sources)


def test_what_may_be_chosen_is_what_can_be_played(sources, folder):
    offered = [choice.choice for choice in about(sources).choices]
    assert [choice for choice in offered if not choice.startswith("camera ")] == [
        BUNDLED_CHOICE, "recording broken.hdr", "recording dusk",
    ]  # fmt: skip
    assert recordings("") == recordings(str(folder / "nowhere")) == []


def test_of_too_many_recordings_the_newest_are_offered_and_all_can_be_named(sources, folder, capsys):
    for k in range(OFFERED + 5):
        (folder / f"shot_{k:03d}").mkdir()
        os.utime(folder / f"shot_{k:03d}", (0, 2e9 - k))  # the last by name is the oldest
    assert recordings(str(folder)) == [f"shot_{k:03d}" for k in range(OFFERED)]
    assert f"the {OFFERED} that were changed last" in capsys.readouterr().err
    assert "shot_050: holds none" in settled(sources, source="recording shot_050").refusal
    assert "there is no such file" in settled(sources, source="recording gone.hdr").refusal


def test_another_source_is_opened_while_this_one_plays(sources):
    before = sources.current
    said = settled(sources, source=BUNDLED_CHOICE)
    assert (said.choice, said.refusal, said.frames) == (BUNDLED_CHOICE, "", 48)
    assert sources.current is not before
    assert settled(sources).choice is None
    assert about(sources).name == "dusk"


LEADS_OUT = [
    "recording ../secret.exr", "recording /etc/passwd", "recording ..", "recording dusk/dusk_0.exr", "recording notes.txt", "recording ",
    "upload ../ready", f"upload {UPLOAD}", "upload", "camera ../shm", "camera video99", "file:///etc/passwd", "/dev/video0", RECENT_CHOICE,
]  # fmt: skip


@pytest.mark.parametrize("choice", LEADS_OUT)
def test_a_name_that_is_not_offered_opens_nothing(sources, choice):
    before = sources.current
    said = settled(sources, source=choice)
    assert said.choice is None
    assert sources.current is before
    assert said.refusal.startswith(choice[:20])
    assert len(said.refusal.splitlines()) == 1


def test_a_refused_choice_is_tried_once_and_forgotten_with_the_next(sources, monkeypatch):
    tried = []
    opened = sources._opened
    monkeypatch.setattr(sources, "_opened", lambda choice: (tried.append(choice), opened(choice))[1])
    for _ in range(3):  # controls come twice a second
        said = settled(sources, source="recording broken.hdr")
    assert tried == ["recording broken.hdr"]
    assert "is no Radiance picture" in said.refusal
    assert "/" not in said.refusal
    assert settled(sources).refusal  # it stays to be read
    settled(sources, source="recording broken.hdr")
    assert len(tried) == 2


def test_an_upload_is_played_by_its_number(sources, session):
    (session / READY / UPLOAD).mkdir()
    write_exr(session / READY / UPLOAD / "sky.exr", np.ones((8, 16, 3), np.float32))
    assert (said := settled(sources, source=f"upload {UPLOAD}")).choice == f"upload {UPLOAD}"
    assert (said.frames, said.name) == (1, "sky.exr")


def test_a_source_that_fails_while_it_plays_gives_way_to_the_settings_one(sources):
    settled(sources, source=BUNDLED_CHOICE)
    sources.fall_back(UserError("frame 7 is damaged"))
    said = about(sources)
    assert (said.choice, said.name) == (None, "dusk")
    assert "frame 7 is damaged" in said.refusal
    with pytest.raises(UserError, match="gone"):  # and from that there is nowhere to go
        sources.fall_back(UserError("gone"))


def test_a_chosen_source_is_read_by_none_of_the_settings_keys_for_their_own():
    own = Capture(source="/dev/video0", lens="lens.toml", rows=45, ground=0.3, exposures=(0.01, 0.001), controls={"gain": 3}, frames=9)
    chosen = chosen_capture(own, "clip")
    assert chosen == Capture(source="clip", rows=45, ground=0.3)


@pytest.fixture
def camera(folder: Path, session: Path) -> Iterator[ChosenSources]:
    """A stream's pictures, of which a few have come."""
    pictures = [jpeg(np.full((16, 32, 3), 20 * k, np.uint8)) for k in range(1, 10)]
    with serving(pictures, fps=40) as server:
        made = ChosenSources(Settings(capture=Capture(source=server.address, rows=8, cols=32, recordings=str(folder), **SRGB)))
        assert isinstance(made.current, CaptureCamera)
        receive(made, 8)
        yield made
        made.close()


def receive(sources: ChosenSources, count: int) -> list[float]:
    """The mean radiance of the camera's next frames."""
    means: list[float] = []
    until_s = time.monotonic() + PATIENCE_S
    while len(means) < count and time.monotonic() < until_s:
        message, _ = sources.current.message(0.5)  # type: ignore[call-arg, misc]
        if message:
            means.append(float(message[1][0].mean()))
    return means


def received_until(sources: ChosenSources, wanted: Callable[[SourceMessage], Any]) -> SourceMessage:
    """Receives frames until what is said of the source is as wanted."""
    until_s = time.monotonic() + PATIENCE_S
    while not wanted(said := about(sources)) and time.monotonic() < until_s:
        receive(sources, 1)
    return said


def test_the_last_seconds_of_a_camera_can_be_looked_at_again(camera):
    said = about(camera)
    assert said.recent_s > 0
    assert 8 * 8 * 32 * 3 * 4 <= said.recent_bytes == sum(map(frame_bytes, camera.current.recent._frames))
    assert RECENT_CHOICE in [choice.choice for choice in said.choices]
    seen = [frame.radiance.mean() for frame in camera.current.recent._frames]
    said = settled(camera, source=RECENT_CHOICE)
    assert (said.choice, said.frames) == (RECENT_CHOICE, 8)
    assert isinstance(camera.current, CaptureSource)
    assert [camera.current.message(k, k, 0.0)[1][0].mean() for k in range(8)] == pytest.approx(seen)


def test_a_recording_is_made_of_a_camera_and_can_be_chosen(camera, folder):
    camera.on_control(ControlMessage(record=True))
    receive(camera, 6)
    said = about(camera)
    assert said.recording
    assert said.free_bytes > 0
    camera.on_control(ControlMessage(record=False))
    assert about(camera).recording == ""
    name = next(name for name in recordings(str(folder)) if name.startswith("20"))
    said = settled(camera, source=f"recording {name}")
    assert (said.choice, said.frames) == (f"recording {name}", 6)


def test_a_recording_ends_before_the_disk_is_full(camera, monkeypatch):
    camera.on_control(ControlMessage(record=True))
    receive(camera, 2)
    usage = namedtuple("usage", "free")
    monkeypatch.setattr(live_recording.shutil, "disk_usage", lambda _: usage(MIN_FREE - 1))
    said = about(camera)
    assert said.recording == ""
    assert "the disk has under" in said.refusal
    camera.on_control(ControlMessage(record=True))  # the same wish comes again: it does not begin anew
    assert about(camera).recording == ""
    assert "make room" in about(camera).why_not_record


def test_a_disk_that_refuses_is_said_while_the_light_is_on_and_the_recording_goes_on(camera, folder, monkeypatch):
    refuses = [True]

    def full(*frame) -> None:
        if refuses[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        write_exr(*frame)

    monkeypatch.setattr(recorder, "write_exr", full)
    camera.on_control(ControlMessage(record=True))
    said = received_until(camera, lambda said: said.refusal)
    assert said.recording
    assert said.refusal == f"the recording {said.recording}: frames are not recorded (No space left on device) until there is room"
    assert str(folder) not in said.refusal
    refuses[0] = False
    said = received_until(camera, lambda said: said.recorded_frames)
    assert (said.refusal, bool(said.recording)) == ("", True)


def test_a_recording_ends_with_its_source_and_none_begins_by_itself_on_another(camera, folder, monkeypatch):
    camera.on_control(ControlMessage(record=True))
    receive(camera, 2)
    said = settled(camera, source=BUNDLED_CHOICE, record=True)
    assert (said.choice, said.recording) == (BUNDLED_CHOICE, "")
    assert "has ended: another source plays" in said.refusal
    settled(camera, record=True)
    assert isinstance(camera.current, CaptureCamera)
    camera.on_control(ControlMessage(record=True))  # the page's wish stands, and comes twice a second
    assert about(camera).recording == ""
    camera.on_control(ControlMessage())
    monkeypatch.setattr(live_recording.time, "strftime", lambda _: next(folder.glob("20*")).name)  # within the same second
    camera.on_control(ControlMessage(record=True))  # asked for anew
    assert about(camera).recording.endswith("_2")


def test_a_recording_ends_when_its_camera_fails(camera):
    camera.on_control(ControlMessage(record=True))
    receive(camera, 2)
    camera.choice = "camera video9"
    camera.fall_back(UserError("is gone"))
    said = about(camera)
    assert (said.choice, said.recording) == (None, "")
    assert camera.current.recorder is None


def test_what_is_said_of_a_source_can_be_read_however_long_its_names_are(sources, monkeypatch):
    long = Capture(source=f"rtsp://camera/{4000 * 'x'}")
    name = source_name(long)
    odd = source_name(Capture(source=f"/a/{os.fsdecode(bytes([255]))}b"))
    for text in (name, odd):
        monkeypatch.setattr(sources.current, "name", text)
        monkeypatch.setattr(sources._recording, "refusal", 4000 * "y")
        header, arrays = sources.about()
        assert unpack(pack(header, arrays))[0] == header
    assert (name[:20], odd) == ("rtsp://camera/xxxxxx", " b")


def test_what_cannot_be_recorded_is_said_before(sources, camera):
    assert about(sources).why_not_record == NO_CAMERA
    camera._recording._folder = None
    assert about(camera).why_not_record == NO_FOLDER


def frame(time_s: float) -> Frame:
    return Frame(np.zeros((10, 10, 3), np.float32), "hemisphere", time_s, None, 0, 0)


def test_the_frames_in_memory_are_bounded_in_time_and_in_bytes(monkeypatch):
    kept = RecentFrames()
    for k in range(400):
        kept.add(frame(k / 20))
    assert kept.span_s == pytest.approx(RECENT_S)
    assert kept.nbytes == len(kept._frames) * 1200
    monkeypatch.setattr(recent, "MAX_BYTES", 12_000)
    kept.add(frame(20.0))
    assert (len(kept._frames), kept.nbytes) == (10, 12_000)
    frozen = kept.frozen()
    kept.add(frame(20.05))
    assert (len(frozen), frozen.fps) == (10, pytest.approx(20.0))
    assert frozen.frame(9).time_s == 20.0
