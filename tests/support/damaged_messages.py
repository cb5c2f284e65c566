"""Damaged messages, made from the golden ones with an eye for their structure.

`python -m tests.support.damaged_messages [--count N] [--seed S]` tries them by the million.

Each is either a message or one ValueError; whatever else comes out, a warning too, is written down with the parts that did it, and the
status is 1.
"""

import argparse
import random
import struct
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np

from tests import golden
from vemlight.runtime import wire
from vemlight.runtime.poses import Pose
from vemlight.runtime.reports import Report

Parts = list[bytes]
# msgpack's markers that announce a length, with the longest length that they can: bin, ext, str, array and map of 8, 16 and 32 bits.
LENGTHS = tuple(
    bytes([marker]) + b"\xff" * size
    for size, markers in ((1, (0xC4, 0xC7, 0xD9)), (2, (0xC5, 0xC8, 0xDA, 0xDC, 0xDE)), (4, (0xC6, 0xC9, 0xDB, 0xDD, 0xDF)))
    for marker in markers
)
SCALARS = (
    *(bytes([marker]) for marker in (0xC0, 0xC1, 0xC2, 0x00, 0xFF, 0xA0, 0x80, 0x90)),
    b"\xcf" + b"\xff" * 8,
    b"\xd3\x80" + bytes(7),
    *(b"\xcb" + struct.pack(">d", value) for value in (float("nan"), float("inf"), -1e300)),
    b"\xd6\xff" + bytes(4),  # a time
)
DEPTHS = (1, 10, 100, 900, 999, 5000, 60_000)
# Lists and maps of one item, inside one another.
NESTED = tuple(level * depth + b"\xc0" for depth in DEPTHS for level in (b"\x91", b"\x81\xa1k", b"\xdd\x00\x00\x00\x01"))


def flipped(parts: Parts, other: Parts, chance: random.Random) -> Parts:
    """A few bytes of the header changed."""
    header = bytearray(parts[1])
    for _ in range(chance.randint(1, 4)):
        header[chance.randrange(len(header))] = chance.randrange(256)
    return [parts[0], bytes(header), *parts[2:]]


def cut(parts: Parts, other: Parts, chance: random.Random) -> Parts:
    """A part that ends early or goes on for too long."""
    which = chance.randrange(len(parts))
    part = parts[which][: chance.randrange(len(parts[which]) + 1)] + bytes(chance.choice((0, 0, 1, 4, 1000)))
    return [*parts[:which], part, *parts[which + 1 :]]


def spliced(parts: Parts, other: Parts, chance: random.Random) -> Parts:
    """The beginning of one header and the end of another's, under either topic."""
    header = parts[1][: chance.randrange(len(parts[1]))] + other[1][chance.randrange(len(other[1])) :]
    return [chance.choice((parts, other))[0], header, *chance.choice((parts, other))[2:]]


def with_unknown_key(parts: Parts, other: Parts, chance: random.Random) -> Parts:
    """One key more in the header's map, whose value is nested lists or maps, or anything else that is short."""
    header = parts[1]
    if not 0x80 <= header[0] < 0x8F:
        return flipped(parts, other, chance)
    nested = chance.choice(NESTED)
    key = chance.choice((b"\xa7unknown", b"\xa4kind", b"\xa5stamp", b"\xa5count", chance.choice(SCALARS), nested))
    value = chance.choice((nested, chance.choice(SCALARS), chance.choice(LENGTHS)))
    return [parts[0], bytes([header[0] + 1]) + header[1:] + key + value, *parts[2:]]


def with_nested_value(parts: Parts, other: Parts, chance: random.Random) -> Parts:
    """Anything, deep or long or odd, in place of a few bytes of the header."""
    at, header = chance.randrange(len(parts[1])), parts[1]
    what = chance.choice((b"\x91" * chance.choice(DEPTHS), chance.choice(LENGTHS), chance.choice(SCALARS)))
    return [parts[0], header[:at] + what + header[at + chance.randint(0, 9) :], *parts[2:]]


