"""`vemlight run`: starts the services, watches them, starts one that dies again, and stops them all; leaves no orphan and no file."""

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from pathlib import Path

import msgspec
import tomli_w
import zmq

from vemlight.errors import UserError
from vemlight.runtime import wire
from vemlight.runtime.channels import LAST, Service
from vemlight.runtime.token import with_token
from vemlight.runtime.transport import Transport
from vemlight.settings import Settings

RUN_FOLDER = "vemlight-run-"
READY_S = 90.0  # for GL, and the first time for compiling; capture then starts in any case
SLOW_START_S = 8.0  # after so long a line says why
BACK_OFF_S = (0.0, 0.5, 1.0, 2.0)  # before a restart: the more often it died lately the longer
GIVE_UP = 5  # deaths of one service within
GIVE_UP_S = 60.0
STOP_S = 3.0  # between SIGTERM and SIGKILL
PROGRESS_S = 2.0
QUIET_BLAS = {"OPENBLAS_NUM_THREADS": "1"}  # matrices are small here, and its threads would spin on cores that the renderer draws with
PR_SET_PDEATHSIG = 1  # linux/prctl.h


class Child:
    """One service's process and the deaths it has died."""

    def __init__(self, service: Service, settings_file: Path) -> None:
        self.service, self._settings_file = service, settings_file
        self.restarts = 0
        self._deaths_s: deque[float] = deque(maxlen=GIVE_UP)
        self._start_at_s = 0.0
        self.running: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        # Its own process group: Ctrl-C reaches the supervisor alone, which then stops the services in good order.
        self.running = subprocess.Popen(
            [sys.executable, "-m", f"vemlight.{self.service}", str(self._settings_file)],
            env={**QUIET_BLAS, **os.environ, "VEMLIGHT_RESTARTS": str(self.restarts)},
            process_group=0,
            preexec_fn=_die_with_parent,
        )

    def died(self, status: int) -> str | None:
        """Plans the restart; the reason when there is none because it dies again and again."""
        now = time.monotonic()
        self._deaths_s.append(now)
        recent = [t for t in self._deaths_s if t > now - GIVE_UP_S]
        self.running = None
        if len(recent) == GIVE_UP:
            return f"{self.service} died {GIVE_UP} times in {GIVE_UP_S:.0f} s ({_ending(status)}); its own lines above say why"
        self.restarts += 1
        wait_s = BACK_OFF_S[min(len(recent), len(BACK_OFF_S)) - 1]
        self._start_at_s = now + wait_s
        print(f"vemlight: {self.service} {_ending(status)}; restart {self.restarts} in {wait_s:g} s", file=sys.stderr, flush=True)
        return None

    def start_when_due(self) -> None:
        if self.running is None and time.monotonic() >= self._start_at_s:
            self.start()


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _ending(status: int) -> str:
    return f"was killed by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"


