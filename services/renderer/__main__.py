"""The renderer's process: `python -m vemlight.renderer [vemlight.toml]`."""

import sys

from vemlight.renderer.stage import RendererStage
from vemlight.runtime.loop import run_stage
from vemlight.runtime.start import start
from vemlight.settings import Settings


def main(settings: Settings, restarts: int = 0) -> None:
    run_stage(settings, RendererStage(settings), restarts)


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
