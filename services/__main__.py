"""The command `vemlight`, also as `python -m vemlight`."""

import sys


def main() -> None:
    """Runs the command. Ctrl-C gives status 130, also while the command is loaded."""
    try:
        from vemlight.commands.cli import main as command
    except KeyboardInterrupt:
        sys.exit(130)
    command(prog_name="vemlight")


if __name__ == "__main__":
    main()
