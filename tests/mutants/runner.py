"""Runs tests on mutated copies of the repository."""

import ast
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from tests.mutants.mutant import Mutant

ROOT = Path(__file__).parents[2]
TIMEOUT_S = 600  # a mutant that makes a test hang is noticed


class Verdict(NamedTuple):
    """outcome: "killed", "survived" or an error: the text was not found, or the tests fail without the mutant, too."""

    mutant: Mutant
    outcome: str
    spent_s: float


def run(mutants: list[Mutant], workers: int) -> Iterator[Verdict]:
    """The verdicts of mutants, in their order. Tests run in copies, so the repository may change meanwhile."""
    with TemporaryDirectory(prefix="mutants-") as folder:
        original = Path(folder) / "original"
        copy_repository(original)
        importers = importers_by_module(original)
        failing = {}
        for tests in dict.fromkeys(mutant.tests for mutant in mutants):
            failing[tests] = failed(original, tests)
        with ThreadPoolExecutor(workers) as pool:
            yield from pool.map(lambda mutant: judge(mutant, original, importers, failing[mutant.tests]), mutants)


def judge(mutant: Mutant, original: Path, importers: dict[str, set[str]], failing: str) -> Verdict:
    """What the tests say of one mutant. failing: what they say without it, if anything."""
    start = time.monotonic()
    try:
        source = mutant.applied((original / mutant.file).read_text())
    except (ValueError, OSError) as error:
        return Verdict(mutant, f"error: {error}", 0.0)
    if failing:
        return Verdict(mutant, f"error: the tests fail without it: {failing}", 0.0)
    with TemporaryDirectory(prefix="mutant-", dir=original.parent) as folder:
        copy = Path(folder) / "repository"
        shutil.copytree(original, copy, symlinks=True, copy_function=os.link)
        forget_compiled(copy, mutant.file, importers)
        (copy / mutant.file).unlink()  # a link to the original
        (copy / mutant.file).write_text(source)
        outcome = "killed" if failed(copy, mutant.tests) else "survived"
    return Verdict(mutant, outcome, time.monotonic() - start)


def failed(copy: Path, tests: Iterable[str]) -> str:
    """The first failure of tests in a copy, "" when all pass."""
    environment = os.environ | {"PYTHONPATH": str(copy), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired:
        return f"longer than {TIMEOUT_S} s"
    lines = done.stdout.splitlines() or done.stderr.splitlines() or [""]
    return "" if done.returncode == 0 else next((line for line in lines if line.startswith(("FAILED", "ERROR"))), lines[-1])


def copy_repository(target: Path) -> None:
    """Copies the files that git knows or would, and compiled code beside them with its times, so that it is not compiled again."""
    listed = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in listed.stdout.splitlines():
        source = ROOT / name
        if source.is_file() or source.is_symlink():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target / name, follow_symlinks=False)
    for cache in [*(ROOT / "services").rglob("__pycache__"), *(ROOT / "bench").rglob("__pycache__")]:
        shutil.copytree(cache, target / cache.relative_to(ROOT), dirs_exist_ok=True)


def importers_by_module(root: Path) -> dict[str, set[str]]:
    """Which files of services/ and bench/ import a file, directly or through others; both as paths from the root."""
    direct: dict[str, set[str]] = {}
    for path in [*(root / "services").rglob("*.py"), *(root / "bench").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                for module in (node.module, *(f"{node.module}.{alias.name}" for alias in node.names)):
                    imported = module.replace("vemlight.", "services.", 1).replace(".", "/") + ".py"
                    direct.setdefault(imported, set()).add(str(path.relative_to(root)))
    return direct


def forget_compiled(copy: Path, file: str, importers: dict[str, set[str]]) -> None:
    """Removes the machine code of a file and of all that imports it: numba looks only at the time of a function's own file."""
    stale, queue = set(), [file]
    while queue:
        changed = queue.pop()
        if changed not in stale:
            stale.add(changed)
            queue.extend(importers.get(changed, ()))
    for name in stale:
        path = copy / name
        for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.nb[ci]"):
            compiled.unlink()
