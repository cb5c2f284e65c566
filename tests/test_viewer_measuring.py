"""Settings for this machine, found from the page: what is told of the child that looks for them, what is kept, and that it ends."""

import asyncio
import sys
from pathlib import Path

import pytest
import tomli_w

from tests.support.processes import is_running
from vemlight.errors import UserError
from vemlight.settings import Capture, Renderer, Rig, Settings, Viewer
from vemlight.settings_file import read_settings
from vemlight.viewer import measuring
from vemlight.viewer.measuring import Measuring, said
from vemlight.viewer.viewer_state import ViewerState

SETTINGS = Settings(viewer=Viewer(port=8123), renderer=Renderer(width=650))
FOUND = """
import sys
given, _, found = sys.argv[1:]
print("pass  processor: 2 cores")
print("warn  camera: none\\n      -> plug one in")
print("      480 x 270: 9.1 pictures a second for 60 s, within 3%", file=sys.stderr)
open(found, "w").write("# on this machine\\n" + open(given).read().replace("width = 650", "width = 480"))
print(f"wrote {found}: vemlight run {found}")
"""
FAILS = """
import sys
print("fail  OpenGL: does not start\\n      -> install it\\npass  page: this machine only")
sys.exit(1)
"""
WAITS = """
import os, subprocess, sys, time
run = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
print(f"{os.getpid()} {run.pid}", flush=True)
try:
    time.sleep(600)
finally:
    run.terminate()
    run.wait()
"""


@pytest.fixture
def doctor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Puts a script in place of `vemlight doctor`."""

    def put(text: str) -> None:
        (tmp_path / "doctor.py").write_text(text)
        monkeypatch.setattr(measuring, "COMMAND", (sys.executable, str(tmp_path / "doctor.py")))

    return put


def measured(settings: Settings) -> Measuring:
    """One that has come to its end."""
    made = Measuring()

    async def whole() -> None:
        await made.start(settings)

    asyncio.run(whole())
    return made


def test_what_is_found_is_kept_with_the_port_of_the_page(doctor, tmp_path):
    doctor(FOUND)
    made = measured(SETTINGS)
    assert made.summary() == {"state": "done", "text": "480 x 270: 9.1 pictures a second for 60 s, within 3%"}
    (tmp_path / "found.toml").write_bytes(made.file)
    found = read_settings(tmp_path / "found.toml")
    assert (found.viewer.port, found.renderer.width) == (8123, 480)


def test_what_fails_is_told_with_the_way_out(doctor):
    doctor(FAILS)
    made = measured(SETTINGS)
    assert made.summary() == {"state": "failed", "text": "OpenGL: does not start; install it"}
    assert made.file == b""


def test_a_child_that_says_nothing_and_fails_has_failed(doctor):
    doctor("raise SystemExit(2)")
    assert measured(SETTINGS).state == "failed"


async def pids_of(made: Measuring) -> list[int]:
    """Those of the child that waits and of what it has started, once it has said them."""
    async with asyncio.timeout(60):
        while not made.text[:1].isdigit():
            await asyncio.sleep(0.02)
    return [int(pid) for pid in made.text.split()]


def test_one_at_a_time_and_stopping_leaves_no_process(doctor):
    doctor(WAITS)

    async def whole() -> list[int]:
        made = Measuring()
        made.start(SETTINGS)
        pids = await pids_of(made)
        with pytest.raises(UserError, match="going on already"):
            made.start(SETTINGS)
        assert all(is_running(pid) for pid in pids)
        await made.stop()
        assert made.summary() == {"state": "idle", "text": ""}
        return pids

    assert not any(is_running(pid) for pid in asyncio.run(whole()))


def test_a_child_that_does_not_end_is_killed_with_what_it_started(doctor, monkeypatch):
    monkeypatch.setattr(measuring, "END_S", 0.3)
    doctor("import signal\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n" + WAITS)

    async def whole() -> list[int]:
        made = Measuring()
        made.start(SETTINGS)
        pids = await pids_of(made)
        await made.stop()
        return pids

    assert not any(is_running(pid) for pid in asyncio.run(whole()))


def rig_file(folder: Path, *sources: str) -> str:
    """A rig's file with a camera of each source."""
    cameras = [{"name": f"c{k}", "source": source, "at": [float(k), 0.0, 1.0]} for k, source in enumerate(sources)]
    (folder / "rig.toml").write_text(tomli_w.dumps({"camera": cameras}))
    return str(folder / "rig.toml")


def test_what_one_run_holds_is_not_given_to_another(tmp_path):
    with pytest.raises(UserError, match="a camera serves one run at a time"):
        Measuring().start(Settings(capture=Capture(source="/dev/video0")))
    with pytest.raises(UserError, match="cameras of a rig serve one run at a time"):
        Measuring().start(Settings(rig=Rig(file=rig_file(tmp_path, "recorded", "/dev/video0"))))


def test_a_rig_of_recordings_is_measured(doctor, tmp_path):
    doctor(FOUND)

    async def whole() -> str:
        made = Measuring()
        await made.start(Settings(rig=Rig(file=rig_file(tmp_path, "left", "right"))))
        return made.state

    assert asyncio.run(whole()) == "done"


def test_the_newest_line_is_told_unless_something_fails():
    assert said([]) == ""
    assert said(["pass  system: Linux", "warn  disk: little", "-> make room"]) == "disk: little"
    assert said(["fail  scene: cannot be drawn", "-> mend it", "pass  disk: much"]) == "scene: cannot be drawn; mend it"
    assert said(["vemlight: no size of the picture holds its rate"]) == "no size of the picture holds its rate"


def test_what_is_seen_stands_still_meanwhile(doctor):
    doctor(FOUND)

    async def whole() -> list[bool]:
        state = ViewerState(SETTINGS, 0)
        state.measure()
        paused = [state.control.paused]
        async with asyncio.timeout(60):
            while state.measuring.state == "running":
                await asyncio.sleep(0.02)
        await asyncio.sleep(0)
        paused.append(state.control.paused)
        state.set_control(b'{"paused": true}')
        state.measure()
        async with asyncio.timeout(60):
            while state.measuring.state == "running":
                await asyncio.sleep(0.02)
        await asyncio.sleep(0)
        return [*paused, state.control.paused]

    assert asyncio.run(whole()) == [True, False, True]  # and a person's pause stays


def test_in_lossless_mode_nothing_is_tried():
    with pytest.raises(UserError, match="lossless mode"):
        ViewerState(Settings(mode="lossless"), 0).measure()
