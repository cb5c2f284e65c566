"""Files of maps: what is read is what was written, and what is damaged is refused before memory is taken for it."""

import io
import zlib
from collections.abc import Iterable

import msgspec
import numpy as np
import pytest

from vemlight.capture.frames import Frame
from vemlight.commands.archive.map_file import HEAD, MAGIC, ChunkHeader, MapReader, write_maps
from vemlight.light.bright_cells import NO_BRIGHT_CELLS, BrightCells

BRIGHT = BrightCells(np.array([3, 7]), np.array([[0, 0, 1], [0, 1, 0]], np.float32), np.array([0.5, 1], np.float32))


def frame(k: int, bright: BrightCells = BRIGHT) -> Frame:
    radiance = np.random.default_rng(k).random((4, 8, 3), np.float32)
    radiance[0, 0] = np.nan, np.inf, -1
    return Frame(radiance, "hemisphere", k / 25, 100.0, 3, 4, bright, clipped=k == 1)


def written(frames: Iterable[Frame], count: int) -> bytes:
    file = io.BytesIO()
    write_maps(file, ChunkHeader("p" * 64, 5, count, "f" * 64, "hemisphere"), frames)
    return file.getvalue()


GOOD = written([frame(0), frame(1), frame(2, NO_BRIGHT_CELLS)], 3)


def read(data: bytes) -> list[Frame]:
    return list(MapReader(io.BytesIO(data)).frames())


def test_frames_come_back_to_the_bit():
    assert MapReader(io.BytesIO(GOOD)).header == ChunkHeader("p" * 64, 5, 3, "f" * 64, "hemisphere")
    for k, found in enumerate(read(GOOD)):
        given = frame(k) if k < 2 else frame(2, NO_BRIGHT_CELLS)
        assert found.radiance.tobytes() == given.radiance.tobytes()
        assert [a.tobytes() for a in found.bright_cells] == [a.tobytes() for a in given.bright_cells]
        assert (found.time_s, found.clipped, found.coverage) == (given.time_s, given.clipped, given.coverage)
        assert found.radiance.flags.writeable  # as a source's own


def test_any_changed_byte_is_found():
    rng = np.random.default_rng(1)
    for at in rng.choice(len(GOOD), 300, replace=False):
        damaged = bytearray(GOOD)
        damaged[at] ^= 1 << rng.integers(8)
        with pytest.raises(ValueError, match=r"is damaged|ends too early|is no file of maps"):
            read(bytes(damaged))


def test_a_file_that_is_cut_or_goes_on_is_refused():
    for end in range(0, len(GOOD), 37):
        with pytest.raises(ValueError, match=r"ends too early|is no file of maps"):
            read(GOOD[:end])
    with pytest.raises(ValueError, match="goes on after its last frame"):
        read(GOOD + b"x")


def forged(rows: int, cols: int, samples: int, arrays: bytes = b"") -> bytes:
    """A file with right checksums for whatever it claims."""

    def record(content: list, behind: bytes = b"") -> bytes:
        packed = msgspec.msgpack.encode(content)
        return HEAD.pack(len(packed), zlib.crc32(behind, zlib.crc32(packed))) + packed + behind

    return MAGIC + record(["p", 0, 1, "f", "hemisphere"]) + record([0.0, False, rows, cols, samples], arrays)


@pytest.mark.parametrize(("rows", "cols", "samples"), [(8192, 8192, 0), (1, 1, 4096)])
def test_no_memory_is_taken_for_what_the_file_does_not_hold(rows, cols, samples, monkeypatch):
    monkeypatch.setattr(np, "empty", lambda *_: pytest.fail("memory was taken"))
    with pytest.raises(ValueError, match="ends too early"):
        read(forged(rows, cols, samples, bytes(12)))


@pytest.mark.parametrize(("rows", "cols", "samples"), [(0, 1, 0), (8193, 1, 0), (1, 10**12, 0), (1, 1, 4097), (1, 1, -1)])
def test_sizes_beyond_the_limits_are_refused(rows, cols, samples):
    with pytest.raises(ValueError, match="is damaged"):
        read(forged(rows, cols, samples))


def test_a_bright_cell_outside_its_map_is_refused():
    for cell in (-1, 2):
        arrays = np.ones((1, 2, 3), "<f4").tobytes() + np.array([cell], "<i8").tobytes() + np.ones(4, "<f4").tobytes()
        with pytest.raises(ValueError, match="a bright cell outside its map"):
            read(forged(1, 2, 1, arrays))
