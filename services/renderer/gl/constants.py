"""Numbers that Python and the shaders share: declared here, and in GLSL by the generated include `constants.glsl`."""

from enum import IntEnum

from vemlight.light import colour, near_lights


class MaterialKind(IntEnum):
    """How a surface reflects light. The G-buffer stores the number, the classes of pixels are made of it, and shaders know it as
    MATERIAL_LAMBERT and so on."""

    LAMBERT = 0
    PHONG = 1  # Lambert and a normalised Phong lobe
    GGX = 2  # glTF 2.0's
    SHADOW_CATCHER = 3  # black, with what shadows take from it as its matte


class MaterialTexture(IntEnum):
    """The textures of a material, each on the texture unit of its number; shaders know TEXTURE_COLOUR and so on."""

    COLOUR = 0
    PARAMETER = 1  # metallic and roughness, or specular and glossiness
    NORMAL = 2
    EMISSIVE = 3


GLOSSY_KINDS = frozenset({MaterialKind.PHONG, MaterialKind.GGX})
MATERIAL_KINDS = len(MaterialKind)

MAX_LIGHTS = 512  # of a batch: 128 bytes each, 64 kB of a uniform block, as much as GL drivers in use allow
NEAR_BATCH = 256  # near lights that are drawn together: 32 bytes each, 8 kB of a uniform block; as many as a frame has
WORK_GROUP = 64  # lights that a work group of light_frames.comp makes; any multiple of 32 does
CLASSES = 1024  # of pixels, by kind of material and light region: 4 x 256; (class + 1/2) / CLASSES is exact in 24 bits of depth
GUTTER = 2  # texels at a shadow map's rim that stay empty, so that a filtered lookup of 2 x 2 texels sees no neighbouring map
FARTHEST_DEPTH = 0.99  # where casters end, so that only an empty texel holds 1; any value in 0.9 to 0.999 does
SHADOW_BIAS_TEXELS = 1.0  # how far a surface may rise above its tangent plane within a texel, and by how much casters are simplified
MIN_DISTANCE_M = near_lights.MIN_DISTANCE_M  # from a near light: within it irradiance grows no further
# Of perspective shadow maps.
NEAR_FRACTION = 1e-3  # of the far plane, or of how far meshes reach: a step of 1 / z in 24 bits is then 6e-5 of the distance
CUBE_TANGENT = 1.05  # of a cube's face: the margin beyond 1 is a texel from 42 texels a side on, so that lookups filter across edges
NORMAL_CODES = 32767  # codes of 16 bits on each side of 0, which is a code itself: the axes stay exact
HASHED_ALPHA = -1.0  # in place of an alpha test's cutoff: alpha is a coverage and hashed
MIN_ROUGHNESS = 0.05  # a directional light in a smoother surface is a highlight smaller than a pixel
MAX_HALF = 65504.0  # the largest half float
MAX_RADIANCE = 1e30  # in place of infinity: its products stay finite in float32; any value in 1e20 to 1e35 does


def constants_glsl() -> str:
    """All of the above and those of vemlight.light.colour as preprocessor definitions, which `#if` can compare too."""
    own = {name: value for name, value in globals().items() if name.isupper() and isinstance(value, int | float)}
    srgb = {name: value for name, value in vars(colour).items() if name.startswith("SRGB_")}
    kinds = {f"MATERIAL_{kind.name}": kind.value for kind in MaterialKind}
    textures = {f"TEXTURE_{texture.name}": texture.value for texture in MaterialTexture}
    weights = ", ".join(map(repr, colour.LUMINANCE_WEIGHTS.tolist()))
    numbers = "".join(f"#define {name} {value!r}\n" for name, value in (own | srgb | kinds | textures).items())
    return f"{numbers}#define LUMINANCE_WEIGHTS vec3({weights})\n"
