"""Which functions are kernels, which Python may call, and subroutines, which it must not: the call would end the process."""

import ast
import gc
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from vemlight.kernels import COMPILING_GC, event, kernel

ROOT = Path(__file__).parents[1]
COMPILED = ("kernel", "subroutine", "callback", "njit")


def decorator_of(function: ast.AST) -> str | None:
    """One of COMPILED, or None."""
    for decorator in function.decorator_list if isinstance(function, ast.FunctionDef) else ():
        name = decorator.func if isinstance(decorator, ast.Call) else decorator
        if isinstance(name, ast.Name) and name.id in COMPILED:
            return name.id
    return None


def subroutines() -> dict[str, set[str]]:
    """The names of each module's subroutines."""
    found = {}
    for path in (ROOT / "services").rglob("*.py"):
        names = {node.name for node in ast.parse(path.read_text()).body if decorator_of(node) == "subroutine"}  # type: ignore[attr-defined]
        if names:
            found["vemlight." + ".".join(path.relative_to(ROOT / "services").with_suffix("").parts)] = names
    return found


def nodes_outside_kernels(node: ast.AST) -> Iterator[ast.AST]:
    """What a file has in Python, not in its compiled functions."""
    if not decorator_of(node):
        yield node
        for child in ast.iter_child_nodes(node):
            yield from nodes_outside_kernels(child)


SUBROUTINES = subroutines()


@pytest.mark.parametrize("folder", ["services", "tests", "bench"])
def test_python_calls_no_subroutine(folder):
    for path in (ROOT / folder).rglob("*.py"):
        tree = ast.parse(path.read_text())
        own = "vemlight." + ".".join(path.relative_to(ROOT / folder).with_suffix("").parts) if folder == "services" else ""
        names, of_modules = set(SUBROUTINES.get(own, ())), set()
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                for alias in node.names:
                    names |= {alias.name} & SUBROUTINES.get(str(node.module), set())
                    of_modules |= SUBROUTINES.get(f"{node.module}.{alias.name}", set())
        outside = list(nodes_outside_kernels(tree))
        called = names & {node.id for node in outside if isinstance(node, ast.Name)}
        called |= of_modules & {node.attr for node in outside if isinstance(node, ast.Attribute)}
        assert not called, f"{path}: {called} are subroutines; make them kernels"


def test_there_are_subroutines_to_look_for():
    assert "_two_means" in SUBROUTINES["vemlight.sampler.tracking.split_merge"]


@kernel
def quotient(a, b):
    return a / b


def test_a_kernel_divides_as_numpy_does():
    assert quotient(1.0, 0.0) == np.inf
    assert np.isnan(quotient(0.0, 0.0))


def test_garbage_is_seldom_collected_while_numba_compiles_and_as_before_after_it():
    before = gc.get_threshold()
    with event.trigger_event("numba:compile"), event.trigger_event("numba:compile"):  # a kernel, and one that it calls
        assert gc.get_threshold() == (COMPILING_GC, *before[1:])
    assert gc.get_threshold() == before
    assert COMPILING_GC >= 20_000


INTERRUPTED_LOAD = """
import signal, sys
sys.path.insert(0, sys.argv[1])
from vemlight.kernels import numba
from numba.core.codegen import JITCodeLibrary
given, pressed = JITCodeLibrary._object_getbuffer_hook, [signal.SIGINT]
def asked(library):
    if pressed:
        signal.raise_signal(pressed.pop())  # while LLVM waits for the machine code
    return given(library)
JITCodeLibrary._object_getbuffer_hook = asked
import doubling
try:
    doubling.twice(2.0)
except KeyboardInterrupt:
    print("interrupted", doubling.twice(4.0))
"""


def test_ctrl_c_while_a_kernel_is_loaded_comes_when_it_is_whole(tmp_path):
    (tmp_path / "doubling.py").write_text("from vemlight.kernels import kernel\n@kernel\ndef twice(x):\n    return 2 * x\n")
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    compiling = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import doubling; doubling.twice(1.0)"
    subprocess.run([sys.executable, "-c", compiling], check=True, env=environment)
    command = [sys.executable, "-c", INTERRUPTED_LOAD, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted 8.0\n", "")
