"""The warm spare: becomes what it is told, in name and environment, or ends with its supervisor."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
import tomli_w

import vemlight.sampler.__main__ as sampler
from tests.support.processes import LOADED_S
from vemlight.runtime.spare import Role, Spare, load
from vemlight.settings import Settings
from vemlight.settings_file import read_settings


def command_line(pid: int) -> list[str]:
    return Path(f"/proc/{pid}/cmdline").read_bytes().decode().rstrip("\0").split("\0")


@pytest.fixture
def settings_file(tmp_path) -> Path:
    file = tmp_path / "vemlight.toml"
    file.write_text(tomli_w.dumps({"wire": {"folder": str(tmp_path / "sockets")}}))
    return file


@pytest.fixture
def spare(settings_file):
    made = Spare(settings_file, {}, lambda: None)
    yield made
    made.close()


def test_a_spare_becomes_the_service_by_name_arguments_and_environment(spare, settings_file, tmp_path):
    missing = str(tmp_path / "missing.toml")
    assert command_line(spare.process.pid)[1:3] == ["-m", "vemlight.runtime.spare"]
    process = spare.become(Role("viewer", [missing], {"VEMLIGHT_RESTARTS": "3"}))
    assert process is spare.process
    assert process.wait(LOADED_S) == 2  # as `python -m vemlight.viewer missing.toml` ends


def test_its_command_line_is_the_services(tmp_path):
    code = """
import sys
from pathlib import Path
from vemlight.runtime.spare import set_command_line
set_command_line(["python", "-m", "vemlight.sampler", "é.toml"])
print(Path("/proc/self/cmdline").read_bytes())
set_command_line(["x" * 10_000])
print(len(Path("/proc/self/cmdline").read_bytes().rstrip(b"\\0")))
"""
    run = subprocess.run([sys.executable, "-c", code, "padding" * 20], capture_output=True, text=True, check=True)
    shown, length = run.stdout.splitlines()
    assert eval(shown).rstrip(b"\0") == "python\0-m\0vemlight.sampler\0é.toml".encode()
    assert 140 < int(length) < 2000


def test_a_spare_that_is_not_needed_ends_with_its_supervisor(spare):
    spare.process.stdin.close()
    assert spare.process.wait(LOADED_S) == 0


def test_a_dead_spare_becomes_nothing(spare):
    spare.process.kill()
    until = time.monotonic() + LOADED_S
    while spare.is_alive() and time.monotonic() < until:
        time.sleep(0.01)
    assert spare.become(Role("viewer", [], {})) is None


def test_a_spare_loads_the_services_of_the_settings_and_prepares_the_sampler(settings_file, monkeypatch):
    prepared: list[Settings] = []
    monkeypatch.setattr(sampler, "prepare", prepared.append)
    settings = read_settings(settings_file)
    load(settings)
    assert prepared == [settings]
    assert {f"vemlight.{service}.__main__" for service in settings.services} <= sys.modules.keys()
