"""What is locked is not older than the first release without a known hole, and everything locked has its hashes."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLOORS = tomllib.loads((ROOT / "security" / "floors.toml").read_text())
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
    assert len(locked) > 20
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
    used = {name_of(package) for lock in LOCKS for package, _ in LOCKED.findall(lock.read_text())} | {"setuptools"}
    for package, row in FLOORS.items():
        assert name_of(package) == package
        assert package in used, f"{package} is locked nowhere: remove its floor"
        assert row.keys() == {"floor", "reason"}
        assert row["reason"]


def test_the_build_asks_for_no_older_setuptools_than_its_floor():
    (requirement,) = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    assert release(requirement.partition(">=")[2]) >= release(FLOORS["setuptools"]["floor"])
