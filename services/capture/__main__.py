"""The capture process: `python -m vemlight.capture [vemlight.toml]`."""

import sys

from vemlight.capture.stage import CaptureCamera, CaptureSource
from vemlight.runtime.source_loop import run_camera, run_source
from vemlight.runtime.start import start
from vemlight.settings import Settings, is_live


def main(settings: Settings, restarts: int = 0) -> None:
    if is_live(settings.capture.source):
        run_camera(settings, CaptureCamera(settings.capture), restarts)
    else:
        run_source(settings, CaptureSource(settings), restarts)


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
