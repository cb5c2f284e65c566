"""What surfaces are made of: Lambert with normalised Phong, or GGX as glTF has it, and the images on them."""

from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

Fraction = Annotated[float, Meta(ge=0, le=1)]
Colour = tuple[Fraction, Fraction, Fraction]
MOST_TEXELS = 4096  # on a side of an image; larger ones are reduced, since a picture is seldom larger and every GL 4.3 takes it


class Phong(NamedTuple):
    """diffuse / pi + specular (n + 2) / (2 pi) cos^n(angle between mirrored light and view); image (h, w, 3) float16 times diffuse."""

    diffuse: Colour = (0.5, 0.5, 0.5)
    specular: Colour = (0.0, 0.0, 0.0)
    exponent: float = 40.0
    image: np.ndarray | None = None


class Ggx(NamedTuple):
    """glTF 2.0's metallic-roughness. image (h, w, 3) float16, linear, times base_color; metal_rough (h, w, 2) times the two numbers.

    bumps (h, w, 3): the normal in the frame of the texture coordinates, from -1 .. 1 to 0 .. 1.
    """

    base_color: Colour
    metallic: float = 0.0
    roughness: float = 0.5
    image: np.ndarray | None = None
    metal_rough: np.ndarray | None = None
    bumps: np.ndarray | None = None


class Catcher(NamedTuple):
    """A real ground that is in the plate already: it shows only the share of light that the scene's shadows take from it."""


Material = Phong | Ggx | Catcher
KINDS = 4  # the shaders know surfaces of Lambert alone, of Lambert and Phong, of GGX, and catchers of shadows
GLOSSY = frozenset({1, 2})
CATCHER = 3


def kind_of(material: Material) -> int:
    """Which of the KINDS a material is."""
    if isinstance(material, Phong):
        return int(any(value > 0 for value in material.specular))
    return 2 if isinstance(material, Ggx) else CATCHER


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
        return Catcher()
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
    """The material that a mesh file gives a mesh, as trimesh read it, and its texture coordinates (n, 2), v upwards.

    None stands for what the file does not say.
    """
    found = getattr(visual, "material", None)
    uv = getattr(visual, "uv", None)
    uv = None if uv is None or len(uv) == 0 or not np.all(np.isfinite(uv)) else np.asarray(uv, np.float32)
    if found is None:
        return None, None
    if hasattr(found, "baseColorFactor"):
        base = _factor(found.baseColorFactor)  # linear, as glTF stores it
        numbers = (found.metallicFactor, found.roughnessFactor)
        metallic, roughness = (1.0 if value is None else float(np.clip(value, 0, 1)) for value in numbers)
        both = found.metallicRoughnessTexture
        rough = None if both is None else np.ascontiguousarray(_texels(both, linear=True)[..., [2, 1]])  # blue, green
        bumps = None if found.normalTexture is None else _texels(found.normalTexture, linear=True)
        return Ggx(base, metallic, roughness, _colours(found.baseColorTexture), rough, bumps), uv
    if _stands_in(getattr(found, "image", None)):
        return None, None
    image = _colours(getattr(found, "image", None))
    diffuse = (1.0, 1.0, 1.0) if image is not None else _factor(getattr(found, "diffuse", None), coded=True)
    return Phong(diffuse, image=image), uv


def colours_from_visual(visual: Any, linear: bool) -> np.ndarray | None:
    """The colours (n, 3) float32, linear, that a mesh file gives its vertices; None where it gives none that can be used.

    linear: whether the file stores them so, as glTF does, or sRGB-coded.
    """
    found = getattr(visual, "vertex_attributes", {}).get("color")
    if found is None and getattr(visual, "kind", None) == "vertex":
        found = visual.vertex_colors
    if found is None or found.ndim != 2 or found.shape[1] < 3:
        return None
    colours = found[:, :3] / (np.iinfo(found.dtype).max if found.dtype.kind in "iu" else 1.0)
    if not np.all(np.isfinite(colours)):
        return None
    colours = np.clip(colours, 0, 1)
    return (colours if linear else _linear(colours)).astype(np.float32)


def _stands_in(image: Any) -> bool:
    """Whether this is the plain 2 x 2 image that trimesh puts where an OBJ has texture coordinates but no material."""
    return image is not None and image.size == (2, 2) and len(np.unique(np.asarray(image).reshape(4, -1), axis=0)) == 1


def _factor(value: Any, coded: bool = False) -> Colour:
    """A colour factor in 0 .. 1 or 0 .. 255, linear or sRGB-coded; white when absent."""
    if value is None:
        return (1.0, 1.0, 1.0)
    rgb = np.asarray(value)[:3]
    rgb = np.clip(rgb / 255.0 if rgb.dtype.kind in "iu" else rgb.astype(np.float64), 0, 1)
    red, green, blue = (_linear(rgb) if coded else rgb).tolist()
    return (red, green, blue)


def _colours(image: Any) -> np.ndarray | None:
    return None if image is None else _texels(image, linear=False)


def plate_pixels(image: Any) -> np.ndarray:
    """A PIL image of a place, (h, w, 3) float16, linear, the first row on top."""
    return np.ascontiguousarray(_texels(image, linear=False)[::-1])


def _texels(image: Any, linear: bool) -> np.ndarray:
    """A PIL image as (h, w, 3) float16, the first row at the bottom as OpenGL has it, decoded from sRGB unless `linear`."""
    image = image.convert("RGB")
    if max(image.size) > MOST_TEXELS:
        image.thumbnail((MOST_TEXELS, MOST_TEXELS))
    table = np.arange(256) / 255
    table = (table if linear else _linear(table)).astype(np.float16)
    return np.ascontiguousarray(table[np.asarray(image)[::-1]])


def _linear(coded: np.ndarray) -> np.ndarray:
    """Linear values of sRGB-coded ones (IEC 61966-2-1)."""
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
