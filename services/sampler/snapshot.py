"""The sampler's state on disk, so that a sampler that was killed goes on from a frame nearby instead of from the first.

The file holds the newest two, because the renderer may still want a frame before the newest. It is msgpack with a digest in front; an array
is its type, shape and bytes. What is damaged or of another version counts as absent: the lights are then made from the first frame on.
"""

import hashlib
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.files import written_whole
from vemlight.journal import JOURNAL_START, JournalPoint
from vemlight.sampler.state import SamplerState

SNAPSHOT_FRAMES = 16  # between two: more than a renderer is behind (4 requested frames); a restart repeats 15 to 31 steps at most
DIGEST_BYTES = 32
Value = TypeVar("Value")
DTYPES = ("<f4", "<f8", "<i4", "<i8", "|u1", "|b1")


class Snapshot(NamedTuple):
    """The state after the frames that the lights' file holds up to `end`."""

    end: JournalPoint
    state: SamplerState

    @property
    def frames(self) -> int:
        return self.end.lines


class Snapshots:
    """The newest two snapshots, in a file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._newest = decoded(path.read_bytes(), tuple[Snapshot, ...])
        except (OSError, ValueError):
            self._newest = ()

    @property
    def newest_end(self) -> JournalPoint:
        """Up to where the lights were whole when the newest was made."""
        return self._newest[-1].end if self._newest else JOURNAL_START

    def before(self, target: int) -> Snapshot | None:
        """The newest from which frame `target` can be made."""
        return next((snapshot for snapshot in reversed(self._newest) if snapshot.frames <= target), None)

    def add(self, snapshot: Snapshot) -> None:
        """Replaces the older one. Raises OSError when the disk refuses."""
        self._newest = (*(kept for kept in self._newest[-1:] if kept.frames < snapshot.frames), snapshot)
        with written_whole(self._path) as part:
            part.write_bytes(encoded(self._newest))


def encoded(value: Any) -> bytes:
    """The bytes of a value of msgspec's types that holds the sampler's state, or several of them."""
    content = msgspec.msgpack.encode(value, enc_hook=_header_from_array)
    return hashlib.sha256(content).digest() + content


def decoded(data: bytes, kind: type[Value]) -> Value:
    """A value of the type `kind`. Raises ValueError for anything that `encoded` has not made of one."""
    digest, content = data[:DIGEST_BYTES], data[DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        raise ValueError("the snapshot is damaged")
    try:
        return msgspec.msgpack.decode(content, type=kind, dec_hook=_array_from_header)
    except (RecursionError, OverflowError, MemoryError) as error:
        raise ValueError(str(error)) from error


class _ArrayHeader(msgspec.Struct, array_like=True):
    dtype: str
    shape: tuple[Annotated[int, Meta(ge=0)], ...]
    data: bytes


def _header_from_array(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        raise NotImplementedError(f"a {type(value).__name__} in the sampler's state")
    return _ArrayHeader(value.dtype.str, value.shape, value.tobytes())


def _array_from_header(kind: type, value: Any) -> Any:
    if kind is not np.ndarray:
        raise NotImplementedError(f"a {kind.__name__} in the sampler's state")
    header = msgspec.convert(value, _ArrayHeader)
    if header.dtype not in DTYPES:
        raise ValueError(f"an array of {header.dtype}")
    return np.frombuffer(header.data, header.dtype).reshape(header.shape).copy()  # a copy can be written to, as the original
