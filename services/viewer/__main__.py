"""The viewer's process: `python -m services.viewer [vemlight.toml]`."""

import asyncio
import sys

from services.settings import Settings
from services.start import start
from services.viewer.view import view


def main(settings: Settings, restarts: int = 0) -> None:
    asyncio.run(view(settings, restarts))


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
