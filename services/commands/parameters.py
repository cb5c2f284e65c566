"""Parameters that several commands share, and how their texts are read."""

from pathlib import Path

import click

from vemlight.errors import UserError

PATH = click.Path(path_type=Path)


def width_height(_context: click.Context, parameter: click.Parameter, text: str) -> tuple[int, int]:
    """The two numbers of WIDTHxHEIGHT or COLUMNSxROWS. Raises UserError for anything else."""
    first, _, second = text.partition("x")
    if not all(number.isdecimal() and len(number) < 6 for number in (first, second)):  # Python reads numbers of up to 4300 digits
        example = "8x6" if parameter.required else parameter.default
        raise UserError(f"--{parameter.name} {text}: is not {parameter.metavar}; write it as {example}")
    return int(first), int(second)


def eight_numbers(_context: click.Context, parameter: click.Parameter, text: str | None) -> list[tuple[float, float]] | None:
    """The four points of x,y,x,y,x,y,x,y. Raises UserError for anything else."""
    if text is None:
        return None
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 8:
        raise UserError(f"--{parameter.name}: needs eight numbers, x,y,x,y,x,y,x,y")
    return list(zip(numbers[::2], numbers[1::2], strict=True))
