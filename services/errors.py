"""The two ways in which work ends early: by what the user has to change, and by what only a restart can fix."""

from collections.abc import Iterator
from contextlib import contextmanager


def printable_line(text: str) -> str:
    """The text on one line: line ends and all that a terminal would obey rather than show become spaces, whatever an input held."""
    return "".join(character if character.isprintable() else " " for character in text)


class UserError(ValueError):
    """A mistake that the user can fix. Its text is one line: what is wrong, where, and how to fix it."""

    def __init__(self, text: str) -> None:
        super().__init__(printable_line(text))


@contextmanager
def of_setting(where: str) -> Iterator[None]:
    """Puts before the text of a UserError which setting or option named what is wrong, such as "[capture] source"."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{where}: {error}") from error


class Interrupted(KeyboardInterrupt):
    """Ctrl-C where something has been written already. Its text says what there is of the result."""


class FatalError(RuntimeError):
    """A failure that only a restart can fix, such as a device that is gone. Its text is one line."""

    def __init__(self, text: str) -> None:
        super().__init__(printable_line(text))
