"""TOML into typed records, and errors of one line: the line's number, the key, its value and how to fix it."""

import codecs
import math
import re
import tomllib
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from os import PathLike
from typing import Any, TypeVar

import msgspec
from msgspec import inspect

from vemlight.errors import UserError
from vemlight.file_kinds import file_kind

MAX_KEY_DOTS = 32  # the deepest key of ours has three parts; tomllib takes the square of their number, 8 s at 10^5
MANY_DOTS = re.compile(rb"(?:\.[ \t]*[\w\"'-]+[ \t]*){%d}" % MAX_KEY_DOTS)
MAX_CHOICES = 12  # listed where one of them is near; any value in 8 .. 20 does
MAX_SHOWN = 60  # characters of a value in a line
MAX_PARSED = 2**20  # characters parsed to find a line: half a second; 2**18 .. 2**22 would do
TYPES = {"int": "a whole number", "float": "a number", "str": "text in quotes", "bool": "true or false", "array": "a list in [ ]",
         "object": "a table"}  # fmt: skip

Record = TypeVar("Record")
Keys = tuple[str | int, ...]


def record_from_toml(path: str | PathLike[str], content: bytes, kind: type[Record]) -> Record:
    """The TOML `content` of the file `path` as a record of `kind` (a msgspec Struct). A byte order mark is passed over.

    Raises UserError naming file, line and key for what is not TOML, does not fit the record, or holds nan or inf.
    """
    content = content.removeprefix(codecs.BOM_UTF8)
    if MANY_DOTS.search(content):
        raise UserError(f"{path}: has a key of more than {MAX_KEY_DOTS} parts; name a settings or scene file")
    if found := file_kind(content):
        hint = "save it as UTF-8" if "UTF-16" in found else "name a file of TOML text"
        raise UserError(f"{path}: is {found}, and not TOML in UTF-8; {hint}")
    try:
        text = content.decode()
        data = tomllib.loads(text)
        if (keys := next(_not_finite(data), None)) is not None:
            raise UserError(f"{path}: {_line(text, keys)}{_name(keys)}{_value(data, keys)}: nan and inf are refused; write a finite number")
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        raise UserError(f"{path}: {_fault(text, data, kind, str(error))}") from error
    except UserError:
        raise
    except RecursionError as error:
        raise UserError(f"{path}: is nested too deeply; name a settings or scene file") from error
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise UserError(f"{path}: line {line}: is not TOML, because it is not UTF-8; save the file as that") from error
    except ValueError as error:  # TOMLDecodeError, and a number of thousands of digits
        what, _, at = str(error)[:200].partition(" (at ")
        line = re.match(r"line (\d+)", at) or (f"line {text.rstrip().count(chr(10)) + 1}",) if at else None
        raise UserError(f"{path}: {f'{line[0]}: ' if line else ''}is not TOML ({what}); correct it") from error


def _not_finite(data: Any, keys: Keys = ()) -> Iterator[Keys]:
    """Where nan and inf are."""
    if isinstance(data, float) and not math.isfinite(data):
        yield keys
    elif isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from _not_finite(value, (*keys, key))


def _fault(text: str, data: dict[str, Any], kind: type, message: str) -> str:
    """What msgspec found, in words of the file. message: such as "Expected `int` >= 1 - at `$.sampler.count`"."""
    what, _, path = message.partition(" - at ")
    keys: Keys = tuple(int(index) if index else name for name, index in re.findall(r"\.([^.\[\]`]+)|\[(\d+)\]", path))
    line = _line(text, keys)
    if unknown := re.fullmatch(r"Object contains unknown field `(.*)`", what, re.DOTALL):
        keys = (*keys, unknown[1])
        return f"{_line(text, keys)}{_name(keys)}: there is no such key; {_right_key(kind, data, keys)}"
    if missing := re.fullmatch(r"Object missing required field `(.*)`", what):
        return f"{line}{_section(keys).strip() or 'the file'} has no {missing[1]}; add that key"
    if path.startswith("`key`"):
        wrong, possible = (re.findall(r"'(.*)'", what) or [""])[0], _type_at(kind, data, keys)
        return f"{line}{_section(keys)}{wrong}: {choice_hint(wrong, _choices(possible, of_keys=True))}"
    if not what.startswith(("Expected", "Invalid")):  # a section's own words about values that do not go together, with the way out
        return f"{line}{_section(keys)}{what}"
    if not keys:
        return f"{what}; correct it"
    found = f"{line}{_name(keys)}{_value(data, keys)}"
    if choices := _choices(_type_at(kind, data, keys)):
        return f"{found}: {choice_hint(str(_at(data, keys)), choices)}"
    return f"{found}: must be {_wanted(what)}; correct it"


def _wanted(what: str) -> str:
    """"a whole number >= 1" of "Expected `int` >= 1", and "a number, not text in quotes" of "Expected `float`, got `str`"."""
    wanted, _, found = what.removeprefix("Expected ").replace("matching regex", "that matches").partition(", got ")
    named = re.compile(r"`(\w+)(?: \| null)?`")
    wanted = named.sub(lambda name: TYPES.get(name[1], name[1]), wanted)
    found = named.sub(lambda name: "a fraction" if name[1] == "float" else TYPES.get(name[1], name[1]), found)
    return wanted + (f", not {found}" if found else "")


