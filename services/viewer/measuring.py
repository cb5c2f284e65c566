"""`vemlight doctor --write` from the page: a child tries the settings in use and finds those that hold their rate on this machine."""

import asyncio
import contextlib
import os
import re
import signal
import socket
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import msgspec
import tomli_w

from vemlight.errors import UserError, printable_line
from vemlight.runtime.children import plain_environment
from vemlight.runtime.instances import rig_cameras
from vemlight.settings import Settings
from vemlight.source_names import is_camera

MAX_TEXT = 400  # letters of a line
MAX_LINE = 2**16  # bytes of one that the child prints; it prints under a thousand
END_S = 10.0  # for the child to end the run that it tries, which stops its services; 5 to 30 s would do
CAMERA = "a camera serves one run at a time: stop this one, and give  vemlight doctor FILE --write OTHER  at a prompt"
RIG = "cameras of a rig serve one run at a time: stop this one, and give  vemlight doctor FILE --write OTHER  at a prompt"
COMMAND = (sys.executable, "-P", "-m", "vemlight", "doctor")
State = Literal["idle", "running", "done", "failed"]


class Measuring:
    """At most one at a time. state, text: how it stands, for a person; file: what the last one found, empty before."""

    def __init__(self) -> None:
        self.state: State = "idle"
        self.text = ""
        self.file = b""
        self._task: asyncio.Task[None] | None = None

    def summary(self) -> dict[str, Any]:
        """For the page."""
        return {"state": self.state, "text": self.text}

    def start(self, settings: Settings) -> asyncio.Task[None]:
        """Begins to try `settings`; the task ends with it. Raises UserError where that cannot be, or goes on already."""
        if self.state == "running":
            raise UserError("it is going on already; wait for it, or stop it")
        if is_camera(settings.capture.source):
            raise UserError(CAMERA)
        if any(is_camera(camera.source) for camera in rig_cameras(settings.rig.file)):
            raise UserError(RIG)
        self.state, self.text, self.file = "running", "looking at this machine", b""
        self._task = asyncio.create_task(self._measure(settings))
        return self._task

    async def stop(self) -> None:
        """Ends it, and the run that it tries."""
        task = self._task
        if task and not task.done():
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task

    async def _measure(self, settings: Settings) -> None:
        try:
            with tempfile.TemporaryDirectory(prefix="vemlight-measure-") as folder:
                given, found = Path(folder) / "given.toml", Path(folder) / "found.toml"
                port = _free_port()  # that of the page is taken, by the page
                viewer = msgspec.structs.replace(settings.viewer, port=port)
                tried = msgspec.structs.replace(settings, viewer=viewer, out="")
                given.write_text(tomli_w.dumps(msgspec.to_builtins(tried)))  # with what opens a stream, which is not in the child's file
                status = await self._run(*COMMAND, str(given), "--write", str(found))
                if status == 0:
                    self.file = with_port(found.read_bytes(), port, settings.viewer.port)
            self.state = "done" if self.file else "failed"
        except asyncio.CancelledError:
            self.state, self.text = "idle", ""
            raise
        except OSError as error:
            self.state, self.text = "failed", f"it cannot be tried now ({error.strerror}); try again"

    async def _run(self, *command: str) -> int:
        """Runs a command line, and keeps the newest of its lines. Its status."""
        child = await asyncio.create_subprocess_exec(
            *command, env=plain_environment(), start_new_session=True, limit=MAX_LINE,
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT,
        )  # fmt: skip
        try:
            assert child.stdout
            lines = []
            async for line in child.stdout:
                lines.append(printable_line(line.decode(errors="replace").strip())[:MAX_TEXT])
                self.text = said(lines) or self.text
            return await child.wait()
        finally:
            await _ended(child)


def said(lines: list[str]) -> str:
    """Of the lines of `vemlight doctor --write` what a person is told: what fails and the way out, else the newest that is no hint."""
    for line, following in pairwise([*lines, ""]):
        if line.startswith("fail "):
            return line.removeprefix("fail").strip() + (f"; {following.removeprefix('->').strip()}" if following.startswith("->") else "")
    told = [line.removeprefix("vemlight: ") for line in lines if line and not line.startswith(("->", "wrote "))]
    return re.sub("^(pass|warn) +", "", told[-1]) if told else ""


async def _ended(child: asyncio.subprocess.Process) -> None:
    """Interrupts a child, which then ends what it has started; kills both where that takes too long."""
    if child.returncode is not None:
        return
    child.send_signal(signal.SIGINT)
    try:
        async with asyncio.timeout(END_S):
            await child.wait()
    except TimeoutError:
        os.killpg(child.pid, signal.SIGKILL)
        await child.wait()


def with_port(text: bytes, tried: int, own: int) -> bytes:
    """A settings file with the page's own port in place of the one of the trial."""
    return re.sub(rb"(?m)^port = %d$" % tried, b"port = %d" % own, text)


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]
