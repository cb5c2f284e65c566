"""Python and the shaders agree on every buffer, texel, vertex and constant: a shader writes back what it read by name."""

from collections.abc import Iterator

import moderngl
import numpy as np
import pytest

from vemlight.renderer.gl import buffers
from vemlight.renderer.gl.buffers import SCENE_VERTEX, SURFACE_DIFFUSE
from vemlight.renderer.gl.constants import CLASSES, GUTTER, MATERIAL_KINDS, MaterialKind, constants_glsl
from vemlight.renderer.gl.layout import BufferStruct, Member, TexelRecord, buffer_struct, texel_record
from vemlight.renderer.gl.programs import headless_context

# Where std140 pads: a vec3 before a float, before a vec2 and before another vec3, a vec2 after a float, arrays, and the struct's end.
PADDED = buffer_struct(
    "Padded",
    {
        "a": Member("vec3"), "b": Member("float"), "c": Member("vec3"), "d": Member("vec2"), "e": Member("float"), "f": Member("vec2"),
        "g": Member("int"), "h": Member("vec4", length=3), "i": Member("uint"), "j": Member("vec3"), "k": Member("vec3"),
        "l": Member("float"),
    },
)  # fmt: skip
STRUCTS = {"PADDED": PADDED} | {name: value for name, value in vars(buffers).items() if isinstance(value, BufferStruct)}
TEXELS = {name: value for name, value in vars(buffers).items() if isinstance(value, TexelRecord)}


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    context = headless_context()
    yield context
    context.release()


def numbers(dtype: np.dtype, count: int) -> np.ndarray:
    """Rows whose numbers are all different, and small enough for any type."""
    rows, number = np.zeros(count, dtype), 0
    for name in dtype.names or ():
        size = rows[name].size
        rows[name] = np.arange(number, number + size).reshape(rows[name].shape)
        number += size
    return rows


@pytest.mark.parametrize("block", ["buffer", "uniform"])
@pytest.mark.parametrize("name", STRUCTS)
def test_a_shader_reads_each_field_of_a_struct_where_python_wrote_it(context, name, block):
    struct = STRUCTS[name]
    glsl_name = struct.glsl.split()[1]
    fields = {key: struct.dtype[key] for key in struct.dtype.names or ()}
    parts = [
        f"float(rows[i].{key}{element}{component})"
        for key, field in fields.items()
        for element in ([f"[{k}]" for k in range(field.shape[0])] if len(field.shape) == 2 else [""])
        for component in ([f".{'xyzw'[c]}" for c in range(field.shape[-1])] if field.shape else [""])
    ]
    qualifier = "buffer" if block == "buffer" else "uniform"
    size = "" if block == "buffer" else "3"
    binding = 1 if block == "buffer" else 0
    writes = "".join(f"        found[{len(parts)} * i + {k}] = {part};\n" for k, part in enumerate(parts))
    program = context.compute_shader(
        f"#version 430\nlayout(local_size_x = 1) in;\n{struct.glsl}"
        f"layout(std140, binding = {binding}) {qualifier} Rows {{ {glsl_name} rows[{size}]; }};\n"
        "layout(std430, binding = 2) buffer Found { float found[]; };\n"
        f"void main() {{\n    for (int i = 0; i < 3; ++i) {{\n{writes}    }}\n}}\n"
    )
    rows = numbers(struct.dtype, 3)
    given, found = context.buffer(rows.tobytes()), context.buffer(reserve=4 * 3 * len(parts))
    if block == "buffer":
        given.bind_to_storage_buffer(1)
    else:
        given.bind_to_uniform_block(0)
    found.bind_to_storage_buffer(2)
    program.run()
    wanted = [[value for key in fields for value in np.ravel(row[key])] for row in rows]
    assert np.frombuffer(found.read(), np.float32).reshape(3, -1).tolist() == wanted
    for resource in (program, given, found):
        resource.release()


def test_padding_is_that_of_std140():
    # OpenGL 4.3, section 7.6.2.2: the offsets by hand
    fields = PADDED.dtype.fields
    assert fields is not None
    assert [offset for _, offset, *_ in fields.values()] == [0, 12, 16, 32, 40, 48, 56, 64, 112, 128, 144, 156]
    assert PADDED.dtype.itemsize == 160


def test_arrays_that_std140_would_pad_are_refused():
    with pytest.raises(ValueError, match=r"Weights\.w: arrays in buffers are of vec4"):
        buffer_struct("Weights", {"w": Member("float", length=4)})


