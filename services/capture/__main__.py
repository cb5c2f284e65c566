"""Capture's process: `python -m services.capture [vemlight.toml]`."""

import sys

from services.capture.stage import CaptureCamera, CaptureSource
from services.loop import run_camera, run_source
from services.settings import Settings
from services.start import start


def main(settings: Settings, restarts: int = 0) -> None:
    if settings.capture.source.startswith("/dev/"):
        run_camera(settings, CaptureCamera(settings.capture), restarts)
    else:
        run_source(settings, CaptureSource(settings), restarts)


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
