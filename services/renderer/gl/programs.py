"""The GL context and the shader programs, made of the files in each pass's folder. Failures are UserErrors of one line."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import moderngl

from vemlight.errors import FatalError, UserError
from vemlight.files import group_hint, may_open
from vemlight.renderer.gl.buffers import INCLUDES

PASSES = Path(__file__).parents[1] / "passes"  # each folder has its pass's shaders; their names are unique
SHADERS = {path.name: path for path in sorted(PASSES.glob("*/*")) if path.suffix in (".glsl", ".vert", ".frag", ".comp")}
GL_VERSION = 430  # uniform blocks, instancing, gathers and, for the speed of a software renderer, nothing newer

MAX_DEVICES = 16  # a machine has one for each card and one for the processor; any value from 8 on does
NOT_THE_DEVICE = ("requested device index", "not loaded", "not found")  # glcontext's messages after which no other device can do better
# Read by the GL libraries and by glcontext; each can name something that is not there.
GL_VARIABLES = (
    "GLCONTEXT_DEVICE_INDEX", "GLCONTEXT_LINUX_LIBEGL", "GLCONTEXT_LINUX_LIBGL", "LIBGL_DRIVERS_PATH", "MESA_GL_VERSION_OVERRIDE",
    "__EGL_VENDOR_LIBRARY_DIRS", "__EGL_VENDOR_LIBRARY_FILENAMES",
)  # fmt: skip

SOFTWARE = ("llvmpipe", "softpipe", "swrast", "swiftshader")  # in the GL_RENDERER of those that draw on the processor
QUIET = {"EGL_LOG_LEVEL": "fatal", "LIBGL_DEBUG": "quiet"}  # Mesa would print in lines of its own what the one line of ours says

AnyProgram = TypeVar("AnyProgram", moderngl.Program, moderngl.ComputeShader)


class OpenedContext(NamedTuple):
    """A GL context, what gave it, and why what was tried before gave none."""

    context: moderngl.Context
    through: str
    refused: list[str]


def headless_context() -> moderngl.Context:
    """A GL context of version 4.3 or later without a window. Raises UserError when the machine gives none."""
    return open_context().context


def open_context() -> OpenedContext:
    """The context of the first of EGL's devices that gives one, else of the X server that DISPLAY names.

    EGL needs no display and lists the graphics cards first, the processor last. Raises UserError with all reasons and a hint.
    """
    os.environ.update({name: level for name, level in QUIET.items() if name not in os.environ})
    refused: list[str] = []
    chosen = "GLCONTEXT_DEVICE_INDEX" in os.environ  # glcontext then takes that one whichever is asked for
    for device in range(1 if chosen else MAX_DEVICES):
        if context := _context(refused, f"EGL device {device}", backend="egl", device_index=device):
            return OpenedContext(context, "EGL", refused)
        if any(words in refused[-1] for words in NOT_THE_DEVICE):
            last = refused.pop()
            if not device:  # else there are no more devices, and the reasons of all are known
                refused.append(last.replace("EGL device 0", "EGL"))
            break
    display = os.environ.get("DISPLAY")
    if display and (context := _context(refused, f"X server {display}")):
        return OpenedContext(context, f"the X server {display}", refused)
    raise UserError(f"no OpenGL 4.3 ({'; '.join(refused)}); {_hint(refused)}")


def _context(refused: list[str], name: str, **settings: Any) -> moderngl.Context | None:
    try:
        return moderngl.create_context(require=GL_VERSION, standalone=True, **settings)
    except Exception as error:  # glcontext raises bare Exceptions, ImportErrors and OSErrors by the library that fails
        refused.append(f"{name}: {' '.join(str(error).split())[:120]}")
        return None


def _hint(refused: list[str]) -> str:
    if astray := [name for name in GL_VARIABLES if name in os.environ]:
        return f"unset {' '.join(astray)}, which the GL libraries follow"
    if closed := closed_cards():
        return f"let this user open {closed[0]}: {group_hint(closed[0])}"
    if any("eglCreateContext" in reason or "version" in reason for reason in refused):  # there is a driver, which cannot
        return "update the driver of the graphics card, or draw on the processor: LIBGL_ALWAYS_SOFTWARE=1"
    return "install it: apt-get install libegl1 libgl1 libgl1-mesa-dri"


def closed_cards() -> list[Path]:
    """The graphics cards of this machine that this user may not open."""
    return [path for path in sorted(Path("/dev/dri").glob("renderD*")) if not may_open(path)]


def context_info(context: moderngl.Context) -> str:
    """GL renderer and version in one line."""
    return f"{context.info['GL_RENDERER']}, OpenGL {context.info['GL_VERSION']}"


def draws_on_processor(context: moderngl.Context) -> bool:
    """Whether this GL is a software renderer."""
    return any(name in context.info["GL_RENDERER"].lower() for name in SOFTWARE)


def check_context(context: moderngl.Context) -> None:
    """Raises UserError when the GPU ran out of memory since the last check, FatalError when the context is lost."""
    error = context.error
    if error == "GL_OUT_OF_MEMORY":
        wanted = "[renderer] width, height, shadow_map"
        raise UserError(f"{wanted}: {context_info(context)} has no memory for them; make them smaller, or textures and luminaires")
    if error != "GL_NO_ERROR":
        raise FatalError(f"OpenGL stopped working ({error}, {context_info(context)}): the card was reset or its driver failed; start again")


class Programs:
    """Compiles programs, and releases them together."""

    def __init__(self, context: moderngl.Context) -> None:
        self._context = context
        self._compiled_programs: list[moderngl.Program | moderngl.ComputeShader] = []
        context.includes.update(INCLUDES)
        context.includes.update({name: path.read_text() for name, path in SHADERS.items() if path.suffix == ".glsl"})

    def program(self, vertex: str, fragment: str, **constants: str | int) -> moderngl.Program:
        """The program of two shader files; each NAME in them stands for its value in `constants`.

        Raises UserError with the compiler's first complaint, the files and the GL renderer.
        """
        source = [self._source(name, constants) for name in (vertex, fragment)]
        return self._compiled(f"{vertex} + {fragment}", lambda: self._context.program(vertex_shader=source[0], fragment_shader=source[1]))

    def compute(self, name: str, **constants: str | int) -> moderngl.ComputeShader:
        """The compute shader in a file, as `program`."""
        source = self._source(name, constants)
        return self._compiled(name, lambda: self._context.compute_shader(source))

    def _source(self, name: str, constants: Mapping[str, str | int]) -> str:
        """The file with its constants defined after its first line, which is #version."""
        defined = "".join(f"#define {constant} {value}\n" for constant, value in constants.items())
        return SHADERS[name].read_text().replace("\n", "\n" + defined, 1)

    def _compiled(self, name: str, compiled: Callable[[], AnyProgram]) -> AnyProgram:
        try:
            program = compiled()
        except moderngl.Error as error:
            lines = [line for line in str(error).splitlines() if "error" in line.lower()] or [str(error)]
            raise UserError(f"{name}: {lines[-1].strip()[:200]} ({context_info(self._context)}); update the GL driver") from error
        self._compiled_programs.append(program)
        return program

    def release(self) -> None:
        """Frees all programs that it compiled."""
        for program in self._compiled_programs:
            program.release()
        self._compiled_programs.clear()
