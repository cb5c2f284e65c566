"""The sampler's process: `python -m services.sampler [vemlight.toml]`."""

import sys

from services.loop import run_stage
from services.sampler.stage import SamplerStage
from services.settings import Settings
from services.start import start


def main(settings: Settings, restarts: int = 0) -> None:
    run_stage(settings, SamplerStage(settings), restarts)


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
