"""`vemlight run`: starts the services, restarts one that dies, and stops them all; leaves no orphan and no file."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import msgspec
import tomli_w
import zmq

from vemlight.compiling import COMPILING, compiled_by, compiling_file
from vemlight.errors import UserError
from vemlight.runtime import wire
from vemlight.runtime.channels import LAST, Instance, service_of
from vemlight.runtime.children import die_with
from vemlight.runtime.instances import arguments, instance_of, started
from vemlight.runtime.interrupt import INTERRUPTED
from vemlight.runtime.output_folder import claimed_output, is_complete
from vemlight.runtime.peers import receive
from vemlight.runtime.restarts import GIVE_UP_S, Restarts, restarting_file, say_restarting
from vemlight.runtime.session import SESSION, make_session
from vemlight.runtime.source_protocols import LISTENERS
from vemlight.runtime.spare import Role, Spare
from vemlight.runtime.token import with_token
from vemlight.runtime.transport import Transport
from vemlight.settings import Settings

RUN_FOLDER = "vemlight-run-"
SLOW_START_S = 8.0  # after so long, again and again, a line says why: a start with compiled code takes 2 s. 4 to 15 s would do
STOP_TIMEOUT_S = 3.0  # between SIGTERM and SIGKILL: a step of the renderer takes up to a second; any value in 2..8 does
PROGRESS_S = 2.0  # between two lines while files are written; any value in 1..10 does
POLL_S = 0.1  # how late a death is noticed at most; any value in 0.02..0.3 does
SPARE_AFTER_S = 3.0  # loading takes a second of processor time; any value in 1..10 does
QUIET_BLAS = {"OPENBLAS_NUM_THREADS": "1"}  # matrices are small here, and its threads would spin on cores that the renderer draws with
TERMINATED = 128 + signal.SIGTERM  # as shells count


class Child:
    """One instance's process, and when it died."""

    def __init__(
        self, service: Instance, settings_file: Path, listeners: Sequence[Instance] = (), arguments: Sequence[str] = ()
    ) -> None:
        """listeners: those that the first process waits for before it plays frames, if it is a source. arguments: behind the file."""
        self.service: Instance = service
        self._settings_file, self._listeners, self._arguments = settings_file, " ".join(listeners), arguments
        self._restarting_file = restarting_file(settings_file.parent, service)
        self.deaths = Restarts(service)
        self.process: subprocess.Popen[bytes] | None = None

    def start(self, spare: Spare | None = None) -> None:
        """Starts the service's process, or makes it of a spare one that is still alive."""
        environment = {
            COMPILING: str(compiling_file(self._settings_file.parent, self.service)),
            SESSION: str(self._settings_file.parent / "session"),
            "VEMLIGHT_RESTARTS": str(self.deaths.restarts),
            LISTENERS: "" if self.deaths.restarts else self._listeners,
        }
        self.deaths.on_start()
        role = Role(service_of(self.service), [str(self._settings_file), *self._arguments], environment)
        self.process = spare.become(role) if spare else None
        # Its own process group: Ctrl-C reaches the supervisor alone, which then stops the services in good order.
        self.process = self.process or subprocess.Popen(
            [sys.executable, "-m", f"vemlight.{role.service}", *role.arguments],
            env={**QUIET_BLAS, **os.environ, **environment},
            process_group=0,
            preexec_fn=partial(die_with, os.getpid()),
        )

    def plan_restart(self, status: int, may_fail: bool = False) -> str | None:
        """As `Restarts.plan`, of the process that ended."""
        self.process = None
        compiling_file(self._settings_file.parent, self.service).unlink(missing_ok=True)  # it compiles nothing any more
        say_restarting(self._restarting_file, status)
        return self.deaths.plan(status, may_fail)

    def on_status(self, status: wire.StatusMessage) -> None:
        """Takes what the process says of itself: the one that was started again works."""
        if self.deaths.restarts and status.restarts == self.deaths.restarts:
            say_restarting(self._restarting_file, None)

    def is_due(self) -> bool:
        return self.process is None and not self.deaths.left_s()


