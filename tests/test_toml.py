"""TOML into records: what is wrong is one line with the line's number, the key and the way out."""

from typing import Annotated, Literal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vemlight.errors import UserError
from vemlight.toml import MAX_PARSED, line_of, record_from_toml


class Ball(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    at: tuple[float, float]
    kind: Literal["glass", "wood"] = "wood"


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    legs: Annotated[int, msgspec.Meta(ge=3)] = 4
    height: Annotated[float, msgspec.Meta(gt=0)] | None = None

    def __post_init__(self) -> None:
        if self.legs == 7:
            raise ValueError("legs do not go in sevens; take one off")


class Room(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    name: str = ""
    table: Table = Table()
    ball: list[Ball] = []
    seats: dict[Literal["north", "south"], int] = {}


def refusal(text: str | bytes) -> str:
    with pytest.raises(UserError) as caught:
        record_from_toml("room.toml", text if isinstance(text, bytes) else text.encode(), Room)
    line = str(caught.value)
    assert line.startswith("room.toml: ")
    assert line.isprintable()
    return line.removeprefix("room.toml: ")


@pytest.mark.parametrize(("text", "line"), [
    ("[table]\nlesg = 3", "line 2: [table] lesg: there is no such key; did you mean legs?"),
    ("\n\nlegs = 3", "line 3: legs: there is no such key; it belongs into [table]"),
    ("[table]\nname = ''", "line 2: [table] name: there is no such key; it belongs at the top, before all sections"),
    ("[table]\ncolour = 3", "line 2: [table] colour: there is no such key; the keys here are legs, height"),
    ("[tabel]\nlegs = 3", "line 1: tabel: there is no such key; did you mean table?"),
    ("[table]\n# of wood\nlegs = 2\n", "line 3: [table] legs = 2: must be a whole number >= 3; correct it"),
    ("[table]\nlegs = 3.5", "line 2: [table] legs = 3.5: must be a whole number, not a fraction; correct it"),
    ("[table]\nheight = 'a'", 'line 2: [table] height = "a": must be a number, not text in quotes; correct it'),
    ("[table]\nlegs = 7", "line 1: [table] legs do not go in sevens; take one off"),
    ("table = 3", "line 1: table = 3: must be a table, not a whole number; correct it"),
    ("[[ball]]\nat = [0, 0]\n[[ball]]\nkind = 'wood'", "line 3: [ball 2] has no at; add that key"),
    ("[[ball]]\nat = [\n0,\n'a',\n]", "line 2: [ball 1] at = [0, 'a']: must be a number, not text in quotes; correct it"),
    ("[[ball]]\nat = [0, 0]\nkind = 'Woods'", 'line 3: [ball 1] kind = "Woods": choose from glass, wood; did you mean wood?'),
    ("[[ball]]\nat = [0, 0]\nkind = 3", "line 3: [ball 1] kind = 3: choose from glass, wood"),
    ("seats = {nort = 1}", "line 1: [seats] nort: choose from north, south; did you mean north?"),
    ("[table]\nheight = nan", "line 2: [table] height = nan: nan and inf are refused; write a finite number"),
    ("[[ball]]\nat = [0, -inf]", "line 2: [ball 1] at = [0, -inf]: nan and inf are refused; write a finite number"),
    ("name = 'a'\n[table\n", "line 2: is not TOML (Expected ']' at the end of a table declaration); correct it"),
    ("name = 'a'\nname = 'b'", "line 2: is not TOML (Cannot overwrite a value); correct it"),
    (b"name = 'a'\n# caf\xe9", "line 2: is not TOML, because it is not UTF-8; save the file as that"),
    ("name = 'a'".encode("utf-16"), "is text in UTF-16, and not TOML in UTF-8; save it as UTF-8"),
    (b"\x89PNG\r\n\x1a\n...", "is a PNG picture, and not TOML in UTF-8; name a file of TOML text"),
    (b"name = 'a'\x00", "is a binary file, and not TOML in UTF-8; name a file of TOML text"),
])  # fmt: skip
def test_what_is_wrong_is_told_with_its_line_its_key_and_the_way_out(text, line):
    assert refusal(text) == line


def test_a_byte_order_mark_is_passed_over():
    assert record_from_toml("room.toml", b"\xef\xbb\xbfname = 'a'", Room) == Room(name="a")


def test_a_long_value_is_shown_by_its_beginning():
    assert len(refusal(f"[table]\nheight = '{'a' * 1000}'")) < 200


@given(st.lists(st.sampled_from(["", "# a comment", "a = 1", "b = [\n1,\n# two\n2,\n]", 'c = """\n[x]\nd = 3\n"""', "e = {f = 1}"]),
                min_size=1, max_size=8, unique_by=lambda text: text or None), st.data())  # fmt: skip
def test_the_line_of_a_key_is_where_it_stands(statements, data):
    """Whatever stands before and after it, values of several lines too."""
    place = data.draw(st.integers(0, len(statements)))
    lines = [*statements[:place], "wanted = [\n0,\n1]", *statements[place:]]
    text = "\n".join(lines)
    assert line_of(text, ("wanted",)) == line_of(text, ("wanted", 1)) == text[: text.index("wanted")].count("\n") + 1
    nested = f"[x]\n{text}"
    assert line_of(nested, ("x", "wanted")) == nested[: nested.index("wanted")].count("\n") + 1


def test_no_line_is_looked_for_in_a_file_that_takes_long():
    assert line_of("wanted = 1\n" + "# x\n" * MAX_PARSED, ("wanted",)) == 0
    assert line_of("wanted = 1\n" + "# x\n" * 100, ("wanted",)) == 1
