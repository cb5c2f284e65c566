"""Recorded sequences on disk."""

from pathlib import Path

import msgspec
import pytest

from vemlight.capture.manifest import MANIFEST, check_digest, manifest_entry, read_manifest
from vemlight.capture.sequence import frame_files
from vemlight.errors import UserError


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).write_bytes(name.encode())


def test_numbered_frames_come_by_number(tmp_path: Path) -> None:
    touch(tmp_path, "f9.exr", "f10.exr", "f11.exr", "lens.toml")
    assert [file.path.name for file in frame_files(tmp_path)] == ["f9.exr", "f10.exr", "f11.exr"]


@pytest.mark.parametrize(
    "names", [("a_7.hdr", "b_1.hdr", "park.hdr"), ("a_1.hdr", "b_1.hdr"), ("a1_1.hdr", "a2_2.hdr"), ("a_1 (1).hdr", "a_1.hdr")]
)
def test_other_names_come_by_name_with_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], names: tuple[str, ...]) -> None:
    touch(tmp_path, *names[::-1])
    assert [file.path.name for file in frame_files(tmp_path)] == list(names)
    assert f"its {len(names)} frames come in the order of the names" in capsys.readouterr().err


def test_the_number_may_stand_anywhere_in_the_name(tmp_path: Path) -> None:
    touch(tmp_path, "cam2_v1.9_L.exr", "cam2_v1.10_L.exr", "cam2_v1.11_L.exr")
    assert [file.path.name[8:] for file in frame_files(tmp_path)] == ["9_L.exr", "10_L.exr", "11_L.exr"]


def test_a_frame_of_two_kinds_is_refused(tmp_path: Path) -> None:
    touch(tmp_path, "f_1.exr", "f_2.exr", "f_2.hdr")
    with pytest.raises(UserError, match=r"holds f_2 more than once \(\.exr, \.hdr\)"):
        frame_files(tmp_path)


def test_half_written_frames_are_left_out(tmp_path: Path) -> None:
    touch(tmp_path, "f1.exr", "f2.part.exr")
    assert [file.path.name for file in frame_files(tmp_path)] == ["f1.exr"]


def test_what_macos_writes_beside_files_is_left_out(tmp_path: Path) -> None:
    touch(tmp_path, "f1.exr", "f2.exr", "._f1.exr", "._f2.exr", ".DS_Store")
    assert [file.path.name for file in frame_files(tmp_path)] == ["f1.exr", "f2.exr"]


@pytest.mark.parametrize(("numbers", "offsets", "words"), [
    ((7, 8, 10), [0, 1, 3], "1 frame is missing after f_0008.exr"),
    ((7, 8, 12, 13), [0, 1, 5, 6], "3 frames are missing, the first of them after f_0008.exr"),
    ((2, 4, 6), [0, 1, 2], "its numbers go up by 2; its 3 frames follow each other"),
    ((100, 110, 130), [0, 1, 3], "1 frame is missing after f_0110.exr"),
    ((5,), [0], ""),
])  # fmt: skip
def test_missing_numbers_leave_a_gap_in_time_and_are_counted(tmp_path: Path, capsys, numbers, offsets, words) -> None:
    touch(tmp_path, *(f"f_{number:04d}.exr" for number in numbers))
    assert [file.offset for file in frame_files(tmp_path)] == offsets
    said = capsys.readouterr().err
    assert words in said if words else said == ""


def test_empty_folder_is_refused(tmp_path: Path) -> None:
    touch(tmp_path, "notes.txt")
    with pytest.raises(UserError, match="holds no"):
        frame_files(tmp_path)


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
