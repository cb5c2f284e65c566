"""Files: TOML into records, and never half a file."""

import errno
import os
from pathlib import Path

import msgspec
import pytest

from vemlight.errors import UserError
from vemlight.files import contained_path, decoded_json, read_file, read_toml, writing_to, written_whole


class Thing(msgspec.Struct, forbid_unknown_fields=True):
    size: int = 1


def test_a_record_is_read(tmp_path):
    (tmp_path / "t.toml").write_text("size = 3")
    assert read_toml(tmp_path / "t.toml", Thing) == Thing(3)


def test_a_byte_order_mark_is_passed_over(tmp_path):
    (tmp_path / "t.toml").write_bytes(b"\xef\xbb\xbfsize = 3")
    assert read_toml(tmp_path / "t.toml", Thing) == Thing(3)


HOSTILE = [
    b"size = " + b"[" * 100_000,
    b"size = " + b"{a=" * 100_000,
    b"a" + b".a" * 100_000 + b" = 1",
    b"[a" + b" . a" * 100_000 + b"]",
    b"size = " + b"9" * 10**5,
]


@pytest.mark.parametrize("content", [b"size = ", b"size = 'a'", b"wide = 1", b"\xff\xfe", b"\x00", *HOSTILE, b" " * (2**20 + 1)])
def test_what_is_no_record_is_one_line_with_the_files_name(tmp_path, content):
    (tmp_path / "t.toml").write_bytes(content)
    with pytest.raises(UserError, match=r"t\.toml") as caught:
        read_toml(tmp_path / "t.toml", Thing)
    assert len(str(caught.value).splitlines()) == 1


def test_a_file_of_the_greatest_length_is_read(tmp_path):
    (tmp_path / "t.toml").write_bytes(b"size = 3\n".ljust(2**20))
    assert read_toml(tmp_path / "t.toml", Thing) == Thing(3)


def test_files_that_are_not_there(tmp_path):
    with pytest.raises(UserError, match="there is no such file"):
        read_toml(tmp_path / "absent.toml", Thing)


def test_keys_have_parts_up_to_the_limit(tmp_path):
    for dots, refused in ((31, "no such key"), (32, "of more than 32 parts")):
        (tmp_path / "t.toml").write_text("a" + ".a" * dots + " = 1")
        with pytest.raises(UserError, match=refused):
            read_toml(tmp_path / "t.toml", Thing)


def test_only_regular_files_within_the_limit_are_read(tmp_path):
    (tmp_path / "a").write_bytes(b"1234")
    assert read_file(tmp_path / "a", 4) == b"1234"
    with pytest.raises(UserError, match="at most 3"):
        read_file(tmp_path / "a", 3)
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        with pytest.raises(UserError, match=r"regular file|is a folder"):
            read_file(path, 10)


@pytest.mark.parametrize("content", [b"{", b"[1]", b"\xff", b'{"size": "a"}', b'{"x":' * 100_000, b"[" * 100_000])
def test_json_that_is_no_record_is_one_kind_of_error(content):
    with pytest.raises(ValueError):
        decoded_json(content, Thing)
    assert decoded_json(b'{"size": 3}', Thing) == Thing(3)


def _write_half(path):
    with written_whole(path) as part:
        part.write_text("half of two")
        raise RuntimeError


def test_a_file_is_whole_or_as_it_was(tmp_path):
    path = tmp_path / "a.png"
    with written_whole(path) as part:
        assert (part.suffix, part.parent) == (".png", tmp_path)
        part.write_text("one")
        assert not path.exists()
    with pytest.raises(RuntimeError):
        _write_half(path)
    assert path.read_text() == "one"
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"size = 3" + b" " * (2**20 - 8), None),
        (b"size = 3" + b" " * (2**20 - 7), "at most 1048576"),
        (b"a" + b".a" * 31 + b" = 1", "there is no such key"),
        (b"a" + b".a" * 32 + b" = 1", "more than 32 parts"),
    ],
)
def test_a_toml_file_has_up_to_a_megabyte_and_its_keys_up_to_32_parts(tmp_path, content, said):
    (tmp_path / "t.toml").write_bytes(content)
    if said is None:
        assert read_toml(tmp_path / "t.toml", Thing) == Thing(3)
    else:
        with pytest.raises(UserError, match=said):
            read_toml(tmp_path / "t.toml", Thing)


@pytest.mark.parametrize("name", ["a.obj", "parts/a.obj", "./a.obj", "a..obj", "inside", "missing.obj"])
def test_a_reference_stays_inside_the_folder(tmp_path, name):
    (tmp_path / "parts").mkdir()
    (tmp_path / "inside").symlink_to("parts/a.obj")
    assert contained_path(tmp_path, name, "scene.toml") == tmp_path / name


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("/etc/passwd", "leads out"),
        ("../scene/a.obj", "leads out"),
        ("parts/../../a.obj", "leads out"),
        ("http://host/a.obj", "is an address"),
        ("file:///etc/passwd", "is an address"),
        (" FTP://host/a.obj", "is an address"),
        ("outside", "is a link out"),
        ("folder/a.obj", "is a link out"),
        ("a\0.obj", "no name of a file"),
    ],
)
def test_a_reference_out_of_the_folder_is_one_line_with_the_way_out(tmp_path, name, reason):
    (tmp_path / "scene").mkdir()
    (tmp_path / "a.obj").touch()
    (tmp_path / "scene" / "outside").symlink_to("../a.obj")
    (tmp_path / "scene" / "folder").symlink_to(tmp_path)
    with pytest.raises(UserError, match=rf"^scene.toml: .*{reason}.*; (put|correct)") as caught:
        contained_path(tmp_path / "scene", name, "scene.toml")
    assert len(str(caught.value).splitlines()) == 1


def test_a_folder_that_is_itself_a_link_holds_its_files(tmp_path):
    (tmp_path / "scene").mkdir()
    (tmp_path / "link").symlink_to("scene")
    assert contained_path(tmp_path / "link", "a.obj", "scene.toml") == tmp_path / "link" / "a.obj"


@pytest.mark.parametrize("name", ["a\0", "\ud800", 300 * "a"])
def test_what_is_no_name_of_a_file_is_one_line(tmp_path, name):
    with pytest.raises(UserError, match=r"no name of a file|too long") as caught:
        read_file(tmp_path / name, 10)
    assert str(caught.value).isprintable()


def test_a_full_disk_is_told_by_the_name_that_was_asked_for(tmp_path, monkeypatch):
    """Neither by the name of the part, which nobody else knows of, nor by none."""

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def refused_library() -> None:
        raise OSError("cannot write a.part.exr")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left") as caught, written_whole(tmp_path / "a.exr") as part:
        part.write_text("one")
    assert caught.value.filename == str(tmp_path / "a.exr")
    with pytest.raises(OSError, match=r"cannot write a\.exr"), written_whole(tmp_path / "a.exr"):
        refused_library()
    with pytest.raises(OSError, match="other") as caught, written_whole(tmp_path / "a.exr"):
        (tmp_path / "other").read_text()
    assert caught.value.filename == str(tmp_path / "other")
    with pytest.raises(OSError, match="No space left") as caught, writing_to(tmp_path):
        full(0)
    assert caught.value.filename == str(tmp_path)
    assert list(tmp_path.iterdir()) == []
