"""Materials: Lambert with normalised Phong, GGX as glTF 2.0 has it, and surfaces that no light changes."""

from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.renderer.gl.constants import MaterialKind
from vemlight.renderer.scene.textures import Texture

Fraction = Annotated[float, Meta(ge=0, le=1)]
Colour = tuple[Fraction, Fraction, Fraction]


class AlphaTest(NamedTuple):
    """Where a surface can be seen through: by alpha, times the fourth channel of the image, times that of the vertices' colours.

    cutoff: a product below it is a hole, any other opaque (glTF's MASK). None: the product is the surface's coverage (BLEND), drawn by
    hashed alpha (Wyman and McGuire 2017).
    """

    alpha: float = 1.0
    cutoff: float | None = None
    image: Texture | None = None


class Phong(NamedTuple):
    """Lambert and normalised Phong: diffuse / pi + specular (n + 2) / (2 pi) cos^n(angle between mirrored light and view).

    colour_map: times diffuse.
    """

    diffuse: Colour = (0.5, 0.5, 0.5)
    specular: Colour = (0.0, 0.0, 0.0)
    exponent: float = 40.0
    colour_map: Texture | None = None


class Ggx(NamedTuple):
    """Metallic-roughness of glTF 2.0, appendix B.

    colour_map: times base_color. metallic_roughness_map: two channels, times metallic and roughness. normal_map: normals in the frame of
    the texture coordinates, -1 .. 1 coded as 0 .. 1. reflectance: of a dielectric at normal incidence. emission: radiance, in the unit of
    the light around. emission_map: times emission.
    """

    base_color: Colour
    metallic: float = 0.0
    roughness: float = 0.5
    colour_map: Texture | None = None
    metallic_roughness_map: Texture | None = None
    normal_map: Texture | None = None
    reflectance: float = 0.04  # of refractive index 1.5
    emission: Colour = (0.0, 0.0, 0.0)
    emission_map: Texture | None = None
    alpha_test: AlphaTest | None = None


class SpecularGlossiness(NamedTuple):
    """Specular-glossiness of glTF (KHR_materials_pbrSpecularGlossiness), the model before metallic-roughness.

    specular_glossiness_map: its colour times specular, its fourth channel times glossiness. All else as in Ggx.
    """

    diffuse: Colour
    specular: Colour = (1.0, 1.0, 1.0)
    glossiness: float = 1.0
    colour_map: Texture | None = None
    specular_glossiness_map: Texture | None = None
    normal_map: Texture | None = None
    emission: Colour = (0.0, 0.0, 0.0)
    emission_map: Texture | None = None
    alpha_test: AlphaTest | None = None


class Unlit(NamedTuple):
    """A surface that no light changes (KHR_materials_unlit): its colour is the radiance that leaves it."""

    base_color: Colour
    colour_map: Texture | None = None
    alpha_test: AlphaTest | None = None


class ShadowCatcher(NamedTuple):
    """A real ground, already in the plate: only the fraction of light that the scene's shadows take from it is drawn."""


Material = Phong | Ggx | SpecularGlossiness | Unlit | ShadowCatcher


def material_kind(material: Material) -> MaterialKind:
    """The reflection model that shades a material. An unlit one reflects nothing, which Lambert does at the least cost."""
    match material:
        case Phong():
            return MaterialKind.PHONG if any(material.specular) else MaterialKind.LAMBERT
        case Ggx() | SpecularGlossiness():
            return MaterialKind.GGX
        case Unlit():
            return MaterialKind.LAMBERT
        case ShadowCatcher():
            return MaterialKind.SHADOW_CATCHER


def alpha_test_of(material: Material) -> AlphaTest | None:
    """A material's alpha test; None for an opaque one."""
    return getattr(material, "alpha_test", None)


def emits(material: Material) -> bool:
    """Whether a material emits radiance of its own."""
    return isinstance(material, Unlit) or any(getattr(material, "emission", ()))


class MaterialTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`material = {...}` of a scene file: keys of one kind, or catcher = true."""

    diffuse: Colour | None = None
    specular: Colour | None = None
    exponent: Annotated[float, Meta(ge=0, le=1e5)] | None = None
    base_color: Colour | None = None
    metallic: Fraction | None = None
    roughness: Fraction | None = None
    catcher: bool = False


def material_from_table(table: MaterialTable) -> Material:
    """The material of a scene file's keys. Raises ValueError for keys of two kinds, and for Phong that reflects more than it receives."""
    if table.catcher:
        if table != MaterialTable(catcher=True):
            raise ValueError("a catcher has no colour; leave the other keys of its material out")
        return ShadowCatcher()
    phong = {key: value for key in ("diffuse", "specular", "exponent") if (value := getattr(table, key)) is not None}
    ggx = {key: value for key in ("metallic", "roughness") if (value := getattr(table, key)) is not None}
    if table.base_color is not None and not phong:
        return Ggx(table.base_color, **ggx)
    if table.base_color is not None or ggx:
        raise ValueError("material has either diffuse, specular and exponent, or base_color, metallic and roughness; leave one kind out")
    made = Phong(**phong)
    total = max(np.add(made.diffuse, made.specular))
    if total > 1:  # decimal fractions that add up to 1 do so as floats, too: all of up to six digits were tried
        raise ValueError(f"diffuse + specular reflects {total:.4g} of the light; keep the sum at 1 or below")
    return made
