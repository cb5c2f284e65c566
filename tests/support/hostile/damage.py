"""Damage to a file's bytes."""

import itertools
import random
import re
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


NUMBERS = (b"0", b"-1", b"1", b"2", b"3", b"255", b"65536", b"2147483648", b"1e30", b"1e308", b"-1e308", b"1e-308", b"nan", b"inf",
           b"1e999", b"0.5", b"99999999999999999999")  # fmt: skip
NUMBER = re.compile(rb"-?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?")
WORD = re.compile(rb"[^\s,\[\]{}:]+")
MAX_TOKENS = 4096  # looked for in a file


def damaged(whole: list[bytes], seed: str) -> bytes:
    """One of the files with bytes changed, cut, doubled, spliced with another's, or with numbers and words replaced by others that a reader
    may trip over; the same one for the same seed.
    """
    chance = random.Random(seed)
    data, other = bytearray(chance.choice(whole)), chance.choice(whole)
    match chance.randrange(10):
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
        case 5 | 6:
            at = chance.randrange(len(data))
            data[at : at + chance.randint(0, 12)] = (
                chance.choice(WORDS) if chance.random() < 0.7 else struct.pack("<I", chance.choice((0, 1, 2**31, 2**32 - 1)))
            )
        case 7 | 8:
            for _ in range(chance.randint(1, 3)):
                _replace(data, NUMBER, chance.choice(NUMBERS), chance)
        case _:
            words = _tokens(bytes(other), WORD)
            _replace(data, WORD, other[slice(*chance.choice(words))] if words else b"", chance)
    return bytes(data)


def _replace(data: bytearray, token: re.Pattern[bytes], new: bytes, chance: random.Random) -> None:
    if found := _tokens(bytes(data), token):
        begin, end = chance.choice(found)
        data[begin:end] = new


def _tokens(data: bytes, token: re.Pattern[bytes]) -> list[tuple[int, int]]:
    return [match.span() for match in itertools.islice(token.finditer(data), MAX_TOKENS)]
