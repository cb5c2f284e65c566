"""What damaged messages are made from has every field that a header can have."""

from collections.abc import Iterator
from typing import Any

import msgspec

from tests.support.damaged_messages import whole_messages
from vemlight.runtime import wire
from vemlight.runtime.reports import Report


def set_fields(value: Any) -> Iterator[tuple[str, str]]:
    """The fields of a record, and of those in it, that are not as they are left out."""
    if isinstance(value, msgspec.Struct):
        for field in msgspec.structs.fields(value):
            own = getattr(value, field.name)
            if field.required or own != field.default:
                yield type(value).__name__, field.name
            yield from set_fields(own)
    elif isinstance(value, tuple):
        for each in value:
            yield from set_fields(each)



def test_every_field_of_every_header_is_among_what_is_damaged():
    headers = [header for header, _ in whole_messages()]
    given = {field for header in headers for field in set_fields(header)}
    kinds = {type(header) for header in headers} | {type(r) for h in headers if (r := getattr(h, "report", None))}
    assert {*wire.KINDS.values(), *Report.__subclasses__()} <= kinds
    possible = {(kind.__name__, name) for kind in kinds for name in kind.__struct_fields__}
    assert possible - given == {(kind.__name__, "version") for kind in wire.KINDS.values()}

