"""`vemlight run`: starts, watches, restarts, and leaves nothing behind."""

import os
import signal
import tempfile
from pathlib import Path

import pytest

from tests.support.lights_files import read_lights
from tests.support.processes import LOADED_S, MessageListener, children, is_running, wait_until
from vemlight.errors import UserError
from vemlight.runtime import supervise, wire
from vemlight.runtime.restarts import AGAIN_S, MAX_DEATHS
from vemlight.runtime.supervise import RUN_FOLDER
from vemlight.settings import Settings, Viewer
from vemlight.settings_file import read_settings

SPARE = {"runtime.spare"}  # comes when all have been working for a while


def no_run_folder(pid: int) -> bool:
    return not (Path(tempfile.gettempdir()) / f"{RUN_FOLDER}{pid}").exists()


def test_a_run_with_an_end_writes_everything_and_leaves_nothing(run, tmp_path):
    settings, process = run("--frames", "5", "--out", str(tmp_path / "out"))
    output, errors = process.communicate(timeout=LOADED_S)
    assert process.returncode == 0, errors.decode()
    assert f"http://127.0.0.1:{settings.viewer.port}" in output.decode()
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {f"frame_{k:04d}.{kind}" for k in range(5) for kind in ("exr", "png")} | {
        "lights.jsonl",
        "manifest.jsonl",
        "contact.png",
    }
    assert [row.sequence for row in read_lights(tmp_path / "out" / "lights.jsonl")] == list(range(5))
    assert not list(Path(settings.wire.folder).iterdir())
    assert no_run_folder(process.pid)


