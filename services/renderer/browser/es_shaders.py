"""The renderer's own shaders in the browser's dialect, GLSL ES 3.00: one source, read differently in few places.

Where the dialects differ in what they can do, the files themselves say so under `#ifdef GL_ES`. Here is what a preprocessor cannot do:
files are included, lights are read from a texture instead of a uniform block (16 kB hold 128 of them) and shadow views of near lights
instead of a storage buffer, and whole numbers that stand for fractions become such.
"""

import re
from pathlib import Path

import numpy as np

from vemlight.renderer.gl.buffers import INCLUDES, LIGHT_FRAME, NEAR_SHADOW_VIEW
from vemlight.renderer.gl.constants import GUTTER, NORMAL_CODES
from vemlight.renderer.gl.programs import SHADERS
from vemlight.renderer.rays.mirror import MOST, ray_pattern
from vemlight.renderer.rays.soft_filter import REACH, SAME_PLANE
from vemlight.runtime.flat_scene import SURFEL_SIDE

BROWSER_SHADERS = (
    "surface.vert", "surface.frag", "shadow.vert", "shadow.frag", "shadow_alpha_test.frag", "screen.vert", "shade.frag", "emission.frag",
    "background.frag", "prefilter.frag", "gloss.frag", "tonemap.frag", "near_light_map.vert", "near_light_map.frag", "near_lights.frag",
    "mirror_rays.frag", "mirror_filter.frag", "mirrors.frag",
    "surfel_links.frag", "surfel_gather.frag", "surfel_bounce.frag",
)  # fmt: skip
# Those that no other dialect needs, where a processor follows the rays, lie beside this file.
FILES = SHADERS | {path.name: path for path in Path(__file__).parent.iterdir() if path.suffix in (".glsl", ".frag", ".vert")}
RAY_LIFT = 2e-4  # of the distance to the eye, by which rays begin off a surface that is seen from before it
HEAD = "#version 300 es\n"
PRECISION = "".join(f"precision highp {kind};\n" for kind in ("float", "int", "sampler2D", "sampler2DArray"))
AS_FRACTIONS = {"GUTTER": GUTTER, "NORMAL_CODES": NORMAL_CODES}  # whole numbers with which shaders reckon
LIGHT_TEXELS = LIGHT_FRAME.dtype.itemsize // 16  # of a light in the texture, one light a row
NEAR_VIEW_TEXELS = NEAR_SHADOW_VIEW.dtype.itemsize // 16  # likewise of a shadow view
SURFEL_RAYS = 32  # of each surfel: the four about a vertex have 128, twice the renderer's of a block of pixels
MOST_INSIDE = 0.25  # of a surfel's rays that meet the inner side of closed meshes; more: it lies within one. 0.1 to 0.5 would do
SURFEL_LAWS = (
    f"#define SURFEL_SIDE {SURFEL_SIDE}\n#define SURFEL_RAYS {SURFEL_RAYS}\n"
    f"const float SEES_SKY = -1.0, SEES_INSIDE = -2.0, MOST_INSIDE = {MOST_INSIDE!r};\n"
)
INCLUDE = re.compile(r'^#include "([\w.]+)"$', re.MULTILINE)
STORED_VIEWS = re.compile(r"layout\(std140, binding = \d\) readonly buffer \w+ \{ NearShadowView (\w+)\[\]; \};\n")
LIGHTS_BLOCK = "layout(std140) uniform Lights { LightFrame lights[MAX_LIGHTS]; };\n"


def browser_shaders() -> dict[str, str]:
    """Each of BROWSER_SHADERS with all that it includes, by name."""
    return {name: es_source(FILES[name].read_text()) for name in BROWSER_SHADERS}


def es_source(source: str) -> str:
    """A shader of the renderer as GLSL ES 3.00. Raises KeyError for an include that there is not."""
    files = INCLUDES | {"mirror_laws.glsl": mirror_laws(), "surfel_laws.glsl": SURFEL_LAWS}
    files |= {name: path.read_text() for name, path in FILES.items() if path.suffix == ".glsl"}
    while INCLUDE.search(source):
        source = INCLUDE.sub(lambda found: files[found[1]], source)
    for name, number in AS_FRACTIONS.items():
        source = source.replace(f"#define {name} {number}\n", f"#define {name} {number}.0\n")
    source = source.replace("layout(early_fragment_tests) in;\n", "").replace(LIGHTS_BLOCK, light_functions())
    for name in STORED_VIEWS.findall(source):
        source = STORED_VIEWS.sub(view_function(name), source, count=1)
        source = re.sub(rf"\b{name}\[([^\]]+)\]", rf"{name}_at(\1)", source)
    source = re.sub(r"\blights\[(\w+)\]\.(\w+)", r"light_\2(\1)", source)
    return HEAD + PRECISION + source.partition("\n")[2]


def mirror_laws() -> str:
    """The constants of rays/mirror.py: where in the lobe each pixel of 4 x 4 has its ray, and the filter over them."""
    points = ", ".join(f"vec2({u!r}, {turn!r})" for u, turn in ray_pattern(0, 1)[:, 0].tolist())
    numbers = {"MIRROR_MOST": MOST, "SAME_PLANE": SAME_PLANE, "RAY_LIFT": RAY_LIFT}
    constants = "".join(f"const float {name} = {float(value)!r};\n" for name, value in numbers.items())
    return f"const vec2 MIRROR_PATTERN[16] = vec2[]({points});\n{constants}const int FILTER_REACH = {REACH};\n"


def light_functions() -> str:
    """A function for each member of a light's frame, which fetches it from the row of its light: `light_direction(i)`."""
    lines = ["uniform highp sampler2D lights_texture;\n"]
    for name, kind, texel, part in _members(LIGHT_FRAME.dtype):
        lines.append(f"{kind} light_{name}(int i) {{ return texelFetch(lights_texture, ivec2({texel}, i), 0).{part}; }}\n")
    return "".join(lines)


def view_function(name: str) -> str:
    """A function `NAME_at(i)` that fetches a shadow view from row i of the texture `NAME_texture`."""
    texels = "".join(f"    vec4 t{k} = texelFetch({name}_texture, ivec2({k}, i), 0);\n" for k in range(NEAR_VIEW_TEXELS))
    members = ", ".join(f"t{texel}.{part}" for _, _, texel, part in _members(NEAR_SHADOW_VIEW.dtype))
    function = f"NearShadowView {name}_at(int i) {{\n{texels}    return NearShadowView({members});\n}}\n"
    return f"uniform highp sampler2D {name}_texture;\n{function}"


def _members(record: np.dtype) -> list[tuple[str, str, int, str]]:
    """Of each member its name, its type, in which texel of the row it lies, and which of that's components it is."""
    made = []
    for name in record.names or ():
        form, offset = record.fields[name][:2]  # type: ignore[index]
        count, first = form.itemsize // 4, offset % 16 // 4
        made.append((name, "float" if count == 1 else f"vec{count}", offset // 16, "xyzw"[first : first + count]))
    return made
