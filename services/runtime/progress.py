"""Progress of long work for somebody at the terminal: on stderr, and nothing where stderr is no terminal."""

import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar

from vemlight.errors import printable_line

Item = TypeVar("Item")
LOG_S = 30.0  # between two lines of a log; any value in 10..300 does
hidden = False  # --quiet


def counted(items: Iterable[Item], description: str, total: int) -> Iterable[Item]:
    """The items, with a bar that shows how many of them are done; no bar for a single one."""
    if hidden or total == 1 or not sys.stderr.isatty():
        return items
    from rich.console import Console  # here, since rich takes a tenth of a second to load
    from rich.progress import track

    return track(items, description=description, total=total, console=Console(stderr=True))


def awaited(description: str) -> AbstractContextManager[Any]:
    """A context in which a spinner turns, for work whose end is not known before."""
    if hidden or not sys.stderr.isatty():
        return nullcontext()
    from rich.console import Console

    return Console(stderr=True).status(description)


def logged(items: Iterable[Item], name: str, total: int, missing: int) -> Iterator[Item]:
    """The items; where stderr is no terminal, a line every LOG_S says how many of `total` are done, for whoever reads a log.

    missing: how many there are, the last of the total.
    """
    is_silent, began_s = hidden or sys.stderr.isatty(), time.monotonic()
    said_s = began_s
    for done, item in enumerate(items, 1):
        yield item
        now_s = time.monotonic()
        if not is_silent and now_s - said_s >= LOG_S:
            said_s, rate = now_s, done / (now_s - began_s)
            left_s = (missing - done) / rate
            text = f"{name}: {total - missing + done} of {total} frames, {rate:.1f} a second, {left_s / 60:.0f} min left"
            print(f"vemlight: {printable_line(text)}", file=sys.stderr, flush=True)
