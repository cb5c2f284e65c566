"""The fuse process: `python -m vemlight.fuse vemlight.toml`."""

import sys
from pathlib import Path

from vemlight.fuse.check import warm
from vemlight.fuse.rig_file import read_camera_rig
from vemlight.fuse.service import layout_of_settings, main
from vemlight.runtime.start import start
from vemlight.settings import Settings


def prepare(settings: Settings) -> None:
    """What a spare process does before it is needed: what no frame shall wait for."""
    warm(read_camera_rig(Path(settings.rig.file)), layout_of_settings(settings))


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
