"""Progress of long work for somebody at the terminal: on stderr, and nothing where stderr is no terminal."""

import sys
from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar

Item = TypeVar("Item")
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
