"""Buffers, vertices and texels declared once: a numpy dtype whose fields Python fills by name, and the GLSL that reads the same bytes.

Buffers follow the std140 rules (OpenGL 4.3, section 7.6.2.2), storage buffers too: scalars are aligned to 4 bytes, vec2 to 8, vec3 and vec4
to 16, whole structs are padded to a multiple of 16 bytes. Arrays are of vec4 alone, the only elements that the rules do not pad.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:  # frames are planned without GL
    import moderngl

# Of each GLSL type: numpy's scalar type, how many of them, and the alignment in bytes.
TYPES = {
    "float": ("<f4", 1, 4), "int": ("<i4", 1, 4), "uint": ("<u4", 1, 4),
    "vec2": ("<f4", 2, 8), "vec3": ("<f4", 3, 16), "vec4": ("<f4", 4, 16),
}  # fmt: skip
VECTORS = {1: "float", 2: "vec2", 3: "vec3", 4: "vec4"}  # of floats, by their number


class Member(NamedTuple):
    """A field: its GLSL type, what it holds, and its length where it is an array."""

    type: str
    meaning: str = ""
    length: int | None = None


class BufferStruct(NamedTuple):
    """A struct in uniform blocks and storage buffers. dtype: its bytes in Python. glsl: its declaration, for an include."""

    dtype: np.dtype
    glsl: str


def buffer_struct(name: str, members: Mapping[str, Member]) -> BufferStruct:
    """The struct `name` with its members in their order. Raises ValueError for an array of anything but vec4."""
    offset, formats, offsets = 0, [], []
    for key, (kind, _, length) in members.items():
        if length is not None and kind != "vec4":
            raise ValueError(f"{name}.{key}: arrays in buffers are of vec4, not of {kind}")
        scalar, count, alignment = TYPES[kind]
        shape = (() if length is None else (length,)) + (() if count == 1 else (count,))
        formats.append(np.dtype((scalar, shape)))
        offsets.append(-(-offset // alignment) * alignment)
        offset = offsets[-1] + formats[-1].itemsize
    dtype = np.dtype({"names": list(members), "formats": formats, "offsets": offsets, "itemsize": -(-offset // 16) * 16})
    return BufferStruct(dtype, _struct(name, members))


def _struct(name: str, members: Mapping[str, Member]) -> str:
    """The struct in GLSL, with what each member holds as a comment."""
    arrays = {key: "" if member.length is None else f"[{member.length}]" for key, member in members.items()}
    notes = {key: f"  // {member.meaning}" if member.meaning else "" for key, member in members.items()}
    return "".join([f"struct {name} {{\n", *(f"    {m.type} {key}{arrays[key]};{notes[key]}\n" for key, m in members.items()), "};\n"])


class TexelRecord(NamedTuple):
    """What a texel of a 2D float texture holds. dtype: float32 and packed, as it is read back. glsl: see `texel_record`."""

    dtype: np.dtype
    glsl: str

    @property
    def components(self) -> int:
        """How many numbers the texture has a texel."""
        return self.dtype.itemsize // 4


def texel_record(name: str, members: Mapping[str, Member]) -> TexelRecord:
    """A record of one to four floats in the texture of the sampler `name`.

    In GLSL for `some_name`: the struct SomeName, `some_name_at(pixel)`, which fetches it, and `some_name_texel(...)`, which packs it.
    """
    counts = [TYPES[member.type][1] for member in members.values()]
    ends = np.cumsum([0, *counts]).tolist()
    struct, vector = "".join(part.capitalize() for part in name.split("_")), VECTORS[ends[-1]]
    fetched = ", ".join(f"texel.{'xyzw'[first:last]}" for first, last in pairwise(ends))
    arguments = ", ".join(f"{member.type} {key}" for key, member in members.items())
    glsl = (
        f"{_struct(struct, members)}uniform sampler2D {name};\n"
        f"{struct} {name}_at(ivec2 pixel) {{\n    vec4 texel = texelFetch({name}, pixel, 0);\n    return {struct}({fetched});\n}}\n"
        f"{vector} {name}_texel({arguments}) {{ return {vector}({', '.join(members)}); }}\n"
    )
    fields = [(key, "<f4", (count,)) if count > 1 else (key, "<f4") for key, count in zip(members, counts, strict=True)]
    return TexelRecord(np.dtype(fields), glsl)


class VertexLayout(NamedTuple):
    """What a vertex buffer holds, float32 and float16. glsl: the vertex shader's inputs; one that a program leaves out costs it nothing."""

    dtype: np.dtype
    glsl: str
    formats: dict[str, tuple[str, int]]  # of each attribute: moderngl's name of it, and its bytes

    def content(self, buffer: "moderngl.Buffer", program: "moderngl.Program") -> tuple[object, ...]:
        """The buffer as `Context.vertex_array` takes it, with the attributes that the program uses."""
        used = [name for name in self.formats if name in program]
        formats = [form if name in used else f"{size}x" for name, (form, size) in self.formats.items()]
        return (buffer, " ".join(formats), *used)


def vertex_layout(attributes: Mapping[str, tuple[type[np.floating], int]]) -> VertexLayout:
    """The layout of packed vertices: of each attribute the type of its numbers and how many."""
    dtype = np.dtype([(name, kind, (count,)) if count > 1 else (name, kind) for name, (kind, count) in attributes.items()])
    sizes = {name: np.dtype(kind).itemsize for name, (kind, _) in attributes.items()}
    formats = {name: (f"{count}f{sizes[name]}", count * sizes[name]) for name, (_, count) in attributes.items()}
    return VertexLayout(dtype, "".join(f"in {VECTORS[count]} {name};\n" for name, (_, count) in attributes.items()), formats)
