"""A warm spare: one process that has loaded the code of every service, waits, and becomes the service that dies next.

Half of what a restarted service needs before its first frame is loading code. One spare for all services costs 70 MB of memory; the
supervisor starts another when it is used.
"""

import ctypes
import importlib
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from vemlight.runtime.channels import Service
from vemlight.runtime.start import start
from vemlight.settings import Settings
from vemlight.settings_file import read_settings

ARG_START, ARG_END = 47, 48  # fields of /proc/self/stat, from 0 (proc_pid_stat(5): 48 and 49): where the command line lies


class Role(msgspec.Struct, frozen=True):
    """What a spare becomes: `python -m vemlight.SERVICE ARGUMENTS...` with these variables in its environment."""

    service: Service
    arguments: list[str]
    environment: dict[str, str]


class Spare:
    """The supervisor's side: a process that may become a service."""

    def __init__(self, settings_file: Path, environment: Mapping[str, str], before_exec: Callable[[], object]) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "vemlight.runtime.spare", str(settings_file)],
            stdin=subprocess.PIPE,
            env=environment,
            process_group=0,
            preexec_fn=before_exec,
        )

    def is_alive(self) -> bool:
        return self.process.poll() is None

    def become(self, role: Role) -> subprocess.Popen[bytes] | None:
        """The process, which is the service from now on; None when it has died, and a new one must be started."""
        assert self.process.stdin
        try:
            self.process.stdin.write(msgspec.json.encode(role))
            self.process.stdin.close()
        except OSError:
            self.close()
            return None
        return self.process if self.is_alive() else None

    def close(self) -> None:
        self.process.kill()
        self.process.wait()


def main_of(service: Service) -> Any:
    """The module that is a service's process."""
    return importlib.import_module(f"vemlight.{service}.__main__")


def load(settings: Settings) -> None:
    """Loads the code of the settings' services, and what each prepares beforehand (`prepare` of its `__main__`)."""
    for service in settings.services:
        if prepare := getattr(main_of(service), "prepare", None):
            prepare(settings)


def set_command_line(words: Sequence[str]) -> None:
    """Shows `words` as this process's command line to ps and pkill, cut to the length of the one it was started with."""
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    start, end = (int(fields[i - 2]) for i in (ARG_START, ARG_END))  # two fields stand before the parenthesis
    text = b"\0".join(word.encode() for word in words)[: end - start - 1]
    ctypes.memmove(start, text.ljust(end - start, b"\0"), end - start)


def main(settings_file: str) -> int:
    load(read_settings(Path(settings_file)))
    line = sys.stdin.buffer.read()
    if not line:  # the supervisor has ended
        return 0
    role = msgspec.json.decode(line, type=Role)
    os.environ.update(role.environment)
    set_command_line([sys.executable, "-m", f"vemlight.{role.service}", *role.arguments])
    return start(main_of(role.service).main, role.arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
