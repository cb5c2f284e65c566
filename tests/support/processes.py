"""Processes of tests: the command line, services, and the messages that they publish."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import zmq

from vemlight.runtime import wire
from vemlight.runtime.transport import Transport
from vemlight.settings import Settings

LOADED_S = 120.0  # patience on a machine that is busy: compiling the sampler's loops for the first time takes tens of seconds


def wait_until(true: Callable[[], object], what: str, patience_s: float = LOADED_S) -> None:
    """Waits for something that other processes do."""
    until = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < until, f"{what} did not happen within {patience_s:.0f} s"
        time.sleep(0.02)


def vemlight(*arguments: object, cwd: Path | None = None, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Runs the command line in a process of its own until it ends."""
    return subprocess.run(
        [sys.executable, "-m", "vemlight", *map(str, arguments)],
        capture_output=True, text=True, timeout=LOADED_S, cwd=cwd, env={**os.environ, **(environment or {})},
    )  # fmt: skip


class ServiceProcesses:
    """Processes of a test; those that still run at its end are killed."""

    def __init__(self) -> None:
        self.running: list[subprocess.Popen[bytes]] = []

    def start(self, *arguments: str, **environment: str) -> subprocess.Popen[bytes]:
        child = subprocess.Popen(
            [sys.executable, "-m", *arguments], env={**os.environ, **environment}, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        self.running.append(child)
        return child

    def kill(self) -> None:
        for child in self.running:
            if child.poll() is None:
                child.send_signal(signal.SIGKILL)
            child.communicate()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def children(pid: int) -> dict[str, int]:
    """Service or instance -> process id of the services that `pid` started."""
    found = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            try:
                parent = int(re.search(r"PPid:\s*(\d+)", (folder / "status").read_text())[1])  # type: ignore[index]
                command = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
            except OSError:
                continue
            if parent == pid and "-m" in command:
                _, module, *arguments = command[command.index("-m") :]
                camera = [each for each in arguments[1:] if each] if module == "vemlight.capture" else []
                found[".".join([module.removeprefix("vemlight."), *camera])] = int(folder.name)
    return found


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


class MessageListener:
    """Subscribes to sampler and renderer of a run."""

    def __init__(self, settings: Settings, *kinds: str) -> None:
        self._transport = Transport(settings.wire)
        self._sockets = [self._transport.subscribe(service, *kinds) for service in ("sampler", "renderer")]

    def next(self, kind: type, true=lambda header: True):
        """The header of the next message of a kind for which `true` holds."""
        until = time.monotonic() + LOADED_S
        while time.monotonic() < until:
            for found in zmq.select(self._sockets, [], [], 0.2)[0]:
                header, _ = wire.unpack(found.recv_multipart())
                if isinstance(header, kind) and true(header):
                    return header
        raise AssertionError(f"no such {kind.__name__} within {LOADED_S} s")

    def close(self) -> None:
        self._transport.close()
