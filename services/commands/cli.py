"""The command `vemlight`. Each command loads what it needs when it runs, so that `vemlight --help` answers at once."""

import sys
from typing import Any

import click

from vemlight.commands import capture_commands, luminaire_commands, offline_commands, service_commands
from vemlight.errors import FatalError, UserError


class CommandGroup(click.Group):
    """Reports what the user can fix as one line on stderr and status 2, what only a restart can fix as one line and status 1."""

    def invoke(self, context: click.Context) -> Any:
        try:
            return super().invoke(context)
        except UserError as error:
            print(f"vemlight: {error}", file=sys.stderr)
            context.exit(2)
        except FatalError as error:
            print(f"vemlight: {error}", file=sys.stderr)
            context.exit(1)
        except BrokenPipeError:  # `| head` has read enough
            raise
        except OSError as error:
            print(f"vemlight: {error.filename or ''}: {error.strerror or error}; check the path and the disk", file=sys.stderr)
            context.exit(2)


@click.group(cls=CommandGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="vemlight")
def main() -> None:
    """Live image-based lighting: frames of a fisheye HDR camera become a few steady directional lights, and a lit picture."""


for module in (service_commands, offline_commands, capture_commands, luminaire_commands):
    for command in module.COMMANDS:
        main.add_command(command)
