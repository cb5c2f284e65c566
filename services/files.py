"""Files in and out: TOML into typed records, writing that never leaves half a file, devices that may be opened."""

import codecs
import grp
import os
import re
import stat
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from vemlight.errors import UserError, printable_line

MAX_TOML_BYTES = 2**20  # a scene of 1,000 meshes has 0.2 MB
MAX_KEY_DOTS = 32  # the deepest key of ours has three parts; tomllib takes the square of their number, 8 s at 10^5
MANY_DOTS = re.compile(rb"(?:\.[ \t]*[\w\"'-]+[ \t]*){%d}" % MAX_KEY_DOTS)

Record = TypeVar("Record")


def read_file(path: Path, max_bytes: int) -> bytes:
    """The content of a regular file. Raises UserError for one that is missing, longer than `max_bytes`, or a device, pipe or folder."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # opening a pipe that nobody writes to would wait for ever
        try:
            status = os.fstat(file)
            if not stat.S_ISREG(status.st_mode):
                raise UserError(f"{path}: is not a regular file; name one")
            if status.st_size > max_bytes:
                raise UserError(f"{path}: has {status.st_size} bytes, at most {max_bytes} are read; is it the right file?")
            with open(file, "rb", closefd=False) as opened:
                return opened.read(max_bytes)
        finally:
            os.close(file)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error


def read_toml(path: Path, kind: type[Record]) -> Record:
    """The TOML file at `path` as a record of `kind` (a msgspec Struct). A byte order mark is passed over.

    Raises UserError naming the file and the key when the file is missing, is not TOML or does not fit the record.
    """
    content = read_file(path, MAX_TOML_BYTES).removeprefix(codecs.BOM_UTF8)
    if MANY_DOTS.search(content):
        raise UserError(f"{path}: has a key of more than {MAX_KEY_DOTS} parts; name a settings or scene file")
    try:
        return msgspec.convert(tomllib.loads(content.decode()), kind)
    except msgspec.ValidationError as error:
        raise UserError(f"{path}: {error}; correct that key") from error
    except RecursionError as error:
        raise UserError(f"{path}: is nested too deeply; name a settings or scene file") from error
    except ValueError as error:  # TOMLDecodeError, UnicodeDecodeError, and a number of thousands of digits
        raise UserError(f"{path}: is not TOML ({one_line(error)}); correct that line") from error


def decoded_json(content: bytes | str, kind: Any) -> Any:
    """A value of the type `kind` from JSON. Raises ValueError for anything else, too deep a nesting and too large numbers included."""
    try:
        return msgspec.json.decode(content, type=kind)
    except (RecursionError, OverflowError, MemoryError) as error:
        raise ValueError(str(error)) from error


def write_toml(path: Path, record: msgspec.Struct) -> None:
    """Writes a record as the TOML file that `read_toml` reads back to the same values, numpy's numbers included.

    Raises OSError when the disk refuses.
    """
    with written_whole(path) as part:
        part.write_bytes(msgspec.toml.encode(record, enc_hook=float))


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


_noticed: set[str] = set()


def notice(text: str) -> None:
    """One line on stderr for what the user should know of an input that can be used; the same text only once."""
    if text not in _noticed:
        _noticed.add(text)
        print(f"vemlight: {printable_line(text)}", file=sys.stderr, flush=True)


def one_line(error: BaseException) -> str:
    """The message of an error of a library, on one line and at most 200 characters long."""
    return " ".join(str(error).split())[:200]
