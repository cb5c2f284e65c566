"""Parameters that several commands share, how their texts are read, and what is wrong with them in one line."""

import math
import os
import re
from pathlib import Path
from typing import Any, get_args

import click

from vemlight.choices import Background, ExrFloats, Filter, Method, Mode, Shadows, Tone
from vemlight.errors import UserError
from vemlight.runtime.channels import INSTANCE, SERVICES

STANDARD_OUTPUT = Path("-")
MODE, TONE, BACKGROUND, SHADOWS = (click.Choice(get_args(kind)) for kind in (Mode, Tone, Background, Shadows))
METHOD, FILTER, EXR_FLOATS = (click.Choice(get_args(kind)) for kind in (Method, Filter, ExrFloats))


class NamedPath(click.Path):
    """A path that is not an empty text, which pathlib takes for the folder that one is in."""

    def __init__(self, allow_dash: bool = False) -> None:
        super().__init__(path_type=Path, allow_dash=allow_dash)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("is an empty name; name a file or a folder", param, ctx)
        return super().convert(value, param, ctx)


PATH = NamedPath()


class Number(click.FloatRange):
    """A finite number in a range; nan lies in any range for click."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail("nan and inf are refused; write a finite number", param, ctx)
        return number


class InstanceName(click.Choice):
    """A service, or one of several of its kind, such as capture.left."""

    def __init__(self) -> None:
        super().__init__(SERVICES)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if re.fullmatch(INSTANCE, value) else super().convert(value, param, ctx)


class OutFile(NamedPath):
    """A file to be written: its suffix and its folder are looked at before any work. dash: "-" is allowed, for standard output."""

    def __init__(self, *suffixes: str, dash: bool = False) -> None:
        super().__init__(allow_dash=dash)
        self._suffixes, self._dash = suffixes, dash

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        if path == STANDARD_OUTPUT and self._dash:
            return path
        written = " or ".join(", ".join(self._suffixes).rsplit(", ", 1))
        if path.suffix.lower() not in self._suffixes:
            self.fail(f"{path} is to be written as {written}; change the suffix", param, ctx)
        if path.is_dir():
            self.fail(f"{path} is a folder; name a file in it, such as {path / ('name' + self._suffixes[0])}", param, ctx)
        folder = path.resolve().parent
        if not folder.is_dir():
            self.fail(f"{path} cannot be written: there is no folder {path.parent}; make it first", param, ctx)
        if not os.access(folder, os.W_OK):
            self.fail(f"{path} cannot be written: you may not write in {folder}; choose another folder", param, ctx)
        return path


class OutFolder(NamedPath):
    """A folder to be written to, which is made when it is not there."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        nearest = next(one for one in (path.absolute(), *path.absolute().parents) if os.path.lexists(one))
        if not nearest.is_dir():
            self.fail(f"{path} cannot be a folder, because {nearest} is a file; choose another name", param, ctx)
        if not os.access(nearest, os.W_OK):
            self.fail(f"{path} cannot be written: you may not write in {nearest}; choose another folder", param, ctx)
        return path


def width_height(_context: click.Context, parameter: click.Parameter, text: str | None) -> tuple[int, int] | None:
    """The two numbers of WIDTHxHEIGHT or COLUMNSxROWS, None where the option may be left out and is. Raises UserError for anything else."""
    if text is None:
        return None
    first, _, second = text.partition("x")
    if not all(number.isdecimal() and len(number) < 6 for number in (first, second)):  # Python reads numbers of up to 4300 digits
        example = parameter.default if isinstance(parameter.default, str) else "8x6"
        raise UserError(f"--{parameter.name} {text[:40]}: is not {parameter.metavar}; write it as {example}")
    return int(first), int(second)


def eight_numbers(_context: click.Context, parameter: click.Parameter, text: str | None) -> list[tuple[float, float]] | None:
    """The four points of x,y,x,y,x,y,x,y. Raises UserError for anything else."""
    if text is None:
        return None
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 8 or not all(map(math.isfinite, numbers)):
        raise UserError(f"--{parameter.name} {text[:40]}: needs eight numbers, x,y,x,y,x,y,x,y; write them with commas between")
    return list(zip(numbers[::2], numbers[1::2], strict=True))


def usage_line(error: click.UsageError) -> str:
    """What click found wrong with the words of a command, on one line: the option or argument, what is wrong with it, the way out."""
    command = error.ctx.command_path if error.ctx else "vemlight"
    help_ = f"see `{command} --help`"
    text = error.message.rstrip(".")
    if isinstance(error, click.MissingParameter):
        return f"{_parameter_name(error)}: is missing; {_what_to_add(error) or help_}"
    if isinstance(error, click.BadParameter):
        return f"{_parameter_name(error)}: {_bad_value(error, help_)}"
    if isinstance(error, click.BadOptionUsage) and "requires" in text:
        return f"{error.option_name}: has no value; write one behind it"
    if near := getattr(error, "possibilities", None):
        return f"{text[:1].lower()}{text[1:]} in `{command}`; did you mean {' or '.join(near)}?"
    return f"{text[:1].lower()}{text[1:]}; {help_}"


def _parameter_name(error: click.BadParameter) -> str:
    """As it is typed: --count, or SOURCE."""
    if isinstance(error.param, click.Option):
        return max(error.param.opts, key=len)
    return error.param.human_readable_name if error.param else "an option"


def _what_to_add(error: click.MissingParameter) -> str:
    """How to give the parameter that is missing."""
    parameter = error.param
    if isinstance(parameter, click.Option) and parameter.help:
        return f"add {max(parameter.opts, key=len)}: {parameter.help.rstrip('.')}"
    if parameter and isinstance(parameter.type, click.Choice):
        return f"choose from {', '.join(map(str, parameter.type.choices))}"
    return ""


def _bad_value(error: click.BadParameter, help_: str) -> str:
    """What is wrong with the value, and what would be right."""
    text = error.message.rstrip(".")
    if error.param and isinstance(error.param.type, click.Choice):
        from vemlight.toml import choice_hint

        value = (re.match(r"(['\"])(.*)\1 is not (one of )?'", text, re.DOTALL) or ["", "", text])[2]
        return f"{value[:40]} is no choice; {choice_hint(value, tuple(map(str, error.param.type.choices)))}"
    if "; " in text:  # it has its way out
        return text
    if kind := re.search(r" is not a valid (integer|float)", text):
        number = "whole number" if kind[1] == "integer" else "number"
        return f"{text[: kind.start()][:40]} is no {number}; write one"
    if " is not in the range " in text:
        return f"{text}; choose a number in it"
    return f"{text[:1].lower()}{text[1:]}; {help_}"