def choice_hint(value: str, choices: Sequence[str]) -> str:
    """What to write instead of a value that is none of the choices."""
    by_small_letters = {choice.lower(): choice for choice in choices}
    near = get_close_matches(value.lower(), by_small_letters, 1)
    meant = f"did you mean {by_small_letters[near[0]]}?" if near else ""
    if near and len(choices) > MAX_CHOICES:
        return meant
    return "; ".join(filter(None, (f"choose from {', '.join(choices)}", meant)))


def _right_key(kind: Any, data: Any, keys: Keys) -> str:
    """Instead of an unknown key: the section that has it, the key that was meant, or all that there are."""
    key = str(keys[-1])
    top = _fields(_type_at(kind, data, ()))
    if elsewhere := [name for name, field in top.items() if key in _fields(_plain(field))]:
        return f"it belongs into [{elsewhere[0]}]"
    if key in top:
        return "it belongs at the top, before all sections"
    here = _fields(_type_at(kind, data, keys[:-1]))
    near = get_close_matches(key, here, 1)
    return f"did you mean {near[0]}?" if near else f"the keys here are {', '.join(here)}"


def _line(text: str, keys: Keys) -> str:
    """"line 3: ", or nothing where the line is not known."""
    line = line_of(text, keys)
    return f"line {line}: " if line else ""


def _named(keys: Keys) -> Keys:
    """The keys without the places in a list of numbers, which have no name."""
    while keys and isinstance(keys[-1], int):
        keys = keys[:-1]
    return keys


def _name(keys: Keys) -> str:
    """"[sampler] count"."""
    keys = _named(keys)
    return f"{_section(keys[:-1])}{keys[-1]}"


def _section(keys: Keys) -> str:
    """"[sampler] " of the keys that lead to it; a list's tables are counted from 1, as a reader does."""
    parts = [f" {key + 1}" if isinstance(key, int) else f"{'.' if number else ''}{key}" for number, key in enumerate(keys)]
    return f"[{''.join(parts)}] " if parts else ""


def _value(data: Any, keys: Keys) -> str:
    value = _at(data, _named(keys))
    shown = f'"{value}"' if isinstance(value, str) else str(value)
    return f" = {shown[:MAX_SHOWN]}{'..' if len(shown) > MAX_SHOWN else ''}"


def _at(data: Any, keys: Keys) -> Any:
    """The value that the keys lead to. Raises LookupError or TypeError where they lead nowhere."""
    for key in keys:
        data = data[key]
    return data


def line_of(text: str, keys: Keys) -> int:
    """The number, from 1, of the line where the value begins that the keys lead to; 0 when it cannot be found, or not in time.

    tomllib reports no lines, but the beginning of a TOML file is a TOML file wherever no value is cut: the shortest one that has the keys
    ends with their value. It is found by halving.
    """
    lines = text.split("\n") if keys else []
    without, end, parsed = 0, len(lines) + 1, 0  # the first so many lines lack the keys; no fewer than `end` are known to have them
    while without + 1 < end:
        middle = (without + end) // 2
        for count in range(middle, end):
            beginning = "\n".join(lines[:count])
            parsed += len(beginning)
            if parsed > MAX_PARSED:
                return 0
            try:
                _at(tomllib.loads(beginning), keys)
            except tomllib.TOMLDecodeError:
                continue  # a value is cut there
            except (LookupError, TypeError):
                without = count
            else:
                end = count
            break
        else:
            end = middle
    return without + 1 if lines else 0


def _type_at(kind: Any, data: Any, keys: Keys) -> inspect.Type:
    """The type of the value in `data` that the keys lead to."""
    found = _plain(inspect.type_info(kind), data)
    for number, key in enumerate(keys, 1):
        match found:
            case inspect.UnionType():  # of tables that a key distinguishes, whose value is none of theirs
                tags = tuple(str(each.tag) for each in found.types if isinstance(each, inspect.StructType))
                return inspect.LiteralType(tags)
            case inspect.StructType():
                inside: inspect.Type = _fields(found).get(str(key), inspect.AnyType())
            case inspect.ListType() | inspect.VarTupleType():
                inside = found.item_type
            case inspect.DictType():
                inside = found.value_type
            case _:
                break
        found = _plain(inside, _at(data, keys[:number]))
    return found


def _plain(kind: inspect.Type, data: Any = None) -> inspect.Type:
    """A type without what Annotated adds, and without None, which stands for a key that is left out; of several tables that of `data`."""
    while isinstance(kind, inspect.Metadata):
        kind = kind.type
    if not isinstance(kind, inspect.UnionType):
        return kind
    members = [each for each in kind.types if not isinstance(each, inspect.NoneType)]
    if len(members) == 1:
        return _plain(members[0], data)
    tagged = [each for each in members if isinstance(each, inspect.StructType) and each.tag_field and isinstance(data, dict)]
    return next((each for each in tagged if data.get(each.tag_field) == each.tag), kind)


def _fields(kind: inspect.Type) -> dict[str, inspect.Type]:
    """The keys of a table, as they are written."""
    return {field.encode_name: field.type for field in kind.fields} if isinstance(kind, inspect.StructType) else {}


def _choices(kind: inspect.Type, of_keys: bool = False) -> tuple[str, ...]:
    """The values of an enumeration, or the keys of a table whose keys are one."""
    if of_keys and isinstance(kind, inspect.DictType):
        kind = _plain(kind.key_type)
    return tuple(str(value) for value in kind.values) if isinstance(kind, inspect.LiteralType) else ()
