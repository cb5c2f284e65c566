"""The folder of one run for what people bring to it: uploads, which are deleted with it. Who plays them knows them by number alone."""

import os
import re
from pathlib import Path

SESSION = "VEMLIGHT_SESSION"  # in the environment of the services: the folder
ID = re.compile(r"[0-9a-f]{16}", re.ASCII)
INCOMING, READY = "incoming", "ready"  # in it: what still comes or was not decoded yet, and what was


def make_session(folder: Path) -> None:
    """Makes the folder, for this user alone."""
    for name in (INCOMING, READY):
        (folder / name).mkdir(mode=0o700, parents=True, exist_ok=True)


def session_folder() -> Path | None:
    """That of this run; None where the service was not started by `vemlight run`."""
    named = os.environ.get(SESSION, "")
    return Path(named) if named else None


def upload_folder(number: str) -> Path | None:
    """Where the files of an upload lie that was decoded; None for what is no number of one, or of none that there is."""
    folder = session_folder()
    if folder is None or not ID.fullmatch(number):
        return None
    found = folder / READY / number
    return found if found.is_dir() and not found.is_symlink() else None
