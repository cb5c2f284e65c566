"""Files: TOML into records, and never half a file."""

import msgspec
import pytest

from vemlight.errors import UserError
from vemlight.files import read_toml, written_whole


class Thing(msgspec.Struct, forbid_unknown_fields=True):
    size: int = 1


def test_a_record_is_read(tmp_path):
    (tmp_path / "t.toml").write_text("size = 3")
    assert read_toml(tmp_path / "t.toml", Thing) == Thing(3)


@pytest.mark.parametrize("content", [b"size = ", b"size = 'a'", b"wide = 1", b"\xff\xfe", b"\x00"])
def test_what_is_no_record_is_one_line_with_the_files_name(tmp_path, content):
    (tmp_path / "t.toml").write_bytes(content)
    with pytest.raises(UserError, match=r"t\.toml") as told:
        read_toml(tmp_path / "t.toml", Thing)
    assert len(str(told.value).splitlines()) == 1


def test_files_that_are_not_there(tmp_path):
    for path in (tmp_path / "absent.toml", tmp_path):
        with pytest.raises(UserError, match="cannot be read"):
            read_toml(path, Thing)


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
