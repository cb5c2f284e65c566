"""What a service compiles at its first start, for the people who wait: one line in a file beside the run's settings.

Without numba, so that whoever shows it need not load it.
"""

import contextlib
import os
from pathlib import Path

COMPILING = "VEMLIGHT_COMPILING"  # in the environment: this service's file, SERVICE.compiling; unset outside a run
MAX_NAME = 200  # bytes of a line: modules and functions have far shorter names


def compiling_file(folder: Path, service: str) -> Path:
    """Where a run's services say what they compile."""
    return folder / f"{service}.compiling"


def say_compiling(name: str) -> None:
    """Notes that this process compiles the kernel of that name, or with an empty name that it compiles nothing any more."""
    if path := os.environ.get(COMPILING):
        with contextlib.suppress(OSError):  # nobody is told; the compiler goes on
            if name:
                Path(path).write_text(name)
            else:
                Path(path).unlink(missing_ok=True)


def compiled_by(service: str, folder: Path | None = None) -> str:
    """The kernel that a service of a run compiles now, "" for none or when that is not known. folder: of the run; None: this process's."""
    if folder is None:
        own = os.environ.get(COMPILING)
        if not own:
            return ""
        folder = Path(own).parent
    try:
        with compiling_file(folder, service).open("rb") as file:
            return file.read(MAX_NAME).decode("ascii", "replace")
    except OSError:
        return ""
