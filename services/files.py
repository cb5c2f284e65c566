"""Files in and out: TOML into typed records, writing that never leaves half a file, devices that may be opened."""

import errno
import grp
import hashlib
import os
import re
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from io import BufferedReader
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from vemlight.errors import UserError, printable_line
from vemlight.toml import record_from_toml

MAX_TOML_BYTES = 2**20  # a scene of 1,000 meshes has 0.2 MB
ADDRESS = re.compile(r"\s*[A-Za-z][A-Za-z0-9+.-]+:", re.ASCII)  # http:, file: and all others of two letters or more (RFC 3986)
MAX_SHOWN = 200  # characters of a reference in an error's line

Record = TypeVar("Record")


def read_file(path: Path, max_bytes: int) -> bytes:
    """The content of a regular file. Raises UserError for one that is missing, longer than `max_bytes`, or a device, pipe or folder."""
    with _named_faults(path):
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # opening a pipe that nobody writes to would wait for ever
        try:
            _check_regular(path, os.fstat(file), max_bytes)
            with open(file, "rb", closefd=False) as opened:
                return opened.read(max_bytes)
        finally:
            os.close(file)


def check_regular(path: Path, max_bytes: int) -> None:
    """Raises UserError as `read_file`, for a file that a library opens by its name."""
    with _named_faults(path):
        _check_regular(path, os.stat(path), max_bytes)


@contextmanager
def _named_faults(path: Path) -> Iterator[None]:
    """Makes a UserError that names the file of what the system says about it."""
    try:
        yield
    except UserError:
        raise
    except FileNotFoundError as error:
        raise UserError(f"{path}: there is no such file; check the path") from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except ValueError as error:  # a NUL, or half a character
        raise UserError(f"{path}: is no name of a file ({one_line(error)}); correct it") from error


def _check_regular(path: Path, status: os.stat_result, max_bytes: int) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise UserError(f"{path}: is a folder; name a file")
    if not stat.S_ISREG(status.st_mode):
        raise UserError(f"{path}: is not a regular file; name one")
    if status.st_size > max_bytes:
        raise UserError(f"{path}: has {status.st_size} bytes, at most {max_bytes} are read; is it the right file?")


def contained_path(folder: Path, reference: str, where: str) -> Path:
    """Where the file lies that a file in `folder` refers to: in that folder or in one inside it.

    Whoever wrote a downloaded scene or mesh must not choose what else on this machine is read. Raises UserError that begins with `where`
    for an address, an absolute path, and one that leads out of the folder by `..` or by a link. Whether there is such a file is not asked.
    """
    shown = f"{where}: {reference[:MAX_SHOWN]}"
    if ADDRESS.match(reference):
        raise UserError(f"{shown} is an address, and none is opened; put the file beside the one that names it, and name it from there")
    way_out = "put the file in the folder of the one that names it, and name it from there"
    if os.path.isabs(reference) or ".." in Path(reference).parts:
        raise UserError(f"{shown} leads out of its folder; {way_out}")
    try:
        inside = Path(os.path.realpath(folder / reference)).is_relative_to(os.path.realpath(folder))
    except (ValueError, OSError) as error:  # a NUL, half a character, a name that is too long
        raise UserError(f"{shown} is no name of a file; correct it") from error
    if not inside:
        raise UserError(f"{shown} is a link out of its folder; {way_out}")
    return folder / reference


def read_toml(path: Path, kind: type[Record]) -> Record:
    """The TOML file at `path` as a record of `kind` (a msgspec Struct). A byte order mark is passed over.

    Raises UserError naming the file, the line and the key when the file is missing, is not TOML or does not fit the record.
    """
    return record_from_toml(path, read_file(path, MAX_TOML_BYTES), kind)


def decoded_json(content: bytes | str, kind: Any) -> Any:
    """A value of the type `kind` from JSON. Raises ValueError for anything else, too deep a nesting and too large numbers included."""
    try:
        return msgspec.json.decode(content, type=kind)
    except (RecursionError, OverflowError, MemoryError) as error:
        raise ValueError(str(error)) from error


def checked_utf8(values: Any, where: str) -> bytes:
    """The values as JSON. Raises UserError for a text in it that is not UTF-8, as a file's name may be, which `where` cannot hold."""
    try:
        return msgspec.json.encode(values)
    except UnicodeEncodeError as error:
        shown = ascii(error.object)[1:-1]
        raise UserError(f"{shown}: is not UTF-8, and {where} holds nothing else; rename it, or go by a link") from error


def write_toml(path: Path, record: msgspec.Struct) -> None:
    """Writes a record as the TOML file that `read_toml` reads back to the same values, numpy's numbers included.

    Raises OSError when the disk refuses.
    """
    with written_whole(path) as part:
        part.write_bytes(msgspec.toml.encode(record, enc_hook=float))


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yields NAME.part to write to; afterwards it is flushed to the disk and renamed to `path`, which a power failure does not undo.

    When the body raises, the part is removed and `path` is untouched. The part keeps the suffix of `path` for libraries
    that choose a format by it. An OSError about the part names `path`, because nobody else knows of the part.
    """
    part = path.with_name(f"{path.stem}.part{path.suffix}")
    try:
        yield part
        with open(part, "rb") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        if error.errno is None or error.strerror is None:
            raise OSError(str(error).replace(part.name, path.name)) from error
        if error.filename is not None and os.fsdecode(error.filename) != str(part):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        part.unlink(missing_ok=True)
    fsync_folder(path.parent)


def fsync_folder(folder: Path) -> None:
    """Flushes a folder's list of files to the disk: only then new and renamed files survive a power failure.

    Does nothing where the folder may not be read or its file system cannot do that. Raises OSError when the disk refuses.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except PermissionError:
        return
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(descriptor)


def open_regular(path: Path) -> BufferedReader:
    """A regular file, open to be read. Raises OSError for one that cannot be, and for a device, pipe or folder."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe that nobody writes to would be waited for
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "is not a regular file", str(path))
    return open(descriptor, "rb")


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file's content in hexadecimal digits. Raises OSError when it cannot be read."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def writing_to(path: Path) -> Iterator[None]:
    """Names `path` in an OSError that names no file, as a full disk's does not."""
    try:
        yield
    except OSError as error:
        if error.filename is not None or error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


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
_kept: ContextVar[list[str] | None] = ContextVar("kept", default=None)


@contextmanager
def kept_notices() -> Iterator[list[str]]:
    """Yields a list of the notices that its body gives in this thread, which are not printed: for a worker, whose caller passes them on."""
    kept: list[str] = []
    before = _kept.set(kept)
    try:
        yield kept
    finally:
        _kept.reset(before)


def notice(text: str) -> None:
    """One line on stderr for what the user should know of an input that can be used; the same text only once."""
    kept = _kept.get()
    if kept is not None:
        kept.append(text)
    elif text not in _noticed:
        _noticed.add(text)
        print(f"vemlight: {printable_line(text)}", file=sys.stderr, flush=True)


def one_line(error: BaseException) -> str:
    """The message of an error of a library, on one line and at most 200 characters long."""
    return " ".join(str(error).split())[:200]