def supervise(settings: Settings) -> int:
    """Runs all services until the last frame is done (0), a signal comes (0), or one of them cannot go on (its status).

    Raises UserError for settings that cannot work before anything is started.
    """
    if settings.out:
        clear_output(Path(settings.out))
    settings = with_token(settings)  # here, so that a viewer that is started again asks for the same
    _remove_dead_runs()
    folder = Path(tempfile.gettempdir()) / f"{RUN_FOLDER}{os.getpid()}"
    folder.mkdir(mode=0o700)
    try:
        if settings.wire.transport == "ipc" and not settings.wire.folder:
            settings = msgspec.structs.replace(settings, wire=msgspec.structs.replace(settings.wire, folder=str(folder)))
        file = folder / "vemlight.toml"
        file.write_text(tomli_w.dumps(msgspec.to_builtins(settings)))
        status = Supervisor(settings, file).run()
        if settings.out and status == 0:
            pictures = len(list(Path(settings.out).glob("frame_[0-9]*.exr")))
            print(f"vemlight: {settings.out}: {pictures} pictures and their lights", file=sys.stderr, flush=True)
        return status
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class Supervisor:
    """The processes and what they say of themselves."""

    def __init__(self, settings: Settings, settings_file: Path) -> None:
        self._settings = settings
        self._children = {service: Child(service, settings_file) for service in settings.services}
        self._transport = Transport(settings.wire)
        self._statuses = [self._transport.subscribe(service, "status") for service in settings.services]
        self._newest: dict[str, wire.StatusMessage] = {}
        self._signals = 0
        self._said = 0  # pictures that a progress line has spoken of
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._on_signal)

    def _on_signal(self, *_: object) -> None:
        self._signals += 1

    def run(self) -> int:
        try:
            for service, child in self._children.items():
                if service != "capture":
                    child.start()
            status = self._watch(until_ready=True)
            if status is None:
                self._children["capture"].start()
                status = self._watch()
            return status or 0
        finally:
            self._stop()
            self._transport.close()

    def _watch(self, until_ready: bool = False) -> int | None:
        """Until somebody cannot go on or all is done: the status to end with. Or None as soon as all but capture have spoken."""
        began_s = said_s = time.monotonic()
        patient = False
        while not self._signals:
            self._hear()
            if until_ready and (len(self._newest) == len(self._children) - 1 or time.monotonic() > began_s + READY_S):
                return None
            if until_ready and not patient and time.monotonic() > began_s + SLOW_START_S:
                patient = True
                print("vemlight: starting; the first time, code is compiled, which takes up to a minute", file=sys.stderr, flush=True)
            for child in self._children.values():
                if child.running and (ended := child.running.poll()) is not None:
                    if ended == 2 or (ended == 0 and child.service == LAST):
                        return ended
                    if reason := child.died(ended):
                        print(f"vemlight: {reason}", file=sys.stderr, flush=True)
                        return 1
                if not until_ready or child.service != "capture":
                    child.start_when_due()
            if time.monotonic() - said_s > PROGRESS_S:
                said_s = time.monotonic()
                self._say_progress()
        return 0

    def _hear(self) -> None:
        zmq.select(self._statuses, [], [], timeout=0.1)
        for socket in self._statuses:
            while socket.poll(0):
                try:
                    header, _ = wire.unpack(socket.recv_multipart(zmq.NOBLOCK))
                except (ValueError, zmq.Again):
                    continue
                if isinstance(header, wire.StatusMessage):
                    self._newest[header.service] = header

    def _say_progress(self) -> None:
        """A line now and then while files are written; a live run has its page."""
        last = self._newest.get(LAST)
        if self._settings.out and last and last.sequence is not None and last.sequence >= self._said:
            self._said = last.sequence + 1
            wanted = f" of {self._settings.capture.frames}" if self._settings.capture.frames else ""
            print(f"vemlight: picture {self._said}{wanted}, {last.rate_hz:.1f} a second", file=sys.stderr, flush=True)

    def _stop(self) -> None:
        asked = self._signals
        running = [child.running for child in self._children.values() if child.running]
        for each in running:
            each.terminate()
        give_up_s = time.monotonic() + STOP_S
        while any(each.poll() is None for each in running):
            if time.monotonic() > give_up_s or self._signals > max(asked, 1):  # a second Ctrl-C forces
                for each in running:
                    each.kill()
            time.sleep(0.02)


def clear_output(out: Path) -> None:
    """Makes the folder and removes what an earlier run of ours left there, and nothing else. Raises UserError when it cannot."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name in ("lights.jsonl", "manifest.jsonl", "contact.png"):
            (out / name).unlink(missing_ok=True)
        for picture in [*out.glob("frame_[0-9]*.exr"), *out.glob("frame_[0-9]*.png")]:
            picture.unlink()
    except OSError as error:
        raise UserError(f"{out}: cannot be written to ({error.strerror}); choose another --out") from error


def _remove_dead_runs() -> None:
    """Folders of runs that were killed outright; their processes ended with them."""
    for folder in Path(tempfile.gettempdir()).glob(f"{RUN_FOLDER}*"):
        try:
            os.kill(int(folder.name.removeprefix(RUN_FOLDER)), 0)
        except (ValueError, PermissionError):
            continue
        except ProcessLookupError:
            shutil.rmtree(folder, ignore_errors=True)