def supervise(settings: Settings, overwrite: bool = False) -> int:
    """Runs all services until the last frame is done (0), one of them cannot go on (its status) or a signal comes.

    SIGINT gives 130. SIGTERM gives 143 where frames are missing from the output, 0 in live mode without one. What the same run has left in
    its output folder is kept, unless `overwrite`. Raises UserError for settings or a folder that cannot be used before anything is started.
    """
    with ExitStack() as open_:
        if settings.out and open_.enter_context(claimed_output(settings, overwrite)):
            return 0
        status = _run(with_token(settings))  # a token made here, so that a restarted viewer asks for the same
        return _with_result(settings, status) if settings.out else status


def _with_result(settings: Settings, status: int) -> int:
    """Says what is in the output folder, unless an error has ended the run and said so. The status to end with: 1 where 0 were untrue."""
    pictures, complete = len(list(Path(settings.out).glob("frame_[0-9]*.exr"))), is_complete(Path(settings.out))
    if status == 0 and complete:
        print(f"vemlight: {settings.out}: {pictures} pictures and their lights", file=sys.stderr, flush=True)
    elif status in (0, INTERRUPTED, TERMINATED):
        wanted = f" of {settings.capture.frames}" if settings.capture.frames else ""
        hint = "; the same command goes on from there" if settings.mode == "lossless" else ""
        print(f"vemlight: stopped: {settings.out} is partial, {pictures}{wanted} pictures{hint}", file=sys.stderr, flush=True)
    return status or int(not complete)


