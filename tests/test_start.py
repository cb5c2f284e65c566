"""How a service ends: the status, and one line on stderr for what is not our own fault."""

from pathlib import Path

import pytest

from vemlight.errors import FatalError, UserError
from vemlight.runtime.start import start
from vemlight.settings import Settings


@pytest.mark.parametrize(
    ("error", "status", "lines"),
    [
        (None, 0, []),
        (UserError("here: is wrong; fix it"), 2, ["vemlight: here: is wrong; fix it"]),
        (FatalError("the card was reset; start again"), 1, ["vemlight: the card was reset; start again"]),
    ],
)
def test_a_service_ends_with_a_status_for_its_cause(error, status, lines, capsys):
    def main(settings: Settings, restarts: int) -> None:
        if error:
            raise error

    assert start(main, []) == status
    assert capsys.readouterr().err.splitlines() == lines


def test_an_internal_error_shows_its_traceback(capsys):
    def main(settings: Settings, restarts: int) -> None:
        raise KeyError("ours")

    assert start(main, []) == 1
    assert "in main" in capsys.readouterr().err


def test_it_has_the_settings_and_knows_how_often_it_was_started(tmp_path: Path, monkeypatch):
    seen = []
    monkeypatch.setenv("VEMLIGHT_RESTARTS", "3")
    (tmp_path / "vemlight.toml").write_text("[sampler]\ncount = 5\n")
    assert start(lambda *given: seen.append(given), [str(tmp_path / "vemlight.toml")]) == 0
    ((settings, restarts),) = seen
    assert (settings.sampler.count, restarts) == (5, 3)
    assert start(lambda *given: seen.append(given), [str(tmp_path / "gone.toml")]) == 2
    assert len(seen) == 1