def test_what_a_killed_run_left_goes_even_where_the_next_one_has_its_number(tmp_path, monkeypatch):
    """In a container that is started again every run has the same."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for name in (os.getpid(), 2**22 + 1, 10**30, os.getppid(), "x"):
        (tmp_path / f"{RUN_FOLDER}{name}" / "session").mkdir(parents=True)
    supervise._remove_dead_runs()
    assert {path.name for path in tmp_path.iterdir()} == {f"{RUN_FOLDER}{name}" for name in (10**30, os.getppid(), "x")}


def test_a_full_disk_for_a_runs_folder_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    with pytest.raises(UserError, match=r"vemlight-run-\d+: cannot be made \(No such file"):
        supervise._run(Settings())


def test_killed_services_come_back_with_a_visible_count_and_sigterm_ends_all(run):
    settings, process = run()
    listener = MessageListener(settings, "lights", "image", "status")
    try:
        listener.next(wire.ImageMessage)
        before = children(process.pid)
        assert before.keys() - SPARE == {"capture", "sampler", "renderer", "viewer"}
        for service, kind in (("sampler", wire.LightsMessage), ("renderer", wire.ImageMessage)):
            os.kill(before[service], signal.SIGKILL)
            listener.next(wire.StatusMessage, lambda status, service=service: status.service == service and status.restarts == 1)
            listener.next(kind)
        folder = Path(tempfile.gettempdir()) / f"{RUN_FOLDER}{process.pid}"
        wait_until(lambda: not [*folder.glob("*.restarting")], "nobody being called restarting any more")
        after = children(process.pid)
        assert {name for name in before.keys() - SPARE if after[name] != before[name]} == {"sampler", "renderer"}
    finally:
        listener.close()
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=10)
    assert process.returncode == 0
    assert "sampler was killed by SIGKILL; restart 1" in errors.decode()
    assert not any(is_running(pid) for pid in after.values())
    assert not list(Path(settings.wire.folder).iterdir())


def test_no_orphan_when_the_supervisor_itself_is_killed(run):
    settings, process = run()
    listener = MessageListener(settings, "status")
    try:
        listener.next(wire.StatusMessage)
    finally:
        listener.close()
    started = children(process.pid)
    os.kill(started["sampler"], signal.SIGSTOP)  # hears no other signal than SIGKILL
    process.kill()
    process.wait()
    wait_until(lambda: not any(is_running(pid) for pid in started.values()), "the end of the services", 1)


def test_ctrl_c_gives_130_and_the_same_command_goes_on(run, tmp_path):
    out = tmp_path / "out"
    _, process = run("--out", str(out))
    wait_until(lambda: len(list(out.glob("*.png"))) > 2, "some pictures")
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "is partial" in errors.decode()
    assert "the same command goes on from there" in errors.decode()
    first = (out / "frame_0000.exr").stat().st_mtime_ns
    _, process = run("--out", str(out))
    _, errors = process.communicate(timeout=LOADED_S)
    assert process.returncode == 0, errors.decode()
    assert "going on from picture" in errors.decode()
    assert (out / "frame_0000.exr").stat().st_mtime_ns == first
    assert len(list(out.glob("*.exr"))) == 16


def test_what_a_service_cannot_use_ends_the_run_with_its_line(run):
    _, process = run(renderer={"scene": "nowhere.toml"})
    _, errors = process.communicate(timeout=LOADED_S)
    assert process.returncode == 2
    (line,) = (line for line in errors.decode().splitlines() if "starting;" not in line)  # printed where the start is slow
    assert "nowhere.toml" in line


def test_a_service_that_dies_again_and_again_is_given_up(run):
    _, process = run()
    killed: set[int] = set()

    def kill_the_sampler() -> bool:
        pid = children(process.pid).get("sampler")
        if pid and pid not in killed:
            os.kill(pid, signal.SIGKILL)
            killed.add(pid)
        return process.poll() is not None

    wait_until(kill_the_sampler, "the end of the run")
    assert process.returncode == 1
    assert len(killed) == MAX_DEATHS
    assert f"sampler died {MAX_DEATHS} times" in process.communicate()[1].decode()


@pytest.fixture
def clock(monkeypatch, tmp_path) -> list[float]:
    """What time it is, in a folder of its own, as a child whose settings lie here leaves notes beside them."""
    monkeypatch.chdir(tmp_path)
    now = [100.0]
    monkeypatch.setattr(supervise.time, "monotonic", lambda: now[0])
    return now


def deaths(clock: list[float], interval_s: float) -> list[str | None]:
    """A service that dies every so often: the reasons to give up, None for a restart."""
    child, reasons = supervise.Child("sampler", Path("vemlight.toml")), []
    for _ in range(8):
        reasons.append(child.plan_restart(-signal.SIGKILL))
        clock[0] += interval_s
    return reasons


class StartedProcess:
    """Instead of subprocess.Popen."""

    def __init__(self, *arguments: object, **options: object) -> None:
        pass


def restart_delays_s(clock: list[float], lifetime_s: float, monkeypatch) -> list[float]:
    """What four restarts wait for, of a service that dies `lifetime_s` after each start."""
    monkeypatch.setattr(supervise.subprocess, "Popen", StartedProcess)
    child, delays = supervise.Child("sampler", Path("vemlight.toml")), []
    child.start()
    for _ in range(4):
        clock[0] += lifetime_s
        died_s = clock[0]
        assert child.plan_restart(1) is None
        while not child.is_due():
            clock[0] += 0.125
        delays.append(clock[0] - died_s)
        child.start()
    assert child.deaths.restarts == 4
    return delays


def test_a_service_that_dies_of_starting_is_restarted_later_and_later(clock, monkeypatch):
    assert restart_delays_s(clock, 3.0, monkeypatch) == [0.5, 1, 2, 2]


def test_a_service_that_worked_is_restarted_at_once(clock, monkeypatch):
    assert restart_delays_s(clock, 10.0, monkeypatch) == [0, 0, 0, 0]


def test_five_deaths_within_a_minute_are_too_many(clock):
    *restarts, reason = deaths(clock, 14.9)[:5]
    assert restarts == [None] * 4
    assert reason
    assert reason.startswith("sampler died 5 times in 60 s (was killed by SIGKILL)")
    assert deaths(clock, 15.1) == [None] * 8


def test_one_of_several_cameras_is_tried_again_for_ever_but_not_often(clock):
    child, delays = supervise.Child("capture.left", Path("vemlight.toml")), []
    for _ in range(8):
        assert child.plan_restart(2, may_fail=True) is None
        died_s = clock[0]
        while not child.is_due():
            clock[0] += 0.25
        delays.append(clock[0] - died_s)
        child.deaths.on_start()
        clock[0] += 1.0
    assert delays[:4] == [0, 0.5, 1, 2], "as any service"
    assert delays[4:] == 4 * [AGAIN_S]


def test_a_restarted_viewer_requires_the_same_token(monkeypatch):
    seen = []

    class SupervisorStub:
        def __init__(self, settings: Settings, file: Path) -> None:
            seen.append((settings.viewer.token, read_settings(file).viewer.token, file.parent.stat().st_mode & 0o077))

        def run(self) -> int:
            return 0

    monkeypatch.setattr(supervise, "Supervisor", SupervisorStub)
    for host in ("0.0.0.0", "127.0.0.1"):
        assert supervise.supervise(Settings(viewer=Viewer(host=host))) == 0
    (token, in_file, others), (none, none_in_file, _) = seen
    assert token == in_file
    assert len(token) >= 32
    assert others == 0  # nobody else reads the file
    assert none == none_in_file == ""


@pytest.mark.parametrize(("rate_hz", "said"), [(0.0, ""), (24.96, ", 25.0 a second"), (0.5, ", 0.5 a second"), (0.05, ", one in 20 s")])
def test_the_pace_of_slow_pictures_is_said_in_seconds(rate_hz, said):
    assert supervise.pace(rate_hz) == said
