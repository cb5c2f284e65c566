"""A USD layer as text (.usda), its numbers with nine digits: as many as bring a float32 back."""

from collections.abc import Iterator
from itertools import chain
from typing import Any, BinaryIO

import msgspec
import numpy as np

from vemlight.exchange.usd_attribute import Attribute, LayerHead

NUMBERS = 4096  # made into text at once: arrays of 33 kB, which the processor's cache holds
LEAST, MOST = -45, 38  # decimal exponents of float32
POWERS = 10.0 ** (8 - np.arange(LEAST, MOST + 1))  # that make nine digits of a number of each exponent
LOWER = np.floor(np.log10(2.0 ** (np.arange(256) - 127))).astype(np.int64)  # decimal exponent of the least float32 of each binary one
LOWER[0] = 0  # of 0; of what is not normal it is found by the logarithm
NEXT = 10.0 ** (LOWER + 1)  # from which on it is one more
FOUR_DIGITS = np.array([f"{k:04d}".encode() for k in range(10_000)]).view("<u4")
EXPONENTS = np.array([f"e{e:+03d}".encode() for e in range(LEAST, MOST + 1)]).view("<u4")
DECIMAL = np.dtype(
    [("sign", "u1"), ("first", "u1"), ("point", "u1"), ("next4", "<u4"), ("last4", "<u4"), ("exponent", "<u4"), ("then", "S2")]
)  # -1.23456789e-01 and what separates it from the next


class TextLayer:
    """A LayerWriter of .usda."""

    def __init__(self, file: BinaryIO, root: str, head: LayerHead) -> None:
        self._file = file
        keys = [f"{code:.17g}: ".encode() for code in head.codes.tolist()]
        width = max(map(len, keys), default=1)
        self._keys = np.array([key.ljust(width) for key in keys], f"S{width}")
        times = f"    startTimeCode = 0\n    endTimeCode = {head.codes[-1]:.17g}\n" if len(head.codes) > 1 else ""
        notes = "".join(f"        string {_quoted(key)} = {_quoted(text)}\n" for key, text in head.notes.items())
        self._file.write(
            (
                f'#usda 1.0\n(\n    defaultPrim = "{root}"\n    upAxis = "Z"\n    metersPerUnit = 1\n'
                f"    timeCodesPerSecond = {head.rate:.17g}\n    framesPerSecond = {head.rate:.17g}\n{times}"
                f'    customLayerData = {{\n{notes}    }}\n)\n\ndef Xform "{root}"\n{{\n'
            ).encode()
        )

    def prims(self, kind: str, prims: dict[str, list[Attribute]]) -> None:
        samples = self._samples(prims)
        for name, attributes in prims.items():
            parts = [f'    def {kind} "{name}"\n    {{\n'.encode()]
            for attribute in attributes:
                declared = f"{'custom ' * attribute.is_custom}{'uniform ' * attribute.is_uniform}{attribute.type} {attribute.name}"
                if attribute.frames is None:
                    parts.append(f"        {declared} = {_literal(attribute.type, attribute.value)}\n".encode())
                else:
                    parts += f"        {declared}.timeSamples = {{".encode(), next(samples[attribute.name]), b"}\n"
            self._file.writelines([*parts, b"    }\n\n"])

    def finish(self) -> None:
        self._file.write(b"}\n")

    def _samples(self, prims: dict[str, list[Attribute]]) -> dict[str, Iterator[Any]]:
        """Texts of the samples of each attribute, by name, in the order of the prims."""
        sampled: dict[str, list[Attribute]] = {}
        for attribute in chain.from_iterable(prims.values()):
            if attribute.frames is not None:
                sampled.setdefault(attribute.name, []).append(attribute)
        return {name: (self._assets if of_name[0].type == "asset" else self._texts)(of_name) for name, of_name in sampled.items()}

    def _assets(self, attributes: list[Attribute]) -> Iterator[bytes]:
        for attribute in attributes:
            keys = self._keys[attribute.frames].tolist()
            yield b", ".join(key + _literal("asset", name).encode() for key, name in zip(keys, attribute.value, strict=True))

    def _texts(self, attributes: list[Attribute]) -> Iterator[memoryview]:
        """All are made together: of a light alone numpy's calls would take longer than what they do."""
        frames = np.concatenate([np.asarray(attribute.frames) for attribute in attributes])
        values = np.concatenate([attribute.value for attribute in attributes])
        brackets = [] if values.ndim == 1 else [("begin", "S1"), ("end", "S1")]
        values = values.reshape(len(frames), -1)
        row = np.dtype([("key", self._keys.dtype), *brackets[:1], ("numbers", DECIMAL, values.shape[1:]), *brackets[1:]])
        rows = np.empty(len(frames), row)
        rows["key"] = self._keys[frames]
        rows["numbers"]["then"] = b", "
        if brackets:
            rows["begin"], rows["numbers"]["then"][:, -1], rows["end"] = b"(", b"),", b" "
        step = NUMBERS // values.shape[1]
        for first in range(0, len(rows), step):
            write_decimals(rows["numbers"][first : first + step], values[first : first + step])
        text, end = rows.view(np.uint8).data, 0
        for attribute in attributes:
            begin, end = end, end + len(attribute.value) * row.itemsize
            yield text[begin : end - 2]


def write_decimals(texts: np.ndarray, values: np.ndarray) -> None:
    """Finite float32 as text of equal width, nine digits and an exponent each, into `texts`, of the same shape and of DECIMAL."""
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
    whole = digits.astype(np.uint32)
    first5 = whole // np.uint32(10**4)
    first = first5 // np.uint32(10**4)
    texts["sign"] = np.where(np.signbit(values), ord("-"), ord(" "))
    texts["first"] = first + ord("0")
    texts["point"] = ord(".")
    texts["next4"] = FOUR_DIGITS[first5 - first * np.uint32(10**4)]
    texts["last4"] = FOUR_DIGITS[whole - first5 * np.uint32(10**4)]
    texts["exponent"] = EXPONENTS[exponent - LEAST]


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
