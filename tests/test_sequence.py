"""Recorded sequences on disk."""

from pathlib import Path

import msgspec
import pytest

from vemlight.capture.sequence import MANIFEST, check_digest, frame_paths, manifest_entry, read_manifest
from vemlight.errors import UserError


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).write_bytes(name.encode())


def test_numbered_frames_come_by_number(tmp_path: Path) -> None:
    touch(tmp_path, "f9.exr", "f10.exr", "f11.exr", "lens.toml")
    assert [p.name for p in frame_paths(tmp_path)] == ["f9.exr", "f10.exr", "f11.exr"]


def test_other_names_come_by_name(tmp_path: Path) -> None:
    touch(tmp_path, "b_1.hdr", "a_7.hdr", "park.hdr")
    assert [p.name for p in frame_paths(tmp_path)] == ["a_7.hdr", "b_1.hdr", "park.hdr"]


def test_half_written_frames_are_left_out(tmp_path: Path) -> None:
    touch(tmp_path, "f1.exr", "f2.part.exr")
    assert [p.name for p in frame_paths(tmp_path)] == ["f1.exr"]


def test_gap_names_the_missing_number(tmp_path: Path) -> None:
    touch(tmp_path, "f_0007.exr", "f_0008.exr", "f_0010.exr")
    with pytest.raises(UserError, match=r"frame 0009 is missing after f_0008.exr"):
        frame_paths(tmp_path)


def test_empty_folder_is_refused(tmp_path: Path) -> None:
    touch(tmp_path, "notes.txt")
    with pytest.raises(UserError, match="holds no"):
        frame_paths(tmp_path)


def write_manifest(folder: Path, *names: str) -> None:
    lines = [msgspec.json.encode(manifest_entry(folder / name, k, k / 4)) for k, name in enumerate(names)]
    (folder / MANIFEST).write_bytes(b"\n".join(lines))


def test_manifest_lists_the_frames(tmp_path: Path) -> None:
    touch(tmp_path, "a.exr", "b.exr", "stale.exr")
    write_manifest(tmp_path, "a.exr", "b.exr")
    entries = read_manifest(tmp_path)
    assert [(e.name, e.sequence, e.time_s) for e in entries] == [("a.exr", 0, 0.0), ("b.exr", 1, 0.25)]
    check_digest(tmp_path / "a.exr", entries[0].sha256)


@pytest.mark.parametrize("written", [0, 1, 40])
def test_a_last_line_cut_short_costs_no_frame_before_it(tmp_path: Path, written: int) -> None:
    touch(tmp_path, "a.exr", "b.exr")
    write_manifest(tmp_path, "a.exr", "b.exr")
    first, second = (tmp_path / MANIFEST).read_bytes().split(b"\n")
    (tmp_path / MANIFEST).write_bytes(first + b"\n" + second[:written])
    assert [entry.name for entry in read_manifest(tmp_path)] == ["a.exr"]


@pytest.mark.parametrize("number", [1, 2])
def test_an_invalid_line_that_was_completed_is_damage(tmp_path: Path, number: int) -> None:
    touch(tmp_path, "a.exr", "b.exr")
    write_manifest(tmp_path, "a.exr", "b.exr")
    lines = (tmp_path / MANIFEST).read_bytes().split(b"\n")
    lines[number - 1] = lines[number - 1][:40]
    (tmp_path / MANIFEST).write_bytes(b"\n".join(lines) + b"\n")
    with pytest.raises(UserError, match=f"line {number}"):
        read_manifest(tmp_path)


def test_one_flipped_bit_is_noticed(tmp_path: Path) -> None:
    touch(tmp_path, "a.exr")
    write_manifest(tmp_path, "a.exr")
    entry = read_manifest(tmp_path)[0]
    (tmp_path / "a.exr").write_bytes(b"`.exr")
    with pytest.raises(UserError, match=r"a\.exr: is not what was recorded"):
        check_digest(tmp_path / "a.exr", entry.sha256)


def test_frame_that_is_gone_is_named(tmp_path: Path) -> None:
    touch(tmp_path, "a.exr", "b.exr")
    write_manifest(tmp_path, "a.exr", "b.exr")
    (tmp_path / "b.exr").unlink()
    with pytest.raises(UserError, match=r"b\.exr is missing"):
        read_manifest(tmp_path)


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"{",
        b"\xff",
        b'{"name": "../a.exr", "sequence": 0, "time_s": 0.0, "sha256": "' + b"0" * 64 + b'"}',
        b'{"name": "a.exr", "sequence": -1, "time_s": 0.0, "sha256": "' + b"0" * 64 + b'"}',
        b'{"name": "a.exr", "sequence": 0, "time_s": 0.0, "sha256": "0"}',
    ],
)
def test_hostile_manifest_is_one_error(tmp_path: Path, line: bytes) -> None:
    touch(tmp_path, "a.exr")
    (tmp_path / MANIFEST).write_bytes(line)
    with pytest.raises(UserError, match=MANIFEST):
        read_manifest(tmp_path)
