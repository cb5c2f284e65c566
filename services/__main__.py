"""The command `vemlight`, also as `python -m vemlight`."""

import gc
import sys

COLLECTED_AT = 100_000  # objects; at Python's own 700 to 2,000, looking for garbage among modules takes a tenth of a command's second


def main() -> None:
    """Runs the command. Ctrl-C gives status 130, also while the command is loaded."""
    gc.set_threshold(COLLECTED_AT)
    try:
        from vemlight.commands.cli import main as command
    except KeyboardInterrupt:
        sys.exit(130)
    command(prog_name="vemlight")


if __name__ == "__main__":
    main()
