"""Imports point one way: a room may import itself and the files beside it, never another room."""

import ast
from pathlib import Path

import pytest

SERVICES = Path(__file__).parents[1] / "services"
ROOMS = sorted(path.name for path in SERVICES.iterdir() if (path / "__init__.py").exists())
# Where rooms meet: one process on files, the command line, and the check of the machine.
MEETING_PLACES = {"accuracy.py", "cli.py", "offline.py", "doctor.py"}


def imports(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: imports are written as whole paths"
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def rooms_in(names: set[str]) -> set[str]:
    return {name.split(".")[1] for name in names if name.startswith("services.")} & set(ROOMS)


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_no_other(room):
    for path in (SERVICES / room).rglob("*.py"):
        assert rooms_in(imports(path)) <= {room}, path


def test_what_lies_beside_the_rooms_imports_none():
    for path in SERVICES.glob("*.py"):
        if path.name not in MEETING_PLACES:
            assert not rooms_in(imports(path)), path


def test_packages_re_export_nothing():
    for path in SERVICES.rglob("__init__.py"):
        assert not path.read_text().strip(), path
