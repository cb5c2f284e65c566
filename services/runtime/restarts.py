"""When a process that died is started again: at once where it had worked, later and later where it dies of starting.

While that lasts, a file in the run's folder says so, for the people at the page.
"""

import contextlib
import signal
import sys
import time
from collections import deque
from pathlib import Path

from vemlight.runtime.session import session_folder

RESTART_DELAY_S = (0.0, 0.5, 1.0, 2.0)  # by how often in a row the process died within SOON_S of its start; the last also for later ones
SOON_S = 5.0  # a start takes 1 to 3 s: who lived longer has done frames, and did not die of starting. 4 to 10 s would do
MAX_DEATHS = 5  # of one process within GIVE_UP_S: it dies of itself, and restarting does not help
AGAIN_S = 15.0  # after which one that dies again and again, and without which others go on, is tried again: 5 to 60 s would do
MAX_TEXT = 200  # bytes of what the file says: it has under 60
GIVE_UP_S = 60.0  # five deaths with their delays take about 10 s when a process cannot even start


class Restarts:
    """The deaths of one process."""

    def __init__(self, name: str) -> None:
        """`name`: as lines call it."""
        self.restarts = 0
        self._name = name
        self._deaths_s: deque[float] = deque(maxlen=MAX_DEATHS)
        self._started_s = self._start_at_s = 0.0
        self._soon = 0  # deaths in a row soon after a start

    def on_start(self) -> None:
        """The process starts now."""
        self._started_s = time.monotonic()

    def plan(self, status: int, may_fail: bool = False) -> str | None:
        """Plans the start of a process that ended with `status`; the reason when there is none because it dies again and again.

        may_fail: others go on without it, and it is tried for ever, if not often.
        """
        now_s = time.monotonic()
        self._deaths_s.append(now_s)
        recent = [t for t in self._deaths_s if t > now_s - GIVE_UP_S]
        often = len(recent) == MAX_DEATHS
        if often and not may_fail:
            return f"{self._name} died {MAX_DEATHS} times in {GIVE_UP_S:.0f} s ({_ending(status)}); its own lines above say why"
        self.restarts += 1
        self._soon = self._soon + 1 if now_s < self._started_s + SOON_S else 0
        delay_s = AGAIN_S if often else RESTART_DELAY_S[min(self._soon, len(RESTART_DELAY_S) - 1)]
        self._start_at_s = now_s + delay_s
        print(f"vemlight: {self._name} {_ending(status)}; restart {self.restarts} in {delay_s:g} s", file=sys.stderr, flush=True)
        return None

    def left_s(self) -> float:
        """How long until it is to be started."""
        return max(0.0, self._start_at_s - time.monotonic())


def say_restarting(file: Path, status: int | None) -> None:
    """Notes that a process that ended with `status` is being started again; None: that it works."""
    with contextlib.suppress(OSError):  # nobody is told; the start goes on
        if status is None:
            file.unlink(missing_ok=True)
        else:
            file.write_text(f"it {_ending(status)}")


def restarting_file(folder: Path, service: str) -> Path:
    """Where `vemlight run` says that it is starting a service again. folder: of the run."""
    return folder / f"{service}.restarting"


def restart_of(service: str) -> str:
    """Why a service of this process's run is being started again, as "it was killed by SIGKILL"; "" where it is not."""
    session = session_folder()
    if session is None:
        return ""
    try:
        with restarting_file(session.parent, service).open("rb") as file:
            return file.read(MAX_TEXT).decode("ascii", "replace")
    except OSError:
        return ""


def _ending(status: int) -> str:
    return f"was killed by {signal.Signals(-status).name}" if status < 0 else f"ended with status {status}"
