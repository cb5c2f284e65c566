"""Where the GL context comes from, and the message on a machine that provides none."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import moderngl
import pytest

from vemlight.errors import UserError
from vemlight.renderer.gl import programs
from vemlight.renderer.gl.programs import GL_VARIABLES, open_context

OPEN = """
from vemlight.renderer.gl.programs import context_info, open_context
opened = open_context()
print(opened.through, "|", context_info(opened.context))
"""


@pytest.fixture
def machine(monkeypatch):
    """Makes up a machine: what each EGL device and the X server answer, None for a context."""

    def make(devices: list[str | None], display: str | None = None, x_server: str | None = None) -> list[dict]:
        asked: list[dict] = []

        def create_context(**settings):
            asked.append(settings)
            if "backend" in settings:
                number = settings["device_index"]
                reason = devices[number] if number < len(devices) else f"requested device index {number}, but found {len(devices)} devices"
            else:
                reason = x_server
            if reason:
                raise Exception(reason)
            return "a context"

        for name in GL_VARIABLES:
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr(moderngl, "create_context", create_context)
        monkeypatch.setattr(programs, "closed_cards", list)
        monkeypatch.setenv("DISPLAY", display) if display else monkeypatch.delenv("DISPLAY", raising=False)
        return asked

    return make


def one_line(*words: str) -> None:
    with pytest.raises(UserError) as caught:
        open_context()
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


def test_the_first_device_that_can_is_taken(machine):
    asked = machine(["eglInitialize failed (0x3001)", None, None], display=":0")
    opened = open_context()
    assert (opened.context, opened.through) == ("a context", "EGL")
    assert opened.refused == ["EGL device 0: eglInitialize failed (0x3001)"]
    assert [settings["device_index"] for settings in asked] == [0, 1]


def test_egl_comes_before_the_display(machine):
    machine([None], display=":0")
    assert open_context().through == "EGL"


@pytest.mark.parametrize("devices", [[], ["eglCreateContext failed (0x3009)"], ["libEGL.so.1 not loaded"] * 20])
def test_a_display_serves_where_egl_does_not(devices, machine):
    asked = machine(devices, display=":0")
    assert open_context().through == "the X server :0"
    assert len(asked) <= len(devices[:2]) + 2


def test_a_cause_is_named_once(machine):
    machine(["libEGL.so.1\nnot loaded"] * 20)
    one_line("no OpenGL 4.3 (EGL: libEGL.so.1 not loaded); ", "apt-get install libegl1 libgl1 libgl1-mesa-dri")
    machine(["eglInitialize failed"], display=":7", x_server="cannot open display")
    one_line("(EGL device 0: eglInitialize failed; X server :7: cannot open display)", "apt-get install")
    machine([])
    one_line("found 0 devices", "apt-get install")


def test_an_old_driver_is_to_be_updated(machine):
    machine(["Requested OpenGL version 430, got version 330"])
    one_line("update the driver", "LIBGL_ALWAYS_SOFTWARE=1")


def test_a_variable_that_leads_astray_is_named(machine, monkeypatch):
    machine([])
    monkeypatch.setenv("LIBGL_DRIVERS_PATH", "/nowhere")
    one_line("unset LIBGL_DRIVERS_PATH")


def test_a_device_that_was_chosen_is_asked_for_once(machine, monkeypatch):
    asked = machine(["eglInitialize failed"] * 3)
    monkeypatch.setenv("GLCONTEXT_DEVICE_INDEX", "1")
    one_line("unset GLCONTEXT_DEVICE_INDEX")
    assert len(asked) == 1


def test_a_card_that_may_not_be_opened_is_named(machine, monkeypatch, tmp_path):
    machine(["eglInitialize failed"])
    card = tmp_path / "renderD128"
    card.touch()
    monkeypatch.setattr(programs, "closed_cards", lambda: [card])
    one_line(str(card), "usermod -aG", f"group_add {card.stat().st_gid}")


def opened_by_process(**environment: str) -> subprocess.CompletedProcess[str]:
    whole = {name: value for name, value in os.environ.items() if name != "DISPLAY"} | environment
    return subprocess.run([sys.executable, "-c", OPEN], capture_output=True, text=True, timeout=60, env=whole)


@pytest.mark.parametrize(
    "environment",
    [{}, {"DISPLAY": ":7654"}, {"WAYLAND_DISPLAY": "wayland-7", "XDG_SESSION_TYPE": "wayland"}, {"EGL_PLATFORM": "x11"}],
    ids=["headless", "no such X server", "wayland", "EGL set to use X"],
)
def test_surroundings_that_change_nothing(environment):
    done = opened_by_process(**environment)
    assert done.stdout.startswith("EGL | "), done.stderr


@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="no Xvfb on this machine: no display is tried")
def test_a_display_with_and_without_egl(tmp_path: Path):
    reads, writes = os.pipe()
    server = subprocess.Popen(["Xvfb", "-displayfd", str(writes), "-screen", "0", "64x48x24"], pass_fds=[writes], stderr=subprocess.DEVNULL)
    os.close(writes)
    try:
        with open(reads) as numbers:
            display = f":{numbers.readline().strip()}"
        assert opened_by_process(DISPLAY=display).stdout.startswith("EGL | ")
        without_egl = opened_by_process(DISPLAY=display, __EGL_VENDOR_LIBRARY_FILENAMES=str(tmp_path / "none.json"))
        assert without_egl.stdout.startswith(f"the X server {display} | "), without_egl.stderr
    finally:
        server.terminate()
        server.wait()
