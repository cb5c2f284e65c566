"""Capture's process: `python -m services.capture [vemlight.toml]`."""

import sys

from services.capture.stage import CaptureSource
from services.loop import run_source
from services.settings import Settings
from services.start import start


def main(settings: Settings, restarts: int = 0) -> None:
    run_source(settings, CaptureSource(settings.capture), restarts)


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
