"""Progress of long work for somebody at the terminal: on stderr, and nothing where stderr is no terminal."""

import sys
from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import track

Item = TypeVar("Item")
hidden = False  # --quiet


def counted(items: Iterable[Item], description: str, total: int) -> Iterable[Item]:
    """The items, with a bar that shows how many of them are done; no bar for a single one."""
    unseen = hidden or total == 1 or not sys.stderr.isatty()
    return track(items, description=description, total=total, console=Console(stderr=True), disable=unseen)


def awaited(description: str) -> AbstractContextManager[Any]:
    """A context in which a spinner turns, for work whose end is not known before."""
    return Console(stderr=True).status(description) if sys.stderr.isatty() and not hidden else nullcontext()
