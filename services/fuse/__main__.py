"""The fuse process: `python -m vemlight.fuse vemlight.toml`."""

import sys
from pathlib import Path

from vemlight.fuse.check import warm
from vemlight.fuse.rig_file import read_camera_rig
from vemlight.fuse.service import main
from vemlight.runtime.start import start
from vemlight.settings import Settings


def prepare(settings: Settings) -> None:
    """What a spare process does before it is needed: it loads the compiled code."""
    warm(read_camera_rig(Path(settings.rig.file)))


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
