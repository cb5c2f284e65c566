"""Loops that are too slow in Python, compiled by numba.

A service waits for the compiler at its first start, so a kernel is compiled for what it is called with and no more: assigning a slice or an
expression of arrays to another slice makes numba compile the text of an error message, 2 s, calls of LAPACK take 5 s, np.argsort 1 s,
np.flatnonzero and each expression of whole arrays .2 s, where loops take a tenth, each further version of a function as long again. Called
with a literal 0, or with a variable that begins as one, a function gets two versions; with np.int64(0) it gets one.
"""

import gc
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from vemlight.compiling import say_compiling

# numba imports scipy.linalg to see whether there is BLAS, .2 s of each start. No kernel calls BLAS, so numba finds none.
BLAS = "scipy.linalg.cython_blas"
_loaded = sys.modules.get(BLAS)
sys.modules[BLAS] = None  # type: ignore[assignment]
try:
    import numba
    import numba.np.arraymath
    from numba.core import event
    from numba.core.caching import FunctionCache
finally:
    del sys.modules[BLAS]
    if _loaded:
        sys.modules[BLAS] = _loaded


# Objects that are made between two garbage collections while numba compiles, which makes millions that stay: the default of 700 takes a
# tenth of its time. Any value from 20,000 on does; at this one a process holds 20 MB more.
COMPILING_GC = 50_000
SAY_AFTER_S = 2.0  # of compiling, and again after as long: somebody wonders. 1 to 5 s would do


class CompilerNotice(event.Listener):
    """Says what is compiled: in a run's folder, and at a terminal with how long it has taken by now."""

    def __init__(self) -> None:
        self._depth, self._spent_s, self._said_s, self._started_s = 0, 0.0, 0.0, 0.0
        self._collecting, self._name = gc.get_threshold(), ""

    def on_start(self, event: event.Event) -> None:
        if self._depth == 0:
            self._started_s, self._collecting = time.monotonic(), gc.get_threshold()
            gc.set_threshold(COMPILING_GC, *self._collecting[1:])
            if event.data:  # the outermost: that it calls others, of ours or of numba's, nobody needs to know
                function = event.data["dispatcher"].py_func
                self._name = f"{function.__module__.removeprefix('vemlight.')}.{function.__name__}"
                say_compiling(self._name)
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1
        spent_s = self._spent_s + time.monotonic() - self._started_s
        if self._depth == 0:
            self._spent_s = spent_s
            gc.set_threshold(*self._collecting)
            say_compiling("")
        if spent_s > self._said_s + SAY_AFTER_S and event.data and sys.stderr.isatty():
            self._said_s = spent_s
            package = self._name.partition(".")[0]
            text = f"compiling the {package}'s kernels, at the first start: {spent_s:.0f} s so far ({self._name})"
            print(f"vemlight: {text}", file=sys.stderr, flush=True)


event.register("numba:compile", CompilerNotice())


@contextmanager
def signals_after() -> Iterator[None]:
    """What SIGINT and SIGTERM do in the main thread, they do when its body has ended."""
    if threading.current_thread() is not threading.main_thread():  # which alone gets signals
        yield
        return
    came: list[int] = []
    before = {number: signal.signal(number, lambda number, _: came.append(number)) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in came:
            signal.raise_signal(number)


# LLVM asks for a cached kernel's machine code through a callback of ctypes, which drops whatever is raised in it: after Ctrl-C there the
# kernel would be an address of 0, which is called.
_load_overload = FunctionCache.load_overload


def _load_whole(self: Any, *arguments: Any) -> Any:
    with signals_after():
        return _load_overload(self, *arguments)


FunctionCache.load_overload = _load_whole  # pyright: ignore[reportAttributeAccessIssue]


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """A decorator: compiles a function when it is first called and keeps the machine code in numba's cache.

    A division by zero gives inf or nan, as in numpy. options: of numba.njit. Machine code that calls a kernel of another file holds a copy
    of it, and numba looks only at the time of a function's own file: after a change delete the cache, as `make clean` does.
    """
    compiled: Any = numba.njit(cache=True, error_model="numpy", no_cfunc_wrapper=True, **options)  # pyright: ignore[reportCallIssue]
    return compiled if function is None else compiled(function)


def subroutine(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """As `kernel`, for what only kernels call: without the code by which Python calls it, which is a seventh of all."""
    compiled: Any = numba.njit(error_model="numpy", no_cfunc_wrapper=True, no_cpython_wrapper=True, **options)  # pyright: ignore[reportCallIssue]
    return compiled if function is None else compiled(function)


def read_only(array: np.ndarray) -> np.ndarray:
    """A view of the array that cannot be written, as arrays off the wire cannot: numba compiles a kernel for each of the two."""
    view = array.view()
    view.flags.writeable = False
    return view


def callback(signature: str) -> Callable[[Callable[..., Any]], Any]:
    """A decorator: compiles a function of this signature, when its module is imported, for a library to call at its `address`."""
    return numba.cfunc(signature, cache=True)
