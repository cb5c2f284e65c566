"""The reference of all settings as a Markdown page, made from their declarations: docs/settings.md."""

from collections.abc import Iterator
from typing import Any

import msgspec
from msgspec import inspect

from vemlight.settings import Settings, SettingsSection

HEAD = """# Settings

One TOML file, given to `vemlight run` and to each service; every key has a default, and an unknown key is an error. Paths are
relative to the file. Made by `make settings-doc` from [services/settings.py](../services/settings.py); change them there.
"""
COLUMNS = ("Key", "Type", "Default", "Unit", "Range", "Meaning")


def settings_reference() -> str:
    """The page: the keys at the top level first, then one table a section."""
    sections = {field.name: field.default for field in inspect.type_info(Settings).fields if isinstance(field.default, SettingsSection)}  # type: ignore[attr-defined]
    parts = [HEAD, _table("Top level", Settings, skip=tuple(sections))]
    parts += [_table(f"[{name}]", type(section)) for name, section in sections.items()]
    return "\n".join(parts)


def _table(title: str, kind: type[SettingsSection], skip: tuple[str, ...] = ()) -> str:
    rows = [_row(field) for field in inspect.type_info(kind).fields if field.name not in skip]  # type: ignore[attr-defined]
    lines = [f"## {title}", "", kind.__doc__ or "", "", *_markdown([COLUMNS, *rows])]
    return "\n".join(lines) + "\n"


def _markdown(rows: list[tuple[str, ...]]) -> Iterator[str]:
    for number, row in enumerate(rows):
        yield f"| {' | '.join(row)} |"
        if number == 0:
            yield f"|{'---|' * len(row)}"


def _row(field: inspect.Field) -> tuple[str, ...]:
    meaning, unit, kind = "", "", field.type
    while isinstance(kind, inspect.Metadata):  # what Annotated adds, from outside in
        meaning = (kind.extra_json_schema or {}).get("description", meaning)
        unit = (kind.extra or {}).get("unit", unit)
        kind = kind.type
    kinds = [kind]
    if isinstance(kind, inspect.UnionType):  # of a type and None, which stands for a key that is left out, or of a text and a list
        kinds = [each for each in kind.types if not isinstance(each, inspect.NoneType)]
    return f"`{field.name}`", " or ".join(map(_type, kinds)), _default(field), unit, _range(kinds[0]), meaning


def _type(kind: inspect.Type) -> str:
    if isinstance(kind, inspect.LiteralType):
        return ", ".join(f'`"{value}"`' for value in kind.values)
    names = {
        inspect.StrType: "text",
        inspect.IntType: "integer",
        inspect.FloatType: "number",
        inspect.BoolType: "`true` or `false`",
        inspect.VarTupleType: "list of tables" if isinstance(kind, inspect.VarTupleType) and isinstance(kind.item_type, inspect.StructType)
        else "list of texts",
        inspect.TupleType: "list of two numbers",
        inspect.StructType: "table",
        inspect.DictType: "table: service = text" if isinstance(kind, inspect.DictType) and isinstance(kind.value_type, inspect.StrType)
        else "table: name = integer",
    }
    return names[type(kind)]


def _default(field: inspect.Field) -> str:
    value: Any = field.default if field.default is not msgspec.NODEFAULT else field.default_factory()  # type: ignore[operator]
    return "left out" if value is None else f"`{msgspec.json.encode(value).decode()}`"


def _range(kind: inspect.Type) -> str:
    if isinstance(kind, inspect.StrType) and kind.pattern:
        return f"`{kind.pattern}`".replace("|", "\\|")
    if not isinstance(kind, inspect.IntType | inspect.FloatType):
        return ""
    bounds = [f"{sign} {value:g}" for sign, value in ((">", kind.gt), ("≥", kind.ge), ("<", kind.lt), ("≤", kind.le)) if value is not None]
    return ", ".join([*bounds, *([f"a multiple of {kind.multiple_of}"] if kind.multiple_of else [])])
