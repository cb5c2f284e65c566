"""The wheel: the package `vemlight`, whole, with the bundled sequence, the client in one file and nothing else.

The same bytes each time; it runs from anywhere.
"""

import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

from tests.support.processes import LOADED_S, free_port

ROOT = Path(__file__).parents[1]
OLDEST_SETUPTOOLS = 77  # the first that reads `license = "Apache-2.0"`
# A recipe, an example, and the scene of tests.
NOT_INSTALLED = {"renderer/luminaire/lamps/torch.toml"}
NOT_INSTALLED |= {f"renderer/scene/scenes/{name}" for name in ("headlights.toml", "shapes.toml", "knot.obj", "pole.obj")}
SMALL = "[capture]\nrows = 9\ncols = 36\n[sampler]\ncount = 8\n[renderer]\nwidth = 64\nheight = 48\nshadow_map = 16\n"


def built(folder: Path, mask: int = 0o022) -> Path:
    """The wheel that `make wheel` makes of a copy of the source in `folder`, whose files and folders have the modes that `mask` leaves."""
    folder.mkdir(parents=True)
    for name in ("services", "replay_data"):
        shutil.copytree(ROOT / name, folder / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE", "Makefile", "vemlight", "vemlight_client.py"):
        shutil.copy(ROOT / name, folder / name, follow_symlinks=False)
    for path in folder.rglob("*"):
        if not path.is_symlink():
            path.chmod((0o777 if path.is_dir() else 0o666) & ~mask)
    command = ["make", "-s", "-o", "env", "wheel", f"BIN={Path(sys.executable).parent}"]  # -o env: this Python is the environment
    environment = {**os.environ, "SOURCE_DATE_EPOCH": "1700000000", "PIP_NO_INDEX": "1", "MAKEFLAGS": ""}
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment, umask=mask, timeout=LOADED_S)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = (folder / "dist").iterdir()
    return wheel


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    try:
        setuptools = metadata.version("setuptools")
    except metadata.PackageNotFoundError:
        setuptools = "0"
    if int(setuptools.split(".")[0]) < OLDEST_SETUPTOOLS:
        pytest.skip(f"setuptools {OLDEST_SETUPTOOLS} is not installed: the wheel cannot be built offline")
    return built(tmp_path_factory.mktemp("first") / "source")


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment that holds the wheel alone, and finds the packages it needs in this one."""
    folder = tmp_path_factory.mktemp("fresh") / "environment"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True, timeout=LOADED_S)
    python = folder / "bin" / "python"
    (packages,) = folder.glob("lib/python*/site-packages")
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", "--no-index", str(wheel)]
    subprocess.run(install, check=True, timeout=LOADED_S)
    assert {path.name.partition("-")[0] for path in packages.iterdir()} - {"__pycache__"} == {"vemlight", "vemlight_client.py"}
    (packages / "needed.pth").write_text(sysconfig.get_path("purelib") + "\n")  # of which no .pth is read, so no editable vemlight
    return folder


def test_the_wheel_holds_the_package_and_the_bundled_sequence_and_nothing_else(wheel):
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    code = {str(path.relative_to(ROOT / "services")) for path in (ROOT / "services").rglob("*") if path.is_file()}
    code = {name for name in code if "__pycache__" not in name} - NOT_INSTALLED
    bundled = {"lens.toml", "manifest.jsonl", *(f"sky_{k:04d}.exr" for k in range(48))}
    assert held == {f"vemlight/{name}" for name in code} | {f"vemlight/capture/bundled/{name}" for name in bundled} | {"vemlight_client.py"}
    assert {Path(name).suffix for name in held} >= {".vert", ".frag", ".glsl", ".comp", ".npy", ".html", ".js", ".css", ".toml", ".glb"}


def test_two_builds_are_the_same_bytes(wheel, tmp_path):
    """Another folder, other times of the files, another umask."""
    again = built(tmp_path / "another" / "place", mask=0o077)
    assert again.name == wheel.name
    assert hashlib.sha256(again.read_bytes()).hexdigest() == hashlib.sha256(wheel.read_bytes()).hexdigest()


def test_the_installed_program_shows_the_bundled_sequence_from_any_folder(installed, tmp_path):
    (tmp_path / "small.toml").write_text(f"{SMALL}[viewer]\nport = {free_port()}\n")
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "NUMBA_DISABLE_JIT": "1"}  # compiling takes longer than such a small map
    command = [installed / "bin" / "vemlight", "run", "small.toml", "--frames", "1", "--out", "out"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=LOADED_S)
    assert done.returncode == 0, done.stderr
    assert {"frame_0000.exr", "frame_0000.png", "lights.jsonl"} <= {path.name for path in (tmp_path / "out").iterdir()}


def test_the_package_is_a_program(installed, tmp_path):
    command = [installed / "bin" / "python", "-m", "vemlight"]
    environment = {"PATH": "/usr/bin:/bin"}
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=LOADED_S)
    assert done.stdout == f"vemlight, version {metadata.version('vemlight')}\n", done.stderr
