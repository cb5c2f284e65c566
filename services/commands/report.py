"""What a command has done: a line for a person, an object for a program, or nothing, as --json and --quiet ask for."""

from collections.abc import Callable
from functools import wraps
from typing import Any, NamedTuple

import click

from vemlight.commands.parameters import STANDARD_OUTPUT
from vemlight.errors import UserError


class Report(NamedTuple):
    """text: lines for a person. values: the same for a program."""

    text: str
    values: dict[str, Any]


def reporting(command: Callable[..., Report]) -> Callable[..., None]:
    """Gives a command the options --json and --quiet, and prints its report as they ask. Whoever writes to standard output prints none."""

    @click.option("--json", "as_json", is_flag=True, help="Print what was done as one JSON object.")
    @click.option("--quiet", is_flag=True, help="Print nothing but warnings and errors.")
    @wraps(command)
    def with_report(as_json: bool, quiet: bool, **values: Any) -> None:
        import msgspec

        from vemlight.runtime import progress

        to_standard_output = values.get("out") == STANDARD_OUTPUT
        if as_json and (quiet or to_standard_output):
            other = "--quiet" if quiet else "--out -"
            raise UserError(f"--json: does not go with {other}, which leaves standard output to something else; leave one of them out")
        progress.hidden = quiet
        report = command(**values)
        if as_json:
            click.echo(msgspec.json.encode(report.values))
        elif not quiet:
            click.echo(report.text, err=to_standard_output)

    return with_report
