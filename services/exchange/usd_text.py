"""A USD layer as text (.usda), its numbers with nine digits: as many as bring a float32 back."""

from typing import Any, BinaryIO

import msgspec
import numpy as np

from vemlight.exchange.usd_attribute import Attribute, LayerHead

ROWS = 4096  # of samples made into text at once: arrays of 100 kB, for which no memory is asked of the system each time
LEAST, MOST = -45, 38  # decimal exponents of float32
POWERS = 10.0 ** (8 - np.arange(LEAST, MOST + 1))  # that make nine digits of a number of each exponent
LOWER = np.floor(np.log10(2.0 ** (np.arange(256) - 127))).astype(np.int64)  # decimal exponent of the least float32 of each binary one
LOWER[0] = 0  # of 0; of what is not normal it is found by the logarithm
NEXT = 10.0 ** (LOWER + 1)  # from which on it is one more
FOUR_DIGITS = np.array([f"{k:04d}".encode() for k in range(10_000)]).view("<u4")
EXPONENTS = np.array([f"e{e:+03d}".encode() for e in range(LEAST, MOST + 1)]).view("<u4")
DECIMAL = np.dtype(
    [("sign", "u1"), ("first", "u1"), ("point", "u1"), ("next4", "<u4"), ("last4", "<u4"), ("exponent", "<u4")]
)  # -1.23456789e-01


class TextLayer:
    """A LayerWriter of .usda."""

    def __init__(self, file: BinaryIO, root: str, head: LayerHead) -> None:
        self._file = file
        keys = np.array([f"{code:.17g}: ".encode() for code in head.codes.tolist()] or [b""])
        self._keys = keys.view(np.uint8).reshape(len(keys), -1)
        self._keys[self._keys == 0] = ord(" ")
        times = f"    startTimeCode = 0\n    endTimeCode = {head.codes[-1]:.17g}\n" if len(head.codes) > 1 else ""
        notes = "".join(f"        string {_quoted(key)} = {_quoted(text)}\n" for key, text in head.notes.items())
        self._file.write(
            (
                f'#usda 1.0\n(\n    defaultPrim = "{root}"\n    upAxis = "Z"\n    metersPerUnit = 1\n'
                f"    timeCodesPerSecond = {head.rate:.17g}\n    framesPerSecond = {head.rate:.17g}\n{times}"
                f'    customLayerData = {{\n{notes}    }}\n)\n\ndef Xform "{root}"\n{{\n'
            ).encode()
        )

    def prim(self, kind: str, name: str, attributes: list[Attribute]) -> None:
        self._file.write(f'    def {kind} "{name}"\n    {{\n'.encode())
        for attribute in attributes:
            declared = f"{'custom ' * attribute.is_custom}{'uniform ' * attribute.is_uniform}{attribute.type} {attribute.name}"
            if attribute.frames is None:
                self._file.write(f"        {declared} = {_literal(attribute.type, attribute.value)}\n".encode())
            else:
                self._file.write(f"        {declared}.timeSamples = {{".encode())
                for first in range(0, len(attribute.frames), ROWS):
                    piece = slice(first, first + ROWS)
                    self._file.write(b", " * (first > 0) + self._samples(attribute.frames[piece], attribute.value[piece]))
                self._file.write(b"}\n")
        self._file.write(b"    }\n\n")

    def finish(self) -> None:
        self._file.write(b"}\n")

    def _samples(self, frames: np.ndarray, values: Any) -> bytes:
        keys = self._keys[frames]
        if isinstance(values, list):
            return b", ".join(key.tobytes() + _literal("asset", name).encode() for key, name in zip(keys, values, strict=True))
        begin, end = (b"", b", ") if values.ndim == 1 else (b"(", b"), ")
        parts = [keys, _column(begin, len(keys))]
        for column in values.reshape(len(keys), -1).T:
            is_constant = (column == column[0]).all()
            numbers = np.broadcast_to(decimals(column[:1]), (len(keys), DECIMAL.itemsize)) if is_constant else decimals(column)
            parts += [numbers, _column(b", ", len(keys))]
        return np.hstack([*parts[:-1], _column(end, len(keys))]).tobytes()[:-2]


def decimals(values: np.ndarray) -> np.ndarray:
    """Finite float32 (n,) as text of equal width, (n, 15) uint8: nine digits and an exponent each."""
    values = np.ascontiguousarray(values)
    size = np.abs(values).astype(np.float64)
    binary = values.view(np.int32) >> 23 & 255
    exponent = LOWER[binary] + (size >= NEXT[binary])
    tiny = (binary == 0) & (size > 0)
    if tiny.any():
        exponent[tiny] = np.floor(np.log10(size[tiny]))
    digits = np.rint(size * POWERS[exponent - LEAST])
    grown = digits >= 1e9  # rounded up to the next power of ten
    if grown.any():
        digits[grown] /= 10
        exponent[grown] += 1
    first, last8 = np.divmod(digits.astype(np.uint32), np.uint32(10**8))
    next4, last4 = np.divmod(last8, np.uint32(10**4))
    text = np.empty(len(values), DECIMAL)
    text["sign"] = np.where(np.signbit(values), ord("-"), ord(" "))
    text["first"] = first + ord("0")
    text["point"] = ord(".")
    text["next4"], text["last4"] = FOUR_DIGITS[next4], FOUR_DIGITS[last4]
    text["exponent"] = EXPONENTS[exponent - LEAST]
    return text.view(np.uint8).reshape(len(values), -1)


def _column(text: bytes, rows: int) -> np.ndarray:
    return np.broadcast_to(np.frombuffer(text, np.uint8), (rows, len(text)))


def _literal(kind: str, value: Any) -> str:
    """A value in usda; floats as JSON has them, in round brackets where they are several."""
    if kind == "asset":
        return f"@{_quoted(value)[1:-1]}@"
    if kind == "token[]":
        return f"[{', '.join(_quoted(one) for one in value)}]"
    if kind == "token":
        return _quoted(value)
    if kind == "bool":
        return str(int(value))
    return f"({', '.join(map(repr, value))})" if isinstance(value, list | tuple) else repr(value)


def _quoted(text: str) -> str:
    return msgspec.json.encode(text).decode()
