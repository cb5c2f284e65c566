"""What child processes need from their first moment on."""

import ctypes
import os
import signal
from pathlib import Path

import vemlight

PR_SET_PDEATHSIG = 1  # linux/prctl.h
_prctl = ctypes.CDLL(None).prctl  # found here, because a child that was forked beside threads must not look for it


def plain_environment() -> dict[str, str]:
    """This process's environment without what a run tells its services, in which a child finds the package."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("VEMLIGHT_")}
    package = str(Path(vemlight.__file__).parents[1])
    return environment | {"PYTHONPATH": os.pathsep.join([package, *filter(None, [environment.get("PYTHONPATH")])])}


def die_with(parent: int) -> None:
    """In a child between fork and exec, where the fewest things are safe: killed when its parent ends, even while it is stopped."""
    _prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before the line above
        os._exit(1)
