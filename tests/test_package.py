"""The wheel: the package `vemlight`, whole, and nothing else."""

import shutil
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OLDEST_SETUPTOOLS = 77  # as in pyproject.toml: the first that reads `license = "Apache-2.0"`


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """Built from a copy, because a build leaves folders behind from which the next one would take old files."""
    try:
        setuptools = metadata.version("setuptools")
    except metadata.PackageNotFoundError:
        setuptools = "0"
    if int(setuptools.split(".")[0]) < OLDEST_SETUPTOOLS:
        pytest.skip(f"setuptools {OLDEST_SETUPTOOLS} is not installed: the wheel cannot be built offline")
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    shutil.copytree(ROOT / "services", source / "services", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE", "vemlight"):
        shutil.copy(ROOT / name, source / name, follow_symlinks=False)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index", "-w", str(out), str(source)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return zipfile.ZipFile(next(out.glob("vemlight-*.whl")))


def test_only_the_package_is_installed_and_all_of_it(wheel):
    installed = {name for name in wheel.namelist() if ".dist-info/" not in name}
    here = {path.relative_to(ROOT / "services") for path in (ROOT / "services").rglob("*") if path.is_file()}
    assert installed == {f"vemlight/{path}" for path in here if "__pycache__" not in path.parts}
    kinds = {Path(name).suffix for name in installed}
    assert kinds >= {".vert", ".frag", ".glsl", ".comp", ".npy", ".html", ".js", ".css", ".toml", ".obj", ".exr"}


def test_the_installed_package_runs_from_anywhere(wheel, tmp_path):
    wheel.extractall(tmp_path / "installed")
    environment = {"PYTHONPATH": str(tmp_path / "installed"), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        [sys.executable, "-m", "vemlight", "--help"], capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert "Usage: vemlight" in done.stdout
    code = "import vemlight; from vemlight.renderer.scene.scene import load_scene; load_scene(None); print(*vemlight.__path__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, env=environment, timeout=60)
    assert done.stdout.strip() == str(tmp_path / "installed" / "vemlight"), done.stderr
