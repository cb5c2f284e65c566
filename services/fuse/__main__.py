"""The fuse process: `python -m vemlight.fuse vemlight.toml`."""

import sys

from vemlight.fuse.service import main
from vemlight.runtime.start import start

if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
