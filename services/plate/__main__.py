"""The second camera's process: `python -m services.plate vemlight.toml`."""

import sys

from services.files import BadInput
from services.loop import run_camera, run_source
from services.plate.stage import PlateCamera, PlateSource
from services.settings import Settings
from services.start import start


def main(settings: Settings, restarts: int = 0) -> None:
    if not settings.plate.source:
        raise BadInput("[plate] source names nothing; name a film, a folder of pictures, or /dev/videoN")
    if settings.plate.source.startswith("/dev/"):
        run_camera(settings, PlateCamera(settings.plate), restarts)
    else:
        run_source(settings, PlateSource(settings.plate), restarts)


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
