"""The GL context and the shader programs, from the files in shaders/. A failure is one BadInput line."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import moderngl

from services.files import BadInput, Failed

SHADERS = Path(__file__).parent / "shaders"
GL_VERSION = 430  # uniform blocks, instancing, gathers and, for the speed of a software renderer, nothing newer

Made = TypeVar("Made", moderngl.Program, moderngl.ComputeShader)


def headless_context() -> moderngl.Context:
    """A GL context of version 4.3 or later without a window, through EGL. Raises BadInput when the machine gives none."""
    try:
        return moderngl.create_context(require=GL_VERSION, standalone=True, backend="egl")  # pyright: ignore[reportArgumentType]
    except Exception as error:  # glcontext raises bare Exceptions, ImportErrors and OSErrors by the library that fails
        reason = " ".join(str(error).split())[:160]
        raise BadInput(
            f"no OpenGL 4.3 through EGL ({reason}); install it: apt-get install libegl1 libgl1 libgl1-mesa-dri"
        ) from error


def context_info(context: moderngl.Context) -> str:
    """GL renderer and version in one line."""
    return f"{context.info['GL_RENDERER']}, OpenGL {context.info['GL_VERSION']}"


def check_context(context: moderngl.Context) -> None:
    """Raises BadInput when the GPU's memory was not enough for what was asked since the last check, Failed when the context is lost."""
    error = context.error
    if error == "GL_OUT_OF_MEMORY":
        wanted = "[renderer] width, height, shadow_map"
        raise BadInput(f"{wanted}: {context_info(context)} has no memory for them; make them smaller, or textures and luminaires")
    if error != "GL_NO_ERROR":
        raise Failed(f"OpenGL stopped working ({error}, {context_info(context)}): the card was reset or its driver failed; start again")


class Programs:
    """Compiles programs once each and releases them together."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._made: list[moderngl.Program | moderngl.ComputeShader] = []
        for path in SHADERS.glob("*.glsl"):
            context.includes[path.name] = path.read_text()

    def program(self, vertex: str, fragment: str, **constants: str) -> moderngl.Program:
        """The program of two files in shaders/; each NAME in them is replaced by its value in `constants`.

        Raises BadInput with the compiler's first complaint, the files and the GL renderer.
        """
        source = [self._source(name, constants) for name in (vertex, fragment)]
        return self._compiled(f"{vertex} + {fragment}", lambda: self._context.program(vertex_shader=source[0], fragment_shader=source[1]))

    def compute(self, name: str, **constants: str) -> moderngl.ComputeShader:
        """The compute shader in a file of shaders/, as `program`."""
        source = self._source(name, constants)
        return self._compiled(name, lambda: self._context.compute_shader(source))

    def _source(self, name: str, constants: dict[str, str]) -> str:
        """The file with its constants defined after its first line, which is #version."""
        defined = "".join(f"#define {constant} {value}\n" for constant, value in constants.items())
        return (SHADERS / name).read_text().replace("\n", "\n" + defined, 1)

    def _compiled(self, name: str, compiled: Callable[[], Made]) -> Made:
        try:
            made = compiled()
        except moderngl.Error as error:
            lines = [line for line in str(error).splitlines() if "error" in line.lower()] or [str(error)]
            raise BadInput(f"{name}: {lines[-1].strip()[:200]} ({context_info(self._context)}); update the GL driver") from error
        self._made.append(made)
        return made

    def release(self) -> None:
        """Frees all programs made here."""
        for program in self._made:
            program.release()
        self._made.clear()
