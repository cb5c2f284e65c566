"""A mutant: one small change of the source that the tests should notice."""

from collections.abc import Iterable
from typing import NamedTuple


class Mutant(NamedTuple):
    """Replaces `old` by `new` in a file, where it must occur exactly once; `tests` (files or node ids) should then fail.

    harmless: why no test need notice, for a change that makes no difference that matters.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]
    harmless: str = ""

    def applied(self, source: str) -> str:
        """The mutated source. Raises ValueError where `old` does not occur exactly once."""
        if source.count(self.old) != 1 or self.old == self.new:
            raise ValueError(f"{self.file} holds {self.old!r} {source.count(self.old)} times, not once")
        return source.replace(self.old, self.new)


def mutants_of(file: str, tests: str, changes: Iterable[tuple[str, ...]]) -> list[Mutant]:
    """The mutants of one file: (name, old, new) or, where none of `tests` (separated by spaces) need notice, (name, old, new, harmless)."""
    short = file.rsplit("/", 1)[-1]
    return [Mutant(f"{short}: {name}", file, old, new, tuple(tests.split()), *reason) for name, old, new, *reason in changes]
