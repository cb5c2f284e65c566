"""Ctrl-C: raised where that does no harm, remembered where it is not, and said in one line with status 130."""

import signal
from collections.abc import Callable

import click
import pytest

from vemlight.commands import cli, rendering
from vemlight.commands.options import RenderOptions
from vemlight.errors import Interrupted
from vemlight.runtime import interrupt
from vemlight.runtime.interrupt import INTERRUPTED, interruption


class Ended(BaseException):
    """In place of the end of this process."""


@pytest.fixture(autouse=True)
def no_exit(monkeypatch):
    def ended(status: int) -> None:
        raise Ended(status)

    monkeypatch.setattr(cli.os, "_exit", ended)
    monkeypatch.setattr(interrupt.os, "_exit", ended)
    yield
    interruption.came = False  # or the next command in this process would count as interrupted


def press() -> None:
    signal.raise_signal(signal.SIGINT)


def test_it_is_raised_and_remembered_and_the_handler_is_as_before():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), interruption.heeded():
        press()
    assert interruption.came
    assert signal.getsignal(signal.SIGINT) is before
    with interruption.heeded():
        assert not interruption.came


def test_where_it_is_deferred_it_waits_for_a_check():
    with interruption.heeded(), interruption.deferred():
        interruption.check()
        press()
        with pytest.raises(KeyboardInterrupt):
            interruption.check()


def test_what_a_library_has_swallowed_is_raised_before_drawing_begins():
    with interruption.heeded():
        with pytest.raises(KeyboardInterrupt):
            press()
        with pytest.raises(KeyboardInterrupt), interruption.deferred():
            raise AssertionError("drew")


def test_pressed_twice_it_ends_the_process_at_once():
    with interruption.heeded(), interruption.deferred():
        press()
        with pytest.raises(Ended) as ended:
            press()
    assert ended.value.args == (INTERRUPTED,)


def swallowed() -> None:
    try:
        press()
    except KeyboardInterrupt:
        raise ImportError("half imported") from None


def interrupted() -> None:
    raise Interrupted("a.exr is partial")


@pytest.mark.parametrize(
    ("work", "said"),
    [(press, "what was written so far, if any"), (swallowed, "what was written so far"), (interrupted, "a.exr is partial")],
)
def test_a_command_ends_with_130_and_a_line_about_the_result(work: Callable[[], None], said, capsys):
    group = cli.CommandGroup(commands={"work": click.Command("work", callback=work)})
    with pytest.raises(Ended) as ended:
        group.main(["work"], standalone_mode=False)
    assert ended.value.args == (130,)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"vemlight: interrupted: {said}")


def test_other_errors_of_a_command_stay_what_they_are():
    def broken() -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        cli.CommandGroup(commands={"work": click.Command("work", callback=broken)}).main(["work"], standalone_mode=False)


def test_a_rendering_ends_between_two_pictures(tmp_path, sequence, monkeypatch):
    write = rendering._write

    def press_while_writing(*arguments) -> None:
        press()
        write(*arguments)

    monkeypatch.setattr(rendering, "_write", press_while_writing)
    options = RenderOptions(source=sequence, size=(16, 12), count=4, shadow_map=16, out=tmp_path / "p.png")
    with interruption.heeded(), pytest.raises(Interrupted, match="is partial, 1 of 16 pictures"):
        rendering.write_pictures(options)
    assert [path.name for path in tmp_path.iterdir()] == ["p_0000.png"]
