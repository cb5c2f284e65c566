"""Lines about what others do: one of each kind a minute, so that nobody can fill the log."""

import sys
import threading
import time

LINE_PERIOD_S = 60.0  # between two lines of a kind: whoever causes them shall not fill the log


class LogLines:
    """Prints lines on stderr; what comes within LINE_PERIOD_S of a line of its kind is counted, and the next line tells how many."""

    def __init__(self) -> None:
        self._printed_s: dict[str, float] = {}
        self._left_out: dict[str, int] = {}
        self._lock = threading.Lock()

    def say(self, kind: str, line: str) -> None:
        """Prints `line`, of which letters that a terminal would obey are escaped, unless one of its kind was printed lately."""
        with self._lock:
            now_s = time.monotonic()
            if now_s - self._printed_s.get(kind, float("-inf")) < LINE_PERIOD_S:
                self._left_out[kind] = self._left_out.get(kind, 0) + 1
                return
            self._printed_s[kind] = now_s
            left_out = self._left_out.pop(kind, 0)
        more = f" (and {left_out} like it since the last line)" if left_out else ""
        print(f"vemlight: {ascii(line)[1:-1][:400]}{more}", file=sys.stderr, flush=True)
