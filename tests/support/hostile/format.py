"""What a format of files is tried with."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple


class Format(NamedTuple):
    """suffix: of its files. whole: writes sound ones to a folder and returns them. read: what is tried. bombs: name -> content.

    mended: sets right what a reader checks first, such as checksums, in half of the damaged files. share: of the damaged files asked
    for, how many are made.
    """

    suffix: str
    whole: Callable[[Path], list[Path]]
    read: Callable[[Path], object]
    bombs: Callable[[], dict[str, bytes]]
    mended: Callable[[bytes], bytes] = bytes
    share: float = 1.0

    def path(self, folder: Path) -> Path:
        """Where a file of the format is put to be read."""
        return folder / ("manifest.jsonl" if self.suffix == ".jsonl" else f"file{self.suffix}")
