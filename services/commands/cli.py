"""The command `vemlight`. Each command loads what it needs when it runs, so that `vemlight --help` answers at once."""

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from vemlight.commands import capture_commands, exchange_commands, fixture_commands, luminaire_commands, offline_commands, service_commands
from vemlight.commands.parameters import usage_line
from vemlight.errors import FatalError, UserError, printable_line
from vemlight.runtime.interrupt import INTERRUPTED, interruption

HINTS = {  # how to fix what the system refuses
    errno.ENOENT: "check the path",
    errno.EACCES: "choose a place that you may use",
    errno.EPERM: "choose a place that you may use",
    errno.EROFS: "choose a place that can be written",
    errno.ENOSPC: "make room, or write elsewhere",
    errno.EDQUOT: "make room, or write elsewhere",
    errno.EFBIG: "make room, or write elsewhere",
    errno.EEXIST: "choose another name, or remove what has it",
    errno.ENOTDIR: "name a folder, not a file",
    errno.EISDIR: "name a file, not a folder",
    errno.ENAMETOOLONG: "choose a shorter name",
}


class OneLine(click.ClickException):
    """Reports on one line what ends a command."""

    exit_code = 2

    def show(self, file: Any = None) -> None:
        print(f"vemlight: {printable_line(self.message)}", file=file or sys.stderr)


@contextmanager
def one_line_for_usage() -> Iterator[None]:
    """Makes one line of click's own usage errors; a group without a command shows its help."""
    try:
        yield
    except click.exceptions.NoArgsIsHelpError:
        raise
    except click.UsageError as error:
        raise OneLine(usage_line(error)) from error


class CommandGroup(click.Group):
    """Reports what the user can fix as one line on stderr and status 2, what only a restart can fix as one line and status 1.

    Ctrl-C gives a line about what there is of the result, and status 130.
    """

    def make_context(self, *arguments: Any, **options: Any) -> click.Context:
        with one_line_for_usage():
            return super().make_context(*arguments, **options)

    def invoke(self, context: click.Context) -> Any:
        try:
            with interruption.heeded():
                return self._invoke(context)
        except KeyboardInterrupt as error:
            result = str(error)
        except Exception:
            if not interruption.came:  # in the middle of an import it becomes any other error
                raise
            result = ""
        result = result or "what was written so far, if anything, is partial"
        # Here all that the command held is closed. What its threads still do, reading ahead or compiling, is not waited for.
        print(f"vemlight: interrupted: {printable_line(result)}", file=sys.stderr, flush=True)
        sys.stdout.flush()
        os._exit(INTERRUPTED)

    def _invoke(self, context: click.Context) -> Any:
        try:
            with one_line_for_usage():
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
            where = f"{error.filename}: " if error.filename else ""
            hint = HINTS.get(error.errno or 0, "check the path and the disk")
            print(f"vemlight: {printable_line(f'{where}{error.strerror or error}; {hint}')}", file=sys.stderr)
            context.exit(2)


@click.group(cls=CommandGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="vemlight")
def main() -> None:
    """Live image-based lighting: frames of a fisheye HDR camera become a few steady directional lights, and a lit picture."""


for module in (service_commands, offline_commands, exchange_commands, fixture_commands, capture_commands, luminaire_commands):
    for command in module.COMMANDS:
        main.add_command(command)
