"""A USD layer in binary (.usdc): Pixar's crate file, version 0.8.0, which all releases of USD since 2019 read.

The values come first, as they are added; then six tables: tokens, strings, fields (a token and a value), sets of fields, paths and specs
(a path, its set of fields, its kind). A value stands as a rep of 64 bits: flags, a type, and the value itself or where it lies. The format
wants its tables compressed, for which blocks of literals will do. (OpenUSD, pxr/usd/usd/crateFile.cpp, integerCoding.cpp)
"""

import struct
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from vemlight.exchange.usd_attribute import Attribute, LayerHead

BOOTSTRAP = struct.Struct("<8s8Bq64x")  # magic, version, where the table of contents is
VERSION = (0, 8, 0, 0, 0, 0, 0, 0)
SECTION = struct.Struct("<16sqq")  # name, start, size
SAMPLES = struct.Struct("<qQqQ")  # bytes to the times' rep, that, bytes to the number of values, that
IS_ARRAY, IS_INLINE = 1 << 63, 1 << 62
BOOL, INT64, FLOAT, DOUBLE, STRING, TOKEN, ASSET, QUATF, VEC3F = 1, 5, 8, 9, 10, 11, 12, 17, 24  # crateDataTypes.h
DICTIONARY, TOKENS, SPECIFIER, VARIABILITY, TIME_SAMPLES, DOUBLES = 31, 41, 42, 44, 46, 48
ATTRIBUTE, PRIM, PSEUDO_ROOT = 1, 6, 7  # SdfSpecType
LEAF, ONLY_CHILDREN, ONLY_SIBLING = -2, -1, 0  # of a path: what comes next; else how many paths on its sibling is, after children
NO_FIELD = 2**32 - 1  # ends a set
UNUSED = ";-)"  # token 0: a property's token stands negative, which 0 cannot


class _Spec(NamedTuple):
    """token: of the last name in its path, negative for a property."""

    token: int
    jump: int
    field_set: int
    kind: int


