"""Counts the objects of a GL context, for tests and benches that look for leaks."""

import ctypes

import moderngl


def gl_objects(context: moderngl.Context) -> tuple[int, ...]:
    """The numbers of buffers, textures, framebuffers and programs, by asking for each name that was ever given."""
    library = ctypes.CDLL("libGL.so.1")
    exists = (library.glIsBuffer, library.glIsTexture, library.glIsFramebuffer, library.glIsProgram)
    with context:
        buffer, texture = context.buffer(reserve=16), context.texture((1, 1), 4)
        frame = context.framebuffer([texture])
        program = context.program(vertex_shader="#version 430\nvoid main() { gl_Position = vec4(0.0); }")
        newest = [int(made.glo) for made in (buffer, texture, frame, program)]
        for made in (program, frame, texture, buffer):
            made.release()
        return tuple(sum(bool(exist(name)) for name in range(1, last)) for exist, last in zip(exists, newest, strict=True))
