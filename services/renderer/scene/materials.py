"""What surfaces are made of: Lambert with normalised Phong, or GGX as glTF has it, and the images on them."""

from enum import IntEnum
from typing import Annotated, Any, NamedTuple

import cv2
import msgspec
import numpy as np
from msgspec import Meta

from vemlight.light.colour import linear_from_srgb

Fraction = Annotated[float, Meta(ge=0, le=1)]
Colour = tuple[Fraction, Fraction, Fraction]
HASHED_ALPHA = -1.0  # for the shaders, in place of a cutoff
LINEAR, LINEAR_MIPMAP_LINEAR = 0x2601, 0x2703  # OpenGL's numbers
MAX_TEXTURE_SIDE = 4096  # on a side of an image; larger ones are reduced, since a picture is seldom larger and every GL 4.3 takes it


class Texture(NamedTuple):
    """An image on a surface. texels: (h, w, c) float16, linear, the first row at the bottom.

    repeats: whether it goes on across and up, or keeps its edge. filters: OpenGL's numbers, for smaller and for larger than its texels.
    uv_set: which set of texture coordinates, 0 or 1. uv_transform: (2, 3) float64, v upwards, from those to the image's; None: identity.
    """

    texels: np.ndarray
    repeats: tuple[bool, bool] = (True, True)
    filters: tuple[int, int] = (LINEAR_MIPMAP_LINEAR, LINEAR)
    uv_set: int = 0
    uv_transform: np.ndarray | None = None


class AlphaTest(NamedTuple):
    """Where a surface lets see and light through: by alpha times the fourth channel of its image times its vertices' alpha.

    cutoff: what is below is not there, all else is opaque; None: that product is the share of the surface that is there.
    """

    alpha: float = 1.0
    cutoff: float | None = None
    image: Texture | None = None


class Phong(NamedTuple):
    """diffuse / pi + specular (n + 2) / (2 pi) cos^n(angle between mirrored light and view); colour_map: times diffuse."""

    diffuse: Colour = (0.5, 0.5, 0.5)
    specular: Colour = (0.0, 0.0, 0.0)
    exponent: float = 40.0
    colour_map: Texture | None = None


class Ggx(NamedTuple):
    """glTF 2.0's metallic-roughness. colour_map: times base_color; metallic_roughness_map, two channels: times the two numbers.

    normal_map: the normal in the frame of the texture coordinates, from -1 .. 1 to 0 .. 1. reflectance: head-on, of what is no metal.
    emission: radiance in the unit of the light's, times its image.
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
    """glTF's older model (KHR_materials_pbrSpecularGlossiness).

    specular_glossiness_map: its colour times specular, its fourth channel times glossiness. The rest as in Ggx.
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
    """A surface that looks the same in any light (KHR_materials_unlit): its colour is the radiance that leaves it."""

    base_color: Colour
    colour_map: Texture | None = None
    alpha_test: AlphaTest | None = None


class ShadowCatcher(NamedTuple):
    """A real ground that is in the plate already: it shows only the share of light that the scene's shadows take from it."""


Material = Phong | Ggx | SpecularGlossiness | Unlit | ShadowCatcher


class MaterialKind(IntEnum):
    """The reflection models that the shaders know. A G-buffer holds the number with each pixel."""

    LAMBERT = 0
    PHONG = 1  # and Lambert
    GGX = 2
    SHADOW_CATCHER = 3


GLOSSY_KINDS = frozenset({MaterialKind.PHONG, MaterialKind.GGX})


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
    """A material's holes; None when it has none."""
    return None if isinstance(material, Phong | ShadowCatcher) else material.alpha_test


def emits(material: Material) -> bool:
    """Whether radiance leaves a material that no light has brought there."""
    return isinstance(material, Unlit) or (isinstance(material, Ggx | SpecularGlossiness) and any(material.emission))


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
    """The material of a scene file's keys. Raises ValueError when they mix two kinds or reflect more than they receive."""
    if table.catcher:
        if table != MaterialTable(catcher=True):
            raise ValueError("a catcher has no colour; leave the other keys of its material out")
        return ShadowCatcher()
    phong = {key: value for key in ("diffuse", "specular", "exponent") if (value := getattr(table, key)) is not None}
    ggx = {key: value for key in ("metallic", "roughness") if (value := getattr(table, key)) is not None}
    if table.base_color is not None and not phong:
        return Ggx(table.base_color, **ggx)
    if table.base_color is not None or ggx:
        raise ValueError("material has either diffuse, specular and exponent, or base_color, metallic and roughness")
    made = Phong(**phong)
    total = max(np.add(made.diffuse, made.specular))
    if total > 1 + 1e-6:  # decimal fractions such as 0.7 + 0.3 do not add up to 1 exactly
        raise ValueError(f"diffuse + specular reflects {total:.4g} of the light; keep the sum at 1 or below")
    return made


