"""Patches of known luminance, and the tables that programs export them in: CSV of any country."""

import csv
import io
import math
import re
from pathlib import Path
from typing import NamedTuple

from vemlight.errors import UserError
from vemlight.file_kinds import file_kind
from vemlight.files import read_file

MAX_PATCHES_BYTES = 2**18  # 5,000 patches of 50 bytes; a chart has up to 140
BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
SEPARATORS = (",", ";", "\t")
COLUMNS = ("code", "luminance", "use")


class Patch(NamedTuple):
    """A surface of known luminance and the code it gave."""

    code: float
    luminance: float  # cd/m2
    check: bool
    weight: float = 1.0


def read_patches(path: Path) -> list[Patch]:
    """Reads the patches in a CSV file: columns code, luminance in cd/m2, use = fit or check, and optionally weight, in any case and order.

    Separated by commas, semicolons or tabs; with decimal points or commas. Raises UserError naming line and column.
    """
    content = read_file(path, MAX_PATCHES_BYTES)
    encoding = next((name for mark, name in BYTE_ORDER_MARKS.items() if content.startswith(mark)), "utf-8")
    if encoding != "utf-16" and (found := file_kind(content)):
        raise UserError(f"{path}: is {found}, and patches come as CSV; export it as that")
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError:  # whose words are no matter here
        text = content.decode("latin-1")
    try:
        names, rows = _table(text)
    except csv.Error as error:
        raise UserError(f"{path}: is no CSV file ({error}); export it as one") from error
    for name in COLUMNS:
        if names.count(name) != 1:
            has = "several columns" if name in names else "no column"
            mend = "name the columns code, luminance and use in its first line, with , ; or a tab between"
            raise UserError(f"{path}: has {has} {name!r}; {mend}")
    _check_decimal_signs(path, names, rows)
    return [_patch(f"{path}: line {number}", names, fields) for number, fields in rows]


def _table(text: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """The names of the columns in lower case, without units in brackets; and the rows that hold something, with their lines' numbers."""
    lines = re.split(r"\r\n|\n|\r", text)
    first = next((k for k, line in enumerate(lines) if line.strip(" ;,\t\"") and not re.match(r"sep=.$", line)), 0)

    def named(separator: str) -> list[str]:
        fields = next(csv.reader(io.StringIO(lines[first]), delimiter=separator, skipinitialspace=True), [])
        return [re.sub(r"\s*[\[(].*", "", field).strip().lower() for field in fields]

    separator = max(SEPARATORS, key=lambda separator: sum(name in COLUMNS for name in named(separator)))
    names = named(separator)
    rows = csv.reader(io.StringIO("\n".join(lines[first + 1 :]), newline=""), delimiter=separator, skipinitialspace=True)
    found = []
    for fields in rows:
        stripped = [field.strip() for field in fields]
        if any(stripped):
            found.append((first + 1 + rows.line_num, stripped))
    return names, found


def _check_decimal_signs(path: Path, names: list[str], rows: list[tuple[int, list[str]]]) -> None:
    """Raises UserError where some numbers have a decimal comma and others a decimal point: one of the two groups thousands."""
    numeric = [k for k, name in enumerate(names) if name in ("code", "luminance", "weight")]
    numbers = [fields[k] for _, fields in rows for k in numeric if k < len(fields)]
    commas = [number for number in numbers if "," in number]
    points = [number for number in numbers if "." in number]
    if commas and points:
        mend = "give all numbers the same decimal sign, and none for thousands"
        raise UserError(f"{path}: writes {commas[0][:20]!r} and {points[0][:20]!r}; {mend}")


def _patch(where: str, names: list[str], fields: list[str]) -> Patch:
    if any(fields[len(names) :]):
        detail = f"has {len(fields)} fields and the first line {len(names)}"
        raise UserError(f"{where}: {detail}; put ; or a tab between fields if numbers have decimal commas")
    row = dict(zip(names, fields, strict=False))
    try:
        code, luminance, weight = map(_number, (row.get("code", ""), row.get("luminance", ""), row.get("weight") or "1"))
    except ValueError as error:
        raise UserError(f"{where}: code, luminance and weight must be numbers ({error}); correct it") from error
    use = row.get("use", "").lower()
    if use not in ("fit", "check"):
        raise UserError(f"{where}: use = {use[:20]!r} must be fit or check; correct it")
    if not (math.isfinite(code) and 0 < luminance < math.inf and 0 < weight < math.inf):
        raise UserError(f"{where}: luminance and weight must be above 0, and all of them finite; correct it")
    return Patch(code, luminance, use == "check", weight)


def _number(text: str) -> float:
    if text.count(",") > 1 or "_" in text:
        raise ValueError(f"could not convert string to float: {text[:20]!r}")
    return float(text.replace(",", "."))
