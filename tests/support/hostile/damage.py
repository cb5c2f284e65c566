"""Damage to a file's bytes."""

import random
import struct

WORDS = (
    b"0",
    b"-1",
    b"1e308",
    b"nan",
    b"inf",
    b"99999999999999999999",
    b"2147483647",
    b"",
    b"\0",
    b"\xff\xfe",
    b"[" * 3000,
    b"{" * 3000,
    b'"' * 99,
)


def damaged(whole: list[bytes], seed: str) -> bytes:
    """One of the files with bytes changed, cut, doubled, spliced with another's, or numbers replaced by others that a reader may trip
    over; the same one for the same seed.
    """
    chance = random.Random(seed)
    data, other = bytearray(chance.choice(whole)), chance.choice(whole)
    match chance.randrange(6):
        case 0 | 1:
            for _ in range(chance.randint(1, 8)):
                data[chance.randrange(len(data))] = chance.randrange(256)
        case 2:
            del data[chance.randrange(len(data)) :]
        case 3:
            at, length = chance.randrange(len(data)), chance.randint(1, 200)
            data[at:at] = data[at : at + length] * chance.choice((1, 2, 50))
        case 4:
            data[chance.randrange(len(data)) :] = other[chance.randrange(len(other)) :]
        case _:
            at = chance.randrange(len(data))
            data[at : at + chance.randint(0, 12)] = (
                chance.choice(WORDS) if chance.random() < 0.7 else struct.pack("<I", chance.choice((0, 1, 2**31, 2**32 - 1)))
            )
    return bytes(data)
