"""Files of maps, `maps_NNNNNN`: the frames of one chunk as float32, without loss, for the process that makes lights of them.

MAGIC, then a record and, for each frame, a record and the arrays' bytes. A record is the length of its msgpack and a CRC-32 (both <u4),
then the msgpack. A frame's CRC covers its arrays too. Little-endian; whoever reads them allocates no more than the file holds.
"""

import struct
import zlib
from collections.abc import Iterable, Iterator
from typing import Annotated, Any, BinaryIO, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.capture.frames import Frame
from vemlight.light.bright_cells import BrightCells
from vemlight.light.sphere import Coverage

MAGIC = b"vemlight.maps/1\n"
HEAD = struct.Struct("<II")
MAX_RECORD_BYTES = 1024  # they have 30 to 150
MAX_SIDE = 8192  # cells of a map, as on the wire
MAX_SAMPLES = 4096  # of bright cells, as on the wire
Side = Annotated[int, Meta(ge=1, le=MAX_SIDE)]
Record = TypeVar("Record")


class ChunkHeader(msgspec.Struct, array_like=True, frozen=True):
    """What the maps were made of. plan: of the archive. files: digest of the files that these frames were read from."""

    plan: str
    chunk: int
    frames: Annotated[int, Meta(ge=1)]
    files: str
    coverage: Coverage


class _FrameHeader(msgspec.Struct, array_like=True, frozen=True):
    time_s: float
    clipped: bool
    rows: Side
    cols: Side
    samples: Annotated[int, Meta(ge=0, le=MAX_SAMPLES)]
    estimated_lux: float = 0.0


def write_maps(file: BinaryIO, header: ChunkHeader, frames: Iterable[Frame]) -> None:
    """Writes a chunk, a frame at a time. Raises OSError when the disk refuses."""
    file.write(MAGIC)
    _write_record(file, header, ())
    for frame in frames:
        rows, cols, _ = frame.radiance.shape
        cells, directions, weights = frame.bright_cells
        arrays = [
            np.ascontiguousarray(frame.radiance, "<f4"), np.ascontiguousarray(cells, "<i8"), np.ascontiguousarray(directions, "<f4"),
            np.ascontiguousarray(weights, "<f4"),
        ]  # fmt: skip
        _write_record(file, _FrameHeader(frame.time_s, frame.clipped, rows, cols, len(cells), frame.estimated_lux), arrays)


def _write_record(file: BinaryIO, record: msgspec.Struct, arrays: Iterable[np.ndarray]) -> None:
    content, parts = msgspec.msgpack.encode(record), [array.reshape(-1).view(np.uint8).data for array in arrays]
    check = zlib.crc32(content)
    for part in parts:
        check = zlib.crc32(part, check)
    file.write(HEAD.pack(len(content), check) + content)
    for part in parts:
        file.write(part)


class MapReader:
    """The frames of a file of maps. `header`: what they were made of."""

    def __init__(self, file: BinaryIO) -> None:
        """file: it can seek, and stays open. Raises ValueError for what is no file of maps."""
        self._file = file
        self._left = file.seek(0, 2)
        file.seek(0)
        if self._bytes(len(MAGIC)) != MAGIC:
            raise ValueError("is no file of maps")
        self.header, content, check = self._record(ChunkHeader)
        if zlib.crc32(content) != check:
            raise ValueError("is damaged")

    def frames(self) -> Iterator[Frame]:
        """All frames, in order, as their arrays were. Raises ValueError for damage, and where frames are missing or too many."""
        for _ in range(self.header.frames):
            head, content, check = self._record(_FrameHeader)
            cells = head.rows * head.cols
            shapes = (((head.rows, head.cols, 3), "<f4"), ((head.samples,), "<i8"), ((head.samples, 3), "<f4"), ((head.samples,), "<f4"))
            if 12 * cells + 24 * head.samples > self._left:
                raise ValueError("ends too early")
            arrays, found = [], zlib.crc32(content)
            for shape, dtype in shapes:
                array = np.empty(shape, dtype)
                flat = array.reshape(-1).view(np.uint8).data
                if self._file.readinto(flat) != array.nbytes:  # type: ignore[attr-defined]
                    raise ValueError("ends too early")
                self._left -= array.nbytes
                found = zlib.crc32(flat, found)
                arrays.append(array)
            if found != check:
                raise ValueError("is damaged")
            radiance, *bright = arrays
            if not ((bright[0] >= 0) & (bright[0] < cells)).all():
                raise ValueError("has a bright cell outside its map")
            frame = Frame(radiance, self.header.coverage, head.time_s, None, 0, 0, BrightCells(*bright))
            yield frame._replace(clipped=head.clipped, estimated_lux=head.estimated_lux)
        if self._left:
            raise ValueError("goes on after its last frame")

    def _record(self, kind: type[Record]) -> tuple[Record, bytes, int]:
        """A record, its bytes, and the CRC that is stated."""
        length, check = HEAD.unpack(self._bytes(HEAD.size))
        if length > MAX_RECORD_BYTES:
            raise ValueError("is damaged")
        content = self._bytes(length)
        return _decoded(content, kind), content, check

    def _bytes(self, count: int) -> bytes:
        data = self._file.read(count)
        if len(data) != count:
            raise ValueError("ends too early")
        self._left -= count
        return data


def _decoded(content: bytes, kind: Any) -> Any:
    try:
        return msgspec.msgpack.decode(content, type=kind)
    except (ValueError, RecursionError, OverflowError, MemoryError) as error:  # msgspec's own are ValueErrors
        raise ValueError("is damaged") from error
