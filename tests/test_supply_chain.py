"""What is locked is not older than the first release without a known hole, and everything locked has its hashes."""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLOORS = tomllib.loads((ROOT / "security" / "floors.toml").read_text())
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LOCKS = sorted(ROOT.glob("requirements*.lock"))
LOCKED = re.compile(r"^([A-Za-z0-9._-]+)==([^\s;]+)(?: ;.*)? \\$", re.MULTILINE)


def release(version: str) -> tuple[int, ...]:
    """Its numbers: 3.4.14rc1 counts as 3.4.14."""
    return tuple(int(number) for number in re.findall(r"\d+", re.split(r"[a-z+]", version)[0]))


def name_of(package: str) -> str:
    """As the package index compares names."""
    return re.sub(r"[-_.]+", "-", package).lower()


def test_releases_are_compared_as_numbers():
    assert release("3.4.9") < release("3.4.14") < release("3.5") < release("10.0rc1")


@pytest.mark.parametrize("lock", LOCKS, ids=lambda path: path.name)
def test_nothing_is_locked_below_its_floor(lock):
    locked = LOCKED.findall(lock.read_text())
    assert len(locked) > (0 if lock.name == "requirements-build.lock" else 20)
    for package, version in locked:
        floor = FLOORS.get(name_of(package), {"floor": "0"})["floor"]
        reason = FLOORS.get(name_of(package), {}).get("reason", "")
        assert release(version) >= release(floor), f"{lock.name}: {package} {version} is below {floor}: {reason}"


@pytest.mark.parametrize("lock", LOCKS, ids=lambda path: path.name)
def test_everything_locked_has_its_hashes_and_no_address(lock):
    text = lock.read_text()
    blocks = re.split(r"^(?=[A-Za-z0-9._-]+==)", text, flags=re.MULTILINE)[1:]
    assert all("--hash=sha256:" in block for block in blocks)
    assert "://" not in text


def test_every_floor_is_of_a_package_in_use_and_has_its_reason():
    used = {name_of(package) for lock in LOCKS for package, _ in LOCKED.findall(lock.read_text())}
    for package, row in FLOORS.items():
        assert name_of(package) == package
        assert package in used, f"{package} is locked nowhere: remove its floor"
        assert row.keys() == {"floor", "reason"}
        assert row["reason"]


def test_the_build_asks_for_no_older_setuptools_than_its_floor():
    (requirement,) = PROJECT["build-system"]["requires"]
    assert release(requirement.partition(">=")[2]) >= release(FLOORS["setuptools"]["floor"])


def test_what_builds_is_locked_as_well():
    """The packages that a build needs are in the environment by their hashes; a build in isolation would fetch them without."""
    required = {re.split(r"[^\w.-]", line)[0] for line in PROJECT["build-system"]["requires"]}
    for lock in ("requirements-build.lock", "requirements-dev.lock"):
        assert required <= {package for package, _ in LOCKED.findall((ROOT / lock).read_text())}, lock
    for name in ("Makefile", "Dockerfile"):
        builds = [line for line in (ROOT / name).read_text().splitlines() if re.search(r"pip.* (install|wheel) .*--no-deps", line)]
        assert builds, name
        assert all("--no-build-isolation" in line for line in builds), name


def test_what_the_image_installs_reaches_its_build():
    dockerfile, sent = (ROOT / "Dockerfile").read_text(), (ROOT / ".dockerignore").read_text().splitlines()
    locks = set(re.findall(r"-r (\S+\.lock)", dockerfile))
    assert locks == {"requirements.lock", "requirements-build.lock"}
    assert {f"!{lock}" for lock in locks} <= set(sent)


def test_the_base_of_the_image_is_an_argument():
    """So that whoever builds can name a digest; a tag alone moves."""
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    assert [line for line in lines if line.startswith("FROM ")] == ["FROM ${BASE}"]
    assert any(line.startswith("ARG BASE=python:") for line in lines)


def test_the_bill_of_materials_lists_the_lock_with_its_hashes_and_nothing_below_a_floor(tmp_path):
    if not find_spec("cyclonedx_py"):
        pytest.skip("cyclonedx-bom is not installed: make env")
    for name in ("Makefile", "pyproject.toml", "requirements.lock"):
        shutil.copy(ROOT / name, tmp_path)
    command = ["make", "-s", "-o", "env", "sbom", f"BIN={Path(sys.executable).parent}"]  # -o env: this Python is the environment
    subprocess.run(command, check=True, cwd=tmp_path, env={**os.environ, "MAKEFLAGS": ""}, timeout=100)
    bill = json.loads((tmp_path / "dist" / "sbom.json").read_text())
    listed = [(row["name"], row["version"]) for row in bill["components"]]
    assert sorted(listed) == sorted(LOCKED.findall((ROOT / "requirements.lock").read_text()))
    for row in bill["components"]:
        assert all(hash_["alg"] == "SHA-256" for reference in row["externalReferences"] for hash_ in reference["hashes"])
        assert release(row["version"]) >= release(FLOORS.get(name_of(row["name"]), {"floor": "0"})["floor"])


def test_the_page_of_licences_names_each_library_in_the_wheel_of_the_video_encoder():
    """Above all those under the GPL. FFmpeg's own libraries stand there as FFmpeg."""
    folder = next((path / "av.libs" for path in map(Path, sys.path) if (path / "av.libs").is_dir()), None)
    if folder is None:
        pytest.skip("PyAV is not from a wheel")
    libraries = {name for path in folder.iterdir() for name in re.findall(r"^lib([A-Za-z]+\d*)", path.name)}
    of_another = {"sharpyuv": "webp", "webpmux": "webp", "hogweed": "nettle", "SvtAv1": "svt-av1", "dav1": "dav1d"}
    row = next(line for line in (ROOT / "docs" / "licences.md").read_text().splitlines() if "`av`" in line).lower()
    for library in libraries - {"avcodec", "avdevice", "avfilter", "avformat", "avutil", "swresample", "swscale"}:
        assert str(of_another.get(library, library)).lower() in row, library
    assert ("libx264 and libx265 (gpl" in row) == ("x264" in libraries)
