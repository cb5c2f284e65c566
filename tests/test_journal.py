"""Files of chained lines: what crashes, full disks and changed bytes do to them."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from vemlight import journal as module
from vemlight.errors import UserError
from vemlight.files import fsync_folder
from vemlight.journal import JOURNAL_START, Journal, checked_lines

CONTENTS = [b'{"number":%d}' % k for k in range(20)]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    journal = Journal(tmp_path / "lines.jsonl")
    for content in CONTENTS:
        journal.append(content)
    journal.close()
    return tmp_path / "lines.jsonl"


def whole_lines(path: Path) -> list[bytes]:
    with open(path, "rb") as file:
        return [content for content, _ in checked_lines(file)]


def reopened(path: Path, can_be_made_again: bool = True) -> Journal:
    """The journal as its owner opens it: all that is whole is kept."""
    journal = Journal(path)
    journal.keep(([JOURNAL_START] + [point for _, point in journal.lines()])[-1], can_be_made_again)
    return journal


def test_what_was_appended_is_read(path):
    assert whole_lines(path) == CONTENTS


def test_every_flipped_bit_is_found(path):
    data, rng = path.read_bytes(), np.random.default_rng(4)
    ends = np.cumsum([len(line) for line in data.splitlines(keepends=True)])
    for bit in rng.choice(8 * len(data), 400, replace=False):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        path.write_bytes(changed)
        assert whole_lines(path) == CONTENTS[: np.searchsorted(ends, bit // 8, side="right")]


@pytest.mark.parametrize("change", ["removed", "repeated", "exchanged"])
def test_lines_in_another_order_are_found(path, change):
    lines = path.read_bytes().splitlines(keepends=True)
    lines[7:9] = {"removed": [lines[8]], "repeated": [lines[7], lines[7], lines[8]], "exchanged": [lines[8], lines[7]]}[change]
    path.write_bytes(b"".join(lines))
    assert len(whole_lines(path)) == {"removed": 7, "repeated": 8, "exchanged": 7}[change]


@pytest.mark.parametrize("rest", [b'{"number":20,"ch', b"\0" * 4096, b"\0" * 70 + b'"}\n', b"{}\n"])
def test_what_a_crash_left_is_removed_and_the_file_goes_on(path, rest):
    whole = path.read_bytes()
    path.write_bytes(whole + rest)
    journal = reopened(path, can_be_made_again=False)
    assert path.read_bytes() == whole
    journal.append(b'{"number":20}')
    assert whole_lines(path) == [*CONTENTS, b'{"number":20}']


def test_damage_in_the_middle_is_removed_only_where_it_can_be_made_again(path):
    damaged = path.read_bytes().replace(b'"number":12', b'"number":13')
    path.write_bytes(damaged)
    with pytest.raises(UserError, match="line 13 is damaged and 7 follow"):
        reopened(path, can_be_made_again=False)
    assert path.read_bytes() == damaged
    assert reopened(path).end.lines == 12
    assert whole_lines(path) == CONTENTS[:12]


@pytest.mark.parametrize("content", [b"notes\n", b'{"schema":"vemlight.lights/1"}\n', b"\0\0\nmine\n"])
def test_a_file_that_is_no_journal_stays_as_it_is(path, content):
    path.write_bytes(content)
    with pytest.raises(UserError, match="was not written by a run"):
        reopened(path)
    assert path.read_bytes() == content


def test_a_file_of_nul_alone_is_what_a_crash_left(path):
    path.write_bytes(bytes(5000))
    assert reopened(path, can_be_made_again=False).end == JOURNAL_START
    assert path.read_bytes() == b""


@pytest.mark.parametrize("written", [0, 30], ids=["nothing", "half a line"])
def test_a_line_that_the_disk_refuses_leaves_the_file_as_it_was(path, monkeypatch, written):
    journal, whole, pwrite = reopened(path), path.read_bytes(), os.pwrite

    def full(descriptor: int, data: bytes, offset: int) -> int:
        if offset == len(whole) and written:
            return pwrite(descriptor, data[:written], offset)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(module.os, "pwrite", full)
    with pytest.raises(OSError, match="No space"):
        journal.append(b'{"number":20}')
    assert path.read_bytes() == whole
    monkeypatch.setattr(module.os, "pwrite", pwrite)
    journal.append(b'{"number":20}')
    assert len(whole_lines(path)) == 21


def test_a_line_is_on_the_disk_before_the_next_thing_happens(path, monkeypatch):
    journal, flushed = reopened(path), []
    monkeypatch.setattr(module.os, "fsync", lambda descriptor: flushed.append(os.fstat(descriptor).st_size))
    journal.append(b'{"number":20}')
    assert flushed == [path.stat().st_size]


def test_a_file_is_open_in_one_process_alone(path):
    journal = Journal(path)
    with pytest.raises(UserError, match="another run writes there"):
        Journal(path)
    journal.close()
    Journal(path).close()


def test_a_file_system_without_locks_is_written_to(path, monkeypatch):
    def without(*_) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(module.fcntl, "flock", without)
    reopened(path).append(b'{"number":20}')
    assert len(whole_lines(path)) == 21


@pytest.mark.parametrize("number", [errno.EINVAL, errno.ENOTSUP])
def test_a_file_system_that_cannot_flush_folders_is_written_to(tmp_path, monkeypatch, number):
    def refused(descriptor: int) -> None:
        raise OSError(number, "refused")

    with monkeypatch.context() as patch:
        patch.setattr("vemlight.files.os.fsync", refused)
        fsync_folder(tmp_path)
        number = errno.EIO
        with pytest.raises(OSError, match="refused"):
            fsync_folder(tmp_path)


def test_only_what_follows_a_point_is_read(path):
    journal = Journal(path)
    points = [point for _, point in journal.lines()]
    path.write_bytes(path.read_bytes().replace(b'"number":3', b'"number":4'))
    assert journal.holds(points[9])
    assert [content for content, _ in journal.lines(points[9])] == CONTENTS[10:]
    assert not journal.holds(points[9]._replace(chain=points[8].chain))
    assert not journal.holds(points[9]._replace(offset=10**6))
