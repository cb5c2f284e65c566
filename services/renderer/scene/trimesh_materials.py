"""Materials and vertex colours of OBJ, PLY and STL files, as trimesh reads them."""

from typing import Any

import numpy as np

from vemlight.light.colour import linear_from_srgb
from vemlight.renderer.scene.materials import Colour, Material, Phong
from vemlight.renderer.scene.textures import Texture, texels_from_image


def material_from_visual(visual: Any, texels: dict[str, np.ndarray]) -> tuple[Material | None, np.ndarray | None]:
    """A mesh's material and its texture coordinates (n, 2) float32, v upwards; None for what the file does not say.

    An image replaces the diffuse colour. texels: those made already, by the names of their files, to which this one's are added.
    """
    found, uv = getattr(visual, "material", None), getattr(visual, "uv", None)
    uv = None if uv is None or len(uv) == 0 or not np.all(np.isfinite(uv)) else np.asarray(uv, np.float32)
    image = getattr(found, "image", None)
    if found is None or _is_placeholder(image):
        return None, None
    if image is not None:
        name = str(image.info.get("file_path", id(image)))
        if name not in texels:
            texels[name] = texels_from_image(image)
        return Phong((1.0, 1.0, 1.0), colour_map=Texture(texels[name])), uv
    return Phong(_colour(getattr(found, "diffuse", None))), uv


def colours_from_visual(visual: Any) -> np.ndarray | None:
    """A mesh's vertex colours (n, 4) float32, linear with alpha 1; None where the file gives none that are finite."""
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


def _is_placeholder(image: Any) -> bool:
    """Whether this is the plain 2 x 2 image that trimesh puts where an OBJ has texture coordinates but no material."""
    return image is not None and image.size == (2, 2) and len(np.unique(np.asarray(image).reshape(4, -1), axis=0)) == 1


def _colour(value: Any) -> Colour:
    """A colour, sRGB-coded in 0 .. 1 or, as integers, 0 .. 255, made linear; white for None."""
    if value is None:
        return (1.0, 1.0, 1.0)
    rgb = np.asarray(value)[:3]
    red, green, blue = linear_from_srgb(np.clip(rgb / 255.0 if rgb.dtype.kind in "iu" else rgb.astype(np.float64), 0, 1)).tolist()
    return (red, green, blue)
