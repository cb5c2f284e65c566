"""The renderer's process: `python -m services.renderer [vemlight.toml]`."""

import sys

from services.loop import run_stage
from services.renderer.stage import RendererStage
from services.settings import Settings
from services.start import start


def main(settings: Settings, restarts: int = 0) -> None:
    run_stage(settings, RendererStage(settings), restarts)


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
