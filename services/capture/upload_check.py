"""Decodes an upload in a process of its own, with limits: `python -m vemlight.capture.upload_check FOLDER` says what it is, or why not."""

import sys
from pathlib import Path

from vemlight.capture.source import open_files
from vemlight.runtime.child_limits import checked
from vemlight.settings import Capture

CHECKED_FRAMES = 8  # of a sequence, evenly spaced, the first and the last among them; the others are decoded when they are due


def check(folder: Path) -> str:
    """What the files of an upload are, in words. Raises UserError for what cannot be played."""
    files = list(folder.iterdir())
    source = open_files(Capture(source=str(files[0] if len(files) == 1 else folder)))
    count = len(source)
    for k in sorted({round(n * (count - 1) / (CHECKED_FRAMES - 1)) for n in range(CHECKED_FRAMES)}):
        source.frame(k)
    return "one picture" if count == 1 else f"{count} frames"


if __name__ == "__main__":
    sys.exit(checked(check, Path(sys.argv[1])))
