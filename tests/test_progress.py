"""Progress is for a terminal, on stderr, and for nothing else."""

import os
import pty
import subprocess
import sys

WORK = """
from vemlight.runtime.progress import awaited, counted
with awaited("fitting the lens"):
    pass
print(list(counted("abc", "photographs", 3)), list(counted("a", "frames", 1)))
"""
DONE = "['a', 'b', 'c'] ['a']\n"


def test_nothing_is_shown_without_a_terminal():
    done = subprocess.run([sys.executable, "-c", WORK], capture_output=True, text=True, timeout=60)
    assert (done.stdout, done.stderr) == (DONE, "")


def test_a_terminal_shows_it():
    ours, theirs = pty.openpty()
    terminal = os.environ | {"TERM": "xterm"}
    child = subprocess.Popen([sys.executable, "-c", WORK], stdout=subprocess.PIPE, stderr=theirs, text=True, env=terminal)
    os.close(theirs)
    seen = b""
    try:
        while part := os.read(ours, 4096):
            seen += part
    except OSError:  # the other end is closed
        pass
    os.close(ours)
    assert child.communicate(timeout=60)[0] == DONE
    assert b"fitting the lens" in seen
    assert b"photographs" in seen
    assert b"100%" in seen
    assert b"frames" not in seen  # one is no number to count up to
