"""The renderer's process: `python -m vemlight.renderer [vemlight.toml]`."""

import sys

from vemlight.renderer.chosen_scene import run_renderer
from vemlight.runtime.start import start
from vemlight.settings import Settings


def main(settings: Settings, restarts: int = 0) -> None:
    run_renderer(settings, restarts)


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
