"""Files in and out: one error for what a user must mend, TOML into typed records, and writing that never leaves half a file."""

import grp
import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import msgspec

Record = TypeVar("Record")


class BadInput(ValueError):
    """What the user must mend. Its text is one line that says what is wrong, where, and how to mend it."""


class Failed(RuntimeError):
    """What nobody can mend but a new start may: a device that is gone. Its text is one line."""


def read_toml(path: Path, kind: type[Record]) -> Record:
    """The TOML file at `path` as a record of `kind` (a msgspec Struct).

    Raises BadInput naming the file and the key when the file is missing, is no TOML or does not fit the record.
    """
    try:
        with open(path, "rb") as file:
            return msgspec.convert(tomllib.load(file), kind)
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: is not TOML ({error}); mend that line") from error
    except msgspec.ValidationError as error:
        raise BadInput(f"{path}: {error}; mend that key") from error


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


def joining_its_group(device: Path) -> str:
    """What to do where `may_open` says no: the command, with the name of the group that the device belongs to."""
    number = device.stat().st_gid
    try:
        name = grp.getgrgid(number).gr_name
    except KeyError:  # in containers groups often have no name
        name = str(number)
    return f"sudo usermod -aG {name} $USER, then log in again; for a container group_add {number}"
