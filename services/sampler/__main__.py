"""The sampler's process: `python -m vemlight.sampler [vemlight.toml]`."""

import sys

from vemlight.runtime.loop import run_stage
from vemlight.runtime.start import start
from vemlight.sampler.stage import SamplerStage, warm
from vemlight.settings import Settings


def main(settings: Settings, restarts: int = 0) -> None:
    run_stage(settings, SamplerStage(settings), restarts)


def prepare(settings: Settings) -> None:
    """What a spare process does before it is needed: it loads the compiled code."""
    warm(settings.sampler)


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
