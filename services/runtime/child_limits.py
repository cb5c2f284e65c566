"""A process that decodes what strangers sent: limits of memory, processor time and what it may write, and one line as its end."""

import os
import resource
from collections.abc import Callable
from pathlib import Path

from vemlight.errors import UserError
from vemlight.files import one_line

REFUSED = 2  # exit status: the line says why

MAX_MEMORY = 6 * 2**30  # bytes of addresses: libraries and compiled code reserve 2 GB of them, an 8192 x 4096 map takes 1.2 GB to read
MAX_CPU_S = 90
MAX_WRITTEN = 16 * 2**20  # bytes of a file: compiled code is kept in some


def limit_process() -> None:
    """Keeps this process within the limits from now on. It gets what time the others leave."""
    os.nice(10)
    for what, most in (
        (resource.RLIMIT_AS, MAX_MEMORY), (resource.RLIMIT_CPU, MAX_CPU_S), (resource.RLIMIT_FSIZE, MAX_WRITTEN), (resource.RLIMIT_CORE, 0),
    ):  # fmt: skip
        _, hard = resource.getrlimit(what)
        resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def checked(check: Callable[[Path], str], folder: Path) -> int:
    """Keeps this process within the limits, prints what `check` says of a folder, or why it refuses, and returns the exit status."""
    limit_process()
    try:
        print(check(folder))
    except UserError as error:
        print(error)
        return REFUSED
    except Exception as error:  # hostile bytes raise whatever a library trips over
        print(f"cannot be read ({one_line(error)})")
        return REFUSED
    return 0