def _run(settings: Settings) -> int:
    _remove_dead_runs()
    folder = Path(tempfile.gettempdir()) / f"{RUN_FOLDER}{os.getpid()}"
    try:
        folder.mkdir(mode=0o700)
    except OSError as error:
        raise UserError(f"{folder}: cannot be made ({error.strerror}); remove it, make room, or set TMPDIR to another folder") from error
    try:
        if settings.wire.transport == "ipc" and not settings.wire.folder:
            settings = msgspec.structs.replace(settings, wire=msgspec.structs.replace(settings.wire, folder=str(folder)))
        make_session(folder / "session")
        file = folder / "vemlight.toml"
        file.write_text(tomli_w.dumps(msgspec.to_builtins(settings)))
        return Supervisor(settings, file).run()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class Supervisor:
    """The services' processes and their statuses."""

    def __init__(self, settings: Settings, settings_file: Path) -> None:
        self._settings, self._file, self._folder = settings, settings_file, settings_file.parent
        names = started(settings)
        self._last = instance_of(settings, LAST)
        self._children = {
            name: Child(name, settings_file, [other for other in names if other != name], arguments(settings, name)) for name in names
        }
        self._transport = Transport(settings.wire)
        self._statuses = {name: self._transport.subscribe(name, "status") for name in names}
        self._newest: dict[str, wire.StatusMessage] = {}
        self._signals, self._interrupted = 0, False
        self._spare: Spare | None = None
        self._spare_at_s = 0.0
        self._printed = 0  # pictures, in the last progress line
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, _: object) -> None:
        self._signals += 1
        self._interrupted |= number == signal.SIGINT

    def run(self) -> int:
        try:
            for child in self._children.values():
                child.start()
            return self._wait()
        finally:
            self._stop()
            self._transport.close()

    def _wait(self) -> int:
        """Restarts services that die until one cannot go on, all is done or a signal comes: the status to end with."""
        started_s = said_s = printed_s = time.monotonic()
        while not self._signals:
            self._receive_statuses()
            missing = [service for service in self._children if service not in self._newest]
            if missing and time.monotonic() > said_s + SLOW_START_S:
                said_s = time.monotonic()
                compiled = {service: compiled_by(service, self._folder) for service in missing}
                names = [f"{service} (compiling {kernel})" if kernel else service for service, kernel in compiled.items()]
                text = f"waiting for {', '.join(names)}: at the first start code is compiled, {said_s - started_s:.0f} s so far"
                print(f"vemlight: {text}", file=sys.stderr, flush=True)
            for child in self._children.values():
                if child.process and (ended := child.process.poll()) is not None:
                    if self._signals:  # it was sent to the services, too
                        break
                    may_fail = self._may_fail(child.service)
                    if (ended == 2 and not may_fail) or (ended == 0 and child.service == self._last):
                        return ended
                    if reason := child.plan_restart(ended, may_fail):
                        print(f"vemlight: {reason}", file=sys.stderr, flush=True)
                        return 1
                if child.is_due():
                    child.start(self._spare)
                    self._spare, self._spare_at_s = None, time.monotonic() + SPARE_AFTER_S
            self._keep_spare(missing)
            if time.monotonic() - printed_s > PROGRESS_S:
                printed_s = time.monotonic()
                self._print_progress()
        if self._interrupted:
            return INTERRUPTED
        return TERMINATED if self._settings.out else 0

    def _may_fail(self, name: Instance) -> bool:
        """Whether the others go on without it: a camera of a rig, live, which has worked before."""
        return self._settings.mode == "live" and service_of(name) == "capture" and name != service_of(name) and name in self._newest

    def _keep_spare(self, missing: Sequence[str]) -> None:
        """Starts a spare process when all services have been working for a while, so that it takes no time from their starts."""
        if missing:
            self._spare_at_s = time.monotonic() + SPARE_AFTER_S
        elif time.monotonic() > self._spare_at_s and (self._spare is None or not self._spare.is_alive()):
            self._spare = Spare(self._file, {**QUIET_BLAS, **os.environ}, partial(die_with, os.getpid()))
            self._spare_at_s = time.monotonic() + GIVE_UP_S  # one that dies of itself is not started again and again

    def _receive_statuses(self) -> None:
        zmq.select(list(self._statuses.values()), [], [], timeout=POLL_S)
        for name, socket in self._statuses.items():
            while socket.poll(0):
                try:
                    header, _ = wire.unpack(receive(socket).parts)
                except (ValueError, zmq.Again):
                    continue
                if isinstance(header, wire.StatusMessage):
                    self._newest[name] = header
                    self._children[name].on_status(header)

    def _print_progress(self) -> None:
        """A line while files are written; a live run has its page."""
        last = self._newest.get(self._last)
        if self._settings.out and last and last.sequence is not None and last.sequence >= self._printed:
            self._printed = last.sequence + 1
            wanted = f" of {self._settings.capture.frames}" if self._settings.capture.frames else ""
            print(f"vemlight: picture {self._printed}{wanted}{pace(last.rate_hz)}", file=sys.stderr, flush=True)

    def _stop(self) -> None:
        """Terminates the services, and kills those that do not end in time or when a second signal comes."""
        signals = self._signals
        if self._spare:
            self._spare.close()
        processes = [child.process for child in self._children.values() if child.process]
        for process in processes:
            process.terminate()
            process.send_signal(signal.SIGCONT)  # one that somebody has stopped would not hear it
        kill_at_s = time.monotonic() + STOP_TIMEOUT_S
        while any(process.poll() is None for process in processes):
            if time.monotonic() > kill_at_s or self._signals > max(signals, 1):
                for process in processes:
                    process.kill()
            time.sleep(0.02)


def pace(rate_hz: float) -> str:
    """How quickly pictures come, as words of a progress line; none before the second."""
    if rate_hz <= 0:
        return ""
    return f", {rate_hz:.1f} a second" if rate_hz >= 0.5 else f", one in {1 / rate_hz:.0f} s"


def _remove_dead_runs() -> None:
    """Folders of runs that were killed outright; their processes ended with them.

    One of this process's own number is of a run before it: in a container that is started again each has the same.
    """
    for folder in Path(tempfile.gettempdir()).glob(f"{RUN_FOLDER}*"):
        try:
            number = int(folder.name.removeprefix(RUN_FOLDER))
            if number != os.getpid():
                os.kill(number, 0)
                continue
        except (ValueError, OverflowError, PermissionError):
            continue
        except ProcessLookupError:
            pass
        shutil.rmtree(folder, ignore_errors=True)
