"""What is said of the compiler to those who wait: on the page, in the supervisor's line, at a terminal."""

import subprocess
import sys
from pathlib import Path

import pytest

from vemlight.compiling import COMPILING, MAX_NAME, compiled_by, compiling_file, say_compiling
from vemlight.viewer.liveness import Liveness

KERNEL = "sampler.tracking.extents._sums"
COMPILE = """
import os
from pathlib import Path
from vemlight.compiling import COMPILING
import vemlight.sampler.temporal.flicker as flicker
from numba.core import event

seen, file = [], Path(os.environ[COMPILING])

class Reader(event.Listener):
    def on_start(self, event):
        seen.append(file.read_text())
    def on_end(self, event):
        pass

event.register("numba:compile", Reader())
flicker._beat(100.0, 25.0)
assert set(seen) == {"sampler.temporal.flicker._beat"}, seen
assert not file.exists()
"""


@pytest.fixture
def run(tmp_path: Path, monkeypatch) -> Path:
    """A run's folder, this process being its sampler."""
    monkeypatch.setenv(COMPILING, str(compiling_file(tmp_path, "sampler")))
    return tmp_path


def test_a_service_says_which_kernel_it_compiles_until_it_is_done(run):
    assert compiled_by("sampler") == ""
    say_compiling(KERNEL)
    assert compiled_by("sampler") == compiled_by("sampler", run) == KERNEL
    assert compiled_by("renderer") == ""
    say_compiling("")
    assert compiled_by("sampler") == ""
    assert list(run.iterdir()) == []


def test_outside_a_run_nothing_is_said(tmp_path, monkeypatch):
    monkeypatch.delenv(COMPILING, raising=False)
    monkeypatch.chdir(tmp_path)
    say_compiling(KERNEL)
    assert compiled_by("sampler") == ""
    assert list(tmp_path.iterdir()) == []


def test_the_page_names_the_kernel_of_a_service_that_is_not_seen_yet(run):
    liveness = Liveness({"capture": (), "sampler": ("capture",)}, fps=25)
    assert liveness.judge(0.0)["sampler"].text == "nothing received yet"
    say_compiling(KERNEL)
    judged = liveness.judge(0.0)
    assert judged["sampler"] == ("not seen", f"compiling {KERNEL}, at the first start")
    assert judged["capture"].text == "nothing received yet"


def test_what_others_write_there_is_a_short_line(run):
    compiling_file(run, "sampler").write_bytes(b"\xff" * 10**6)
    assert len(compiled_by("sampler")) == MAX_NAME


def test_numba_s_compiler_is_heard(run, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    ended = subprocess.run([sys.executable, "-c", COMPILE], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
