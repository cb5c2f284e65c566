"""The viewer's process: `python -m vemlight.viewer [vemlight.toml]`."""

import asyncio
import sys

from vemlight.runtime.start import start
from vemlight.settings import Settings
from vemlight.viewer.service import view


def main(settings: Settings, restarts: int = 0) -> None:
    asyncio.run(view(settings, restarts))


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
