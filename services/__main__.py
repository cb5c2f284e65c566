"""`python -m vemlight`: the command `vemlight`."""

from vemlight.commands.cli import main

main(prog_name="vemlight")
