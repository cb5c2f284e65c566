"""What `vemlight run` shows by itself."""

import pytest
from click.testing import CliRunner

from vemlight.commands.cli import main
from vemlight.commands.service_commands import BUNDLED_RENDERER
from vemlight.settings import Settings


@pytest.fixture
def started(monkeypatch):
    """The settings with which a run would be supervised."""
    seen: list[Settings] = []
    monkeypatch.setattr("vemlight.runtime.supervise.supervise", lambda settings, _overwrite: seen.append(settings) or 0)
    return seen


def test_the_bundled_scene_is_shown_before_its_sky(started):
    assert CliRunner().invoke(main, ["run"]).exit_code == 0
    renderer = started[0].renderer
    assert (renderer.width, renderer.height, renderer.background) == tuple(BUNDLED_RENDERER.values())


def test_settings_and_sources_of_ones_own_are_taken_as_they_are(started, tmp_path):
    (tmp_path / "vemlight.toml").write_text("[renderer]\nwidth = 320\n")
    assert CliRunner().invoke(main, ["run", str(tmp_path / "vemlight.toml")]).exit_code == 0
    assert CliRunner().invoke(main, ["run", "--source", "replay_data/interior"]).exit_code == 0
    defaults = Settings().renderer
    assert (started[0].renderer.width, started[0].renderer.background) == (320, defaults.background)
    assert (started[1].renderer.width, started[1].renderer.background) == (defaults.width, defaults.background)