def rearranged(parts: Parts, other: Parts, chance: random.Random) -> Parts:
    """Parts left out, doubled, exchanged, or another message's."""
    mixed = [chance.choice((*parts, *other)) for _ in range(chance.randrange(0, wire.MAX_PARTS + 3))]
    return chance.choice((mixed, parts[::-1], parts * 2, parts[:1], [*parts[:2], *other[2:]]))


def with_odd_numbers(parts: Parts, other: Parts, chance: random.Random) -> Parts:
    """nan, infinity or noise somewhere in an array."""
    if len(parts) < 3:
        return flipped(parts, other, chance)
    which = chance.randrange(2, len(parts))
    array = bytearray(parts[which])
    odd = chance.choice((struct.pack("<f", float("nan")), struct.pack("<f", float("-inf")), b"\xff" * 8, chance.randbytes(4)))
    at = chance.randrange(max(len(array) // 4, 1)) * 4
    array[at : at + len(odd)] = odd
    return [*parts[:which], bytes(array), *parts[which + 1 :]]


KINDS: tuple[Callable[[Parts, Parts, random.Random], Parts], ...] = (
    flipped, cut, spliced, with_unknown_key, with_nested_value, rearranged, with_odd_numbers,
)  # fmt: skip


def whole_messages() -> list[wire.Message]:
    """The golden ones, and others that have what those leave out: together every field of every header, not as it is left out."""
    status, source = wire.StatusMessage, wire.SourceChoice(choice="recording a", label="a")
    scaled = Pose(name="box", position=(0.0, 0.0, 1.0), power=1.0, scale=2.0)
    numbers = {"sequence": 7, "rate_hz": 25.0, "age_ms": 3.5, "step_ms": 0.75, "frames": 8, "skipped": 0, "dropped": 0, "refused": 0}
    reports: list[Any] = [report(**dict.fromkeys(report.__struct_fields__, 1)) for report in Report.__subclasses__()]
    playing = wire.SourceMessage(
        name="a", frames=9, fps=24.0, position=3, at_end=True, choice="bundled", choices=(source, source), opening="recording a",
        refusal="it is gone", recording="b", recorded_frames=4, recorded_bytes=5, record_bytes_s=6.5, free_bytes=7, why_not_record="full",
        recent_s=20.0, recent_bytes=8,
    )  # fmt: skip
    chosen = wire.ControlMessage(source="upload 0123456789abcdef", scene="0123456789abcdef", record=True, poses=(scaled,))
    drawn, pixels = golden.messages()["image_linear"]
    seen, radiance = golden.messages()["map"]
    lit, lights = golden.messages()["lights"]
    return [
        *golden.messages().values(),
        *((status(service="fuse", restarts=0, report=report, **numbers), ()) for report in reports),
        (playing, (np.empty(0, np.int64), np.empty((0, wire.THUMBNAIL_SIDE, wire.THUMBNAIL_SIDE, 3), np.uint8))),
        (chosen, ()),
        (msgspec.structs.replace(seen, segment=3, clipped=True), radiance),
        (msgspec.structs.replace(lit, clipped=True, estimated_lux=9.5), lights),
        (msgspec.structs.replace(drawn, objects=(scaled,)), pixels),
    ]


def damaged_messages(count: int, seed: int) -> Iterator[Parts]:
    """`count` damaged messages, the same ones for the same seed."""
    chance = random.Random(seed)
    whole = [wire.pack(*message) for message in whole_messages()]
    for _ in range(count):
        yield chance.choice(KINDS)(chance.choice(whole), chance.choice(whole), chance)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=lambda text: int(float(text)), default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("error")
    began_s, read = time.monotonic(), 0
    for number, parts in enumerate(damaged_messages(options.count, options.seed)):
        try:
            wire.unpack(parts)
            read += 1
        except ValueError:
            pass
        except BaseException as error:
            print(f"message {number} of seed {options.seed}: {type(error).__name__}: {error}: {[part[:200].hex() for part in parts]}")
            return 1
    per_s = options.count / (time.monotonic() - began_s)
    print(f"{options.count} damaged messages, {read} of them legal, no other error, {per_s:.0f} a second")
    return 0


if __name__ == "__main__":
    sys.exit(main())
