"""Wrong inputs of every kind: status 2, one line that names what is wrong and the way out, and nothing left behind."""

import os
import re
import shutil
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from tests.support.processes import free_port, vemlight
from tests.support.wrong_input_files import CAMERA, SCENES, SETTINGS, write_wrong_inputs
from tests.support.wrong_inputs import WRONG, Wrong
from vemlight.commands.cli import main
from vemlight.commands.parameters import Number

ROOT = Path(__file__).parents[1]
INTERNAL = re.compile(r"Errno|object at 0x|Traceback|msgspec|Expected `|\$\.|cv2|OpenCV\(|\.part\b|error_percent|\bNone\b|starting")
WAY_OUT = re.compile(r"; [a-z`-]|: choose from |\?$")


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wrong") / "here"
    folder.mkdir()
    write_wrong_inputs(folder)
    return folder


@pytest.fixture(autouse=True)
def signals_as_before() -> Iterator[None]:
    """Services take SIGINT and SIGTERM."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def present(folder: Path) -> dict[str, int]:
    return {str(path.relative_to(folder)): path.stat().st_mtime_ns for path in folder.rglob("*")}


def check_line(wrong: Wrong, stderr: str) -> None:
    (line,) = stderr.splitlines()
    assert line.startswith("vemlight: ")
    for word in wrong.words:
        assert word in line, line
    assert not INTERNAL.search(line), line
    assert WAY_OUT.search(line), line


@pytest.mark.parametrize("wrong", WRONG, ids=lambda wrong: wrong.command)
def test_a_wrong_input_is_one_line_and_leaves_nothing(wrong, given, monkeypatch):
    monkeypatch.chdir(given)
    monkeypatch.setattr("vemlight.runtime.supervise.supervise", lambda *_: pytest.fail("services were started"))
    before = present(given.parent)
    done = CliRunner().invoke(main, wrong.command.split(), prog_name="vemlight")
    assert done.exit_code == 2, done.output
    assert done.stdout == ""
    check_line(wrong, done.stderr)
    assert present(given.parent) == before


@pytest.mark.parametrize("words", [
    ["lights", "", "--out", "o.json"], ["lights", "good.exr", "--out", ""], ["verify", ""], ["record", "--source", "", "--out", "o"],
])  # fmt: skip
def test_an_empty_name_is_no_folder(words, given, monkeypatch):
    monkeypatch.chdir(given)
    before = present(given.parent)
    done = CliRunner().invoke(main, words, prog_name="vemlight")
    assert done.exit_code == 2, done.output
    check_line(Wrong("", ("empty name",)), done.stderr)
    assert present(given.parent) == before


@pytest.mark.parametrize("command", ["run --source {}", "archive {} --out out"])
def test_a_folder_whose_name_is_not_utf_8_is_refused_where_it_would_be_kept(command, given, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("vemlight.runtime.supervise.supervise", lambda *_: pytest.fail("services were started"))
    name = os.fsdecode(b"\xff")
    shutil.copytree(given / "sequence", tmp_path / name)
    done = CliRunner().invoke(main, [word.format(name) for word in command.split()], prog_name="vemlight")
    assert done.exit_code == 2, done.output
    check_line(Wrong("", ("\\udcff: is not UTF-8", "rename it")), done.stderr)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_page_whose_port_is_taken_is_told_before_a_run_starts(tmp_path, monkeypatch):
    monkeypatch.setattr("vemlight.runtime.supervise.supervise", lambda *_: pytest.fail("services were started"))
    monkeypatch.setattr("vemlight.commands.run_checks.DYING_S", 0.1)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        (tmp_path / "taken.toml").write_text(f"[viewer]\nport = {port}\n")
        done = CliRunner().invoke(main, ["run", str(tmp_path / "taken.toml"), "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    check_line(Wrong("", ("taken.toml: [viewer] host, port: ", f"127.0.0.1:{port}")), done.stderr)
    assert not (tmp_path / "out").exists()


def test_what_can_run_is_run(given, monkeypatch):
    """Each check has a counterpart that passes: source, lens and response, scene, and the bundled ones; notices are the services' own."""
    monkeypatch.chdir(given)
    started = []
    monkeypatch.setattr("vemlight.runtime.supervise.supervise", lambda wanted, _: started.append(wanted) or 0)
    (given.parent / "gap").mkdir()
    for number in (5, 7, 8):
        shutil.copy(given / "good.exr", given.parent / "gap" / f"f_{number:04d}.exr")
    (given.parent / "good.scene.toml").write_text(f'{CAMERA}[[mesh]]\nshape = "box"\n')
    (given.parent / "good.toml").write_text(
        '[capture]\nsource = "here/codes.png"\nlens = "here/camera.toml"\nresponse = "here/sensor.toml"\n'
        f'[renderer]\nscene = "good.scene.toml"\n[viewer]\nport = {free_port()}\n'
    )
    (given.parent / "plain.toml").write_text(f"[viewer]\nport = {free_port()}\n")
    for words in ("../good.toml", "../plain.toml", "../plain.toml --source sequence", "../plain.toml --source ../gap"):
        done = CliRunner().invoke(main, ["run", *words.split()])
        assert (done.exit_code, done.stderr) == (0, "")
    assert [Path(wanted.capture.source).name for wanted in started] == ["codes.png", "", "sequence", "gap"]


@pytest.mark.parametrize("command", ["run source.toml", "lights png.hdr --out out.json", "lights good.exr --coutn 3 --out out.json"])
def test_so_it_is_in_a_process(command, given):
    wrong = next(wrong for wrong in WRONG if wrong.command == command)
    done = vemlight(*command.split(), cwd=given, environment={"PYTHONPATH": str(ROOT)})
    assert (done.returncode, done.stdout) == (2, "")
    check_line(wrong, done.stderr)


def test_there_are_more_than_a_hundred_and_each_file_is_used():
    assert len({wrong.command for wrong in WRONG}) == len(WRONG) > 100
    words = {word for wrong in WRONG for word in wrong.command.split()}
    assert {f"{name}.toml" for name in SETTINGS} | {f"{name}.scene.toml" for name in SCENES} <= words


def parameters(command: click.Command) -> Iterator[click.Parameter]:
    yield from command.params
    for inside in command.commands.values() if isinstance(command, click.Group) else ():
        yield from parameters(inside)


def test_no_number_of_any_command_may_be_nan_or_inf():
    numbers = [one for one in parameters(main) if isinstance(one.type, click.types.FloatParamType | click.FloatRange)]
    assert len(numbers) > 15
    for parameter in numbers:
        assert isinstance(parameter.type, Number), parameter.name
        for value in ("nan", "inf", "-inf"):
            with pytest.raises(click.BadParameter):
                parameter.type.convert(value, parameter, None)
