"""The second camera's process: `python -m vemlight.plate vemlight.toml`."""

import sys

from vemlight.errors import UserError
from vemlight.plate.stage import PlateCamera, PlateSource
from vemlight.runtime.source_loop import run_camera, run_source
from vemlight.runtime.start import start
from vemlight.settings import Settings
from vemlight.source_names import is_camera


def main(settings: Settings, restarts: int = 0) -> None:
    if not settings.plate.source:
        raise UserError("[plate] source names nothing; name a video, a folder of pictures, or /dev/videoN")
    if is_camera(settings.plate.source):
        run_camera(settings, PlateCamera(settings.plate), restarts)
    else:
        run_source(settings, PlateSource(settings.plate), restarts)


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
