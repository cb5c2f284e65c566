"""Imports point one way: down the floors, never from one service to another, and never from one test to another."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SERVICES = ROOT / "services"
# From below: a file imports only its own package and what stands on a lower floor.
FLOORS = (
    {"choices", "errors", "file_kinds", "source_names", "toml", "files", "kernels", "compiling"},
    {"journal"},
    {"light"},
    {"setting_keys", "settings", "settings_file", "runtime"},
    {"capture", "fuse", "sampler", "renderer", "plate", "fixtures", "viewer", "exchange"},
    {"commands"},  # where services meet: one process on files, the command line, the check of the machine
    {"__main__"},
)
# The same within the renderer; `renderer.py`, `stage.py` and what else lies loose there stands on top.
RENDERER_FLOORS = ({"gl"}, {"luminaire", "output", "pass_table"}, {"scene", "frame_budget"}, {"rays"}, {"passes"})
TEST_SUPPORT = {"tests.support", "tests.golden", "tests.references", "tests.mutants"}  # what tests may import of tests/
# The settings name the services, and the runtime reads the settings.
TOGETHER = ({"setting_keys", "settings", "settings_file", "runtime"}, {"errors", "file_kinds", "toml", "files"}, {"kernels", "compiling"})


def imported_modules(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path}: imports are written as whole paths"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def floor_of(package: str, floors: tuple[set[str], ...]) -> int:
    return next((number for number, floor in enumerate(floors) if package in floor), len(floors))


def may_import(importer: str, imported: str, floors: tuple[set[str], ...]) -> bool:
    if importer == imported or any({importer, imported} <= set(pair) for pair in TOGETHER):
        return True
    return floor_of(imported, floors) < floor_of(importer, floors)


@pytest.mark.parametrize("path", sorted(SERVICES.rglob("*.py")), ids=lambda path: str(path.relative_to(SERVICES)))
def test_imports_go_down(path):
    inside = path.relative_to(SERVICES).with_suffix("").parts
    for module in imported_modules(path):
        _, *target = module.split(".")
        if not module.startswith("vemlight."):
            continue
        assert may_import(inside[0], target[0], FLOORS), f"{path} imports {module}"
        if inside[0] == target[0] == "renderer":
            on_top = floor_of(inside[1], RENDERER_FLOORS) == len(RENDERER_FLOORS)
            assert on_top or may_import(inside[1], target[1], RENDERER_FLOORS), f"{path} imports {module}"


def test_each_package_has_its_floor():
    here = {path.stem for path in SERVICES.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert here - {"__init__"} == set().union(*FLOORS)


def test_packages_re_export_nothing():
    for path in SERVICES.rglob("__init__.py"):
        assert not path.read_text().strip(), path


@pytest.mark.parametrize("path", sorted((ROOT / "tests").rglob("*.py")), ids=lambda path: path.stem)
def test_tests_import_support_modules_and_the_bench_only_to_test_it(path):
    for module in imported_modules(path):
        folder, *inside = module.split(".")
        own = inside[:1] == [path.parent.name]  # a package's own modules, such as the tables of tests/mutants
        if folder == "tests" and not own:
            assert f"tests.{inside[0]}" in TEST_SUPPORT, f"{path} imports {module}: move what it needs to tests/support"
        if folder == "bench":
            assert path.name.startswith("test_bench_"), f"{path} imports {module}: only tests/test_bench_*.py may"


@pytest.mark.parametrize("path", sorted((ROOT / "bench").rglob("*.py")), ids=lambda path: str(path.relative_to(ROOT)))
def test_benches_import_no_tests(path):
    assert not {name for name in imported_modules(path) if name.startswith("tests.") and not name.startswith("tests.support")}


def test_a_frame_is_planned_without_gl():
    code = "import sys; import vemlight.renderer.frame_plan; sys.exit('moderngl' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
