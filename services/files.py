"""Files in and out: TOML into typed records, writing that never leaves half a file, devices that may be opened."""

import grp
import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import msgspec

from vemlight.errors import UserError

Record = TypeVar("Record")


def read_toml(path: Path, kind: type[Record]) -> Record:
    """The TOML file at `path` as a record of `kind` (a msgspec Struct).

    Raises UserError naming the file and the key when the file is missing, is no TOML or does not fit the record.
    """
    try:
        with open(path, "rb") as file:
            return msgspec.convert(tomllib.load(file), kind)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: is not TOML ({error}); mend that line") from error
    except msgspec.ValidationError as error:
        raise UserError(f"{path}: {error}; mend that key") from error


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yields NAME.part to write to; afterwards it is flushed to the disk and renamed to `path`.

    When the body raises, the part is removed and `path` is untouched. The part keeps the suffix of `path` for libraries
    that choose a format by it.
    """
    part = path.with_name(f"{path.stem}.part{path.suffix}")
    try:
        yield part
        with open(part, "rb") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def may_open(device: Path) -> bool:
    """Whether this user may read and write it."""
    return os.access(device, os.R_OK | os.W_OK)


def group_hint(device: Path) -> str:
    """What to do where `may_open` says no: the command, with the name of the group that the device belongs to."""
    number = device.stat().st_gid
    try:
        name = grp.getgrgid(number).gr_name
    except KeyError:  # in containers groups often have no name
        name = str(number)
    return f"sudo usermod -aG {name} $USER, then log in again; for a container group_add {number}"