def material_from_visual(visual: Any) -> tuple[Material | None, np.ndarray | None]:
    """The material that an OBJ, PLY or STL file gives a mesh, as trimesh read it, and its texture coordinates (n, 2), v upwards.

    None stands for what the file does not say.
    """
    found, uv = getattr(visual, "material", None), getattr(visual, "uv", None)
    uv = None if uv is None or len(uv) == 0 or not np.all(np.isfinite(uv)) else np.asarray(uv, np.float32)
    image = getattr(found, "image", None)
    if found is None or _stands_in(image):
        return None, None
    if image is not None:
        return Phong((1.0, 1.0, 1.0), colour_map=Texture(texels(image))), uv
    return Phong(_colour(getattr(found, "diffuse", None))), uv


def colours_from_visual(visual: Any) -> np.ndarray | None:
    """The colours (n, 4) float32, linear with alpha 1, that an OBJ, PLY or STL file gives its vertices; None where it gives none."""
    found = getattr(visual, "vertex_attributes", {}).get("color")
    if found is None and getattr(visual, "kind", None) == "vertex":
        found = visual.vertex_colors
    if found is None or found.ndim != 2 or found.shape[1] < 3:
        return None
    coded = found[:, :3] / (np.iinfo(found.dtype).max if found.dtype.kind in "iu" else 1.0)
    if not np.all(np.isfinite(coded)):
        return None
    colours = np.ones((len(coded), 4), np.float32)
    colours[:, :3] = linear_from_srgb(np.clip(coded, 0, 1))
    return colours


def _stands_in(image: Any) -> bool:
    """Whether this is the plain 2 x 2 image that trimesh puts where an OBJ has texture coordinates but no material."""
    return image is not None and image.size == (2, 2) and len(np.unique(np.asarray(image).reshape(4, -1), axis=0)) == 1


def _colour(value: Any) -> Colour:
    """A colour in 0 .. 1 or 0 .. 255, sRGB-coded; white when absent."""
    if value is None:
        return (1.0, 1.0, 1.0)
    rgb = np.asarray(value)[:3]
    red, green, blue = linear_from_srgb(np.clip(rgb / 255.0 if rgb.dtype.kind in "iu" else rgb.astype(np.float64), 0, 1)).tolist()
    return (red, green, blue)


def plate_pixels(image: Any) -> np.ndarray:
    """A PIL image of a place, (h, w, 3) float16, linear, the first row on top."""
    return np.ascontiguousarray(texels(image)[::-1])


def texels(image: Any, coded: bool = True, alpha: bool = False) -> np.ndarray:
    """A PIL image as (h, w, 3) float16, or 4 with its alpha, the first row at the bottom as OpenGL has it; from sRGB when `coded`."""
    image = image.convert("RGBA" if alpha else "RGB")
    if max(image.size) > MAX_TEXTURE_SIDE:
        image.thumbnail((MAX_TEXTURE_SIDE, MAX_TEXTURE_SIDE))
    codes, shares = np.asarray(image)[::-1], (np.arange(256) / 255).astype(np.float16)
    found = (linear_from_srgb(np.arange(256) / 255).astype(np.float16) if coded else shares)[codes]
    if alpha:
        found[..., 3] = shares[codes[..., 3]]
    return np.ascontiguousarray(found)


def alpha_bled(image: np.ndarray) -> np.ndarray:
    """An image (h, w, 4) float16 whose texels of alpha 0 have the colour of what lies around, so that filters mix in nothing hidden.

    Pull and push (Gortler et al. 1996): means over halved images, weighted with alpha, fill the finer ones.
    """
    whole = image.astype(np.float32)
    there = whole[..., 3] > 0
    if there.all() or not there.any():
        return image
    whole[..., :3] *= whole[..., 3:]
    pulled: list[np.ndarray] = [whole]
    while max(pulled[-1].shape[:2]) > 1:
        height, width = pulled[-1].shape[:2]
        pulled.append(np.asarray(cv2.resize(pulled[-1], ((width + 1) // 2, (height + 1) // 2), interpolation=cv2.INTER_AREA)))
    colours: np.ndarray = np.zeros((1, 1, 3), np.float32)
    for level in reversed(pulled[1:]):
        colours = np.array(cv2.resize(colours, level.shape[1::-1], interpolation=cv2.INTER_LINEAR))
        np.divide(level[..., :3], level[..., 3:], out=colours, where=level[..., 3:] > 0)
    filled = image.copy()
    filled[~there, :3] = np.asarray(cv2.resize(colours, there.shape[::-1], interpolation=cv2.INTER_LINEAR))[~there]
    return filled
