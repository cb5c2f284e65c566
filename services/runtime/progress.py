"""What somebody at the terminal sees of work that takes long: on stderr, and nothing where no terminal shows it."""

import sys
from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import track

Thing = TypeVar("Thing")


def counted(things: Iterable[Thing], description: str, total: int) -> Iterable[Thing]:
    """The things, with a bar that says how many of them are done; without one where there is one thing."""
    return track(things, description=description, total=total, console=Console(stderr=True), disable=total == 1 or not sys.stderr.isatty())


def awaited(description: str) -> AbstractContextManager[Any]:
    """Within it something turns, for work whose end is not known before."""
    return Console(stderr=True).status(description) if sys.stderr.isatty() else nullcontext()