class CrateLayer:
    """A LayerWriter of .usdc."""

    def __init__(self, file: BinaryIO, root: str, head: LayerHead) -> None:
        self._file, self._root, self._head = file, root, head
        self._at = 0
        self._tokens: dict[str, int] = {UNUSED: 0}
        self._strings: list[int] = []
        self._fields: dict[tuple[int, int], int] = {}
        self._field_sets: list[int] = []
        self._specs: list[_Spec] = []  # in the order of their paths, of the prims below the root
        self._prims: list[tuple[int, int, int]] = []  # token, field set, where its attributes begin in _specs
        self._times: tuple[np.ndarray | None, int] = (None, 0)  # the frames of the newest samples, and their rep
        self._put(bytes(BOOTSTRAP.size))

    def prims(self, kind: str, prims: dict[str, list[Attribute]]) -> None:
        for name, attributes in prims.items():
            self._prim(kind, name, attributes)

    def _prim(self, kind: str, name: str, attributes: list[Attribute]) -> None:
        properties = self._token_list(one.name for one in attributes)
        fields = [("specifier", _inline(SPECIFIER, 0)), ("typeName", self._token_rep(kind)), ("properties", properties)]
        self._prims.append((self._token(name), self._field_set(fields), len(self._specs)))
        for k, attribute in enumerate(attributes):
            fields = [
                ("custom", _inline(BOOL, attribute.is_custom)),
                ("typeName", self._token_rep(attribute.type)),
                ("variability", _inline(VARIABILITY, attribute.is_uniform)),
            ]
            if attribute.frames is None:
                fields.append(("default", self._value(attribute.type, attribute.value)))
            else:
                fields.append(("timeSamples", self._samples(attribute)))
            jump = ONLY_SIBLING if k < len(attributes) - 1 else LEAF
            self._specs.append(_Spec(-self._token(attribute.name), jump, self._field_set(fields), ATTRIBUTE))

    def finish(self) -> None:
        specs = self._all_specs()
        sections: list[tuple[bytes, int, int]] = []
        for name, content in (
            (b"FIELDS", self._fields_table()),
            (b"FIELDSETS", _counted(self._field_sets) + _packed_ints(self._field_sets)),
            (b"PATHS", 2 * _counted(specs) + _packed_ints(range(len(specs))) + _packed_ints([spec.token for spec in specs])
             + _packed_ints([spec.jump for spec in specs])),
            (b"SPECS", _counted(specs) + _packed_ints(range(len(specs))) + _packed_ints([spec.field_set for spec in specs])
             + _packed_ints([spec.kind for spec in specs])),
            (b"STRINGS", _counted(self._strings) + np.array(self._strings, "<u4").tobytes()),
            (b"TOKENS", self._tokens_table()),
        ):  # fmt: skip
            sections.append((name, self._at, len(content)))
            self._put(content)
        contents = self._put(_counted(sections) + b"".join(SECTION.pack(*section) for section in sections))
        self._file.seek(0)
        self._file.write(BOOTSTRAP.pack(b"PXR-USDC", *VERSION, contents))

    def _all_specs(self) -> list[_Spec]:
        """In the order of the paths: the pseudo-root, the root, each prim before its attributes."""
        head, names = self._head, list(self._tokens)
        children = self._token_list(names[token] for token, *_ in self._prims)
        times = [("startTimeCode", self._double(0)), ("endTimeCode", self._double(head.codes[-1]))] if len(head.codes) > 1 else []
        of_layer = [
            ("defaultPrim", self._token_rep(self._root)), ("upAxis", self._token_rep("Z")), ("metersPerUnit", self._double(1)),
            ("timeCodesPerSecond", self._double(head.rate)), ("framesPerSecond", self._double(head.rate)), *times,
            ("customLayerData", self._dictionary(head.notes)), ("primChildren", self._token_list([self._root])),
        ]  # fmt: skip
        of_root = [("specifier", _inline(SPECIFIER, 0)), ("typeName", self._token_rep("Xform")), ("primChildren", children)]
        specs = [
            _Spec(self._token(""), ONLY_CHILDREN, self._field_set(of_layer), PSEUDO_ROOT),
            _Spec(self._token(self._root), ONLY_CHILDREN if self._prims else LEAF, self._field_set(of_root), PRIM),
        ]
        for k, (token, field_set, begin) in enumerate(self._prims):
            is_last = k == len(self._prims) - 1
            end = len(self._specs) if is_last else self._prims[k + 1][2]
            specs += [_Spec(token, ONLY_CHILDREN if is_last else 1 + end - begin, field_set, PRIM), *self._specs[begin:end]]
        return specs

    def _put(self, content: bytes) -> int:
        """Adds bytes; where they begin."""
        self._file.write(content)
        self._at += len(content)
        return self._at - len(content)

    def _token(self, text: str) -> int:
        return self._tokens.setdefault(text, len(self._tokens))

    def _token_rep(self, text: str) -> int:
        return _inline(TOKEN, self._token(text))

    def _token_list(self, texts: Any) -> int:
        numbers = np.array([self._token(text) for text in texts], "<u4")
        return _placed(TOKENS, self._put(_counted(numbers) + numbers.tobytes()))

    def _string(self, text: str) -> int:
        self._strings.append(self._token(text))
        return len(self._strings) - 1

    def _double(self, value: float) -> int:
        return _placed(DOUBLE, self._put(struct.pack("<d", value)))

    def _dictionary(self, notes: dict[str, str]) -> int:
        """Of each: the key, bytes to the value's rep, that."""
        rows = [struct.pack("<IqQ", self._string(key), 8, _inline(STRING, self._string(text))) for key, text in notes.items()]
        return _placed(DICTIONARY, self._put(_counted(rows) + b"".join(rows)))

    def _field_set(self, fields: list[tuple[str, int]]) -> int:
        start = len(self._field_sets)
        self._field_sets += [self._fields.setdefault((self._token(name), rep), len(self._fields)) for name, rep in fields]
        self._field_sets.append(NO_FIELD)
        return start

    def _value(self, kind: str, value: Any) -> int:
        if kind == "int64":
            return _placed(INT64, self._put(struct.pack("<q", value)))
        if kind == "token[]":
            self._put(bytes(-self._at % 8))
            numbers = np.array([self._token(text) for text in value], "<u4")
            return IS_ARRAY | _placed(TOKEN, self._put(_counted(numbers) + numbers.tobytes()))
        if kind == "bool":
            return _inline(BOOL, value)
        if kind == "token":
            return self._token_rep(value)
        return int(self._values(kind, value if kind == "asset" else np.array([value], np.float32))[0])

    def _values(self, kind: str, values: Any) -> np.ndarray:
        """The rep of each of float32 values, or of assets."""
        if kind == "asset":
            return np.array([_inline(ASSET, self._token(name)) for name in ([values] if isinstance(values, str) else values)], np.uint64)
        if kind == "float":
            return np.ascontiguousarray(values, "<f4").view("<u4").astype(np.uint64) | np.uint64(_inline(FLOAT, 0))
        if kind == "quatf":
            values = values[:, [1, 2, 3, 0]]  # in memory the real part is the last
        values = np.ascontiguousarray(values, "<f4")
        begin = self._put(values.tobytes())
        return _placed(QUATF if kind == "quatf" else VEC3F, begin) + values.strides[0] * np.arange(len(values), dtype=np.uint64)

    def _samples(self, attribute: Attribute) -> int:
        if self._times[0] is not attribute.frames:  # those of a light are mostly the same
            codes = self._head.codes[attribute.frames]
            self._times = attribute.frames, _placed(DOUBLES, self._put(_counted(codes) + codes.astype("<f8").tobytes()))
        reps = self._values(attribute.type, attribute.value)
        return _placed(TIME_SAMPLES, self._put(SAMPLES.pack(8, self._times[1], 8, len(reps)) + reps.astype("<u8").tobytes()))

    def _fields_table(self) -> bytes:
        tokens, reps = zip(*self._fields, strict=True)
        return _counted(reps) + _packed_ints(tokens) + _sized(_literals(np.array(reps, "<u8").tobytes()))

    def _tokens_table(self) -> bytes:
        text = b"".join(token.encode() + b"\0" for token in self._tokens)
        return _counted(self._tokens) + struct.pack("<Q", len(text)) + _sized(_literals(text))


def _inline(kind: int, value: int) -> int:
    return IS_INLINE | kind << 48 | int(value)


def _placed(kind: int, offset: int) -> int:
    return kind << 48 | offset


def _counted(items: Any) -> bytes:
    return struct.pack("<Q", len(items))


def _sized(content: bytes) -> bytes:
    return struct.pack("<Q", len(content)) + content


def _packed_ints(values: Any) -> bytes:
    """32-bit integers as integerCoding.cpp has them: a common difference, of no use here; a code of two bits each, 3: 32; differences."""
    numbers = np.array(values, np.int64)
    differences = np.diff(numbers, prepend=0).astype("<i4")  # modulo 2^32, as they are added again
    return _sized(_literals(bytes(4) + b"\xff" * ((2 * len(numbers) + 7) // 8) + differences.tobytes()))


def _literals(content: bytes) -> bytes:
    """A block of LZ4 that copies nothing, behind the number of chunks less one: its length in 15 and bytes of 255, then the bytes."""
    more, last = divmod(len(content) - 15, 255)
    if len(content) < 15:
        return bytes([0, len(content) << 4]) + content
    return b"\0\xf0" + b"\xff" * more + bytes([last]) + content