@pytest.mark.parametrize("name", TEXELS)
def test_a_texel_packed_by_a_shader_is_the_record_that_python_reads(context, name):
    record = TEXELS[name]
    glsl_name = name.lower()
    fields = {key: record.dtype[key] for key in record.dtype.names or ()}
    wanted = numbers(record.dtype, 1)
    vector = {1: "float", 2: "vec2", 3: "vec3", 4: "vec4"}
    arguments = ", ".join(f"{vector[np.size(wanted[key])]}({', '.join(map(str, np.ravel(wanted[key])))})" for key in fields)
    unpacked = "".join(f", texel.{key}" for key in fields)
    screen = "#version 430\nvoid main() { gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1); }"
    target = context.texture((1, 1), record.components, dtype="f4")
    frame = context.framebuffer([target])
    kind = vector[record.components]
    packs = context.program(
        screen, fragment_shader=f"#version 430\n{record.glsl}out {kind} made;\nvoid main() {{ made = {glsl_name}_texel({arguments}); }}"
    )
    frame.use()
    context.vertex_array(packs, []).render(moderngl.TRIANGLES, vertices=3)
    assert np.frombuffer(frame.read(components=record.components, dtype="f4"), record.dtype) == wanted

    # And fetched again, field by field.
    again = context.framebuffer([context.texture((1, 1), record.components, dtype="f4")])
    body = f"{''.join(part.capitalize() for part in glsl_name.split('_'))} texel = {glsl_name}_at(ivec2(0));"
    fetches = context.program(
        screen, fragment_shader=f"#version 430\n{record.glsl}out {kind} made;\nvoid main() {{ {body} made = {kind}({unpacked[2:]}); }}"
    )
    target.use(0)
    fetches[glsl_name] = 0
    again.use()
    context.vertex_array(fetches, []).render(moderngl.TRIANGLES, vertices=3)
    assert again.read(components=record.components, dtype="f4") == frame.read(components=record.components, dtype="f4")


def test_a_texel_holds_four_numbers_at_most():
    with pytest.raises(KeyError):
        texel_record("five", {"a": Member("vec3"), "b": Member("vec2")})
    assert SURFACE_DIFFUSE.components == 4


def test_a_program_reads_its_attributes_and_skips_the_others(context):
    rows = numbers(SCENE_VERTEX.dtype, 2)
    program = context.program(
        f"#version 430\n{SCENE_VERTEX.glsl}out vec4 colour;\nout vec2 place;\nvoid main() {{ colour = vertex_colour; place = uv; }}",
        varyings=["colour", "place"],
    )
    found = context.buffer(reserve=2 * 24)
    array = context.vertex_array(program, [SCENE_VERTEX.content(context.buffer(rows.tobytes()), program)])
    array.transform(found, moderngl.POINTS, vertices=2)
    wanted = np.concatenate([rows["vertex_colour"].astype(np.float32), rows["uv"]], axis=1)
    assert np.array_equal(np.frombuffer(found.read(), np.float32).reshape(2, 6), wanted)


def test_constants_are_the_same_in_glsl(context):
    names = ("GUTTER", "MATERIAL_GGX", "MATERIAL_SHADOW_CATCHER", "HASHED_ALPHA", "SRGB_SLOPE", "LUMINANCE_WEIGHTS.y", "TEXTURE_NORMAL")
    writes = "".join(f"    found[{k}] = {name};\n" for k, name in enumerate(names))
    program = context.compute_shader(
        f"#version 430\n{constants_glsl()}layout(local_size_x = 1) in;\nlayout(std430, binding = 1) buffer Found {{ float found[]; }};\n"
        f"void main() {{\n{writes}}}\n"
    )
    found = context.buffer(reserve=4 * len(names))
    found.bind_to_storage_buffer(1)
    program.run()
    wanted = np.array([GUTTER, MaterialKind.GGX, MaterialKind.SHADOW_CATCHER, -1, 12.92, 0.7152, 2], np.float32)
    assert np.array_equal(np.frombuffer(found.read(), np.float32), wanted)


def test_each_kind_of_material_in_each_region_has_a_class_of_its_own():
    # The class MATERIAL_KINDS * region + kind is stored as a depth: (class + 1/2) / CLASSES, exact in 24 bits.
    classes = np.array([MATERIAL_KINDS * region + kind for region in range(256) for kind in MaterialKind])
    assert len(np.unique(classes)) == len(classes)
    depths = np.rint((classes + 0.5) / CLASSES * 2**24)
    assert np.array_equal(depths / 2**24, (classes + 0.5) / CLASSES)
    assert 0 < depths.min() < depths.max() < 2**24
