"""Materials as surface.frag reads them: which variant of the program, the parameters and the textures."""

from typing import NamedTuple

import numpy as np

from vemlight.renderer.gl.buffers import MATERIAL
from vemlight.renderer.gl.constants import HASHED_ALPHA, MaterialTexture
from vemlight.renderer.scene.materials import (
    Ggx,
    Material,
    Phong,
    ShadowCatcher,
    SpecularGlossiness,
    Unlit,
    alpha_test_of,
    material_kind,
)
from vemlight.renderer.scene.textures import Texture


class MaterialUniforms(NamedTuple):
    """variant: what surface.vert and surface.frag are compiled with. row: MATERIAL, zero where the model reads nothing.

    textures: by MaterialTexture, None where the material has none.
    """

    variant: dict[str, str | int]
    row: np.ndarray
    textures: tuple[Texture | None, ...]


def material_uniforms(material: Material, emission: bool) -> MaterialUniforms:
    """How a material is drawn; emission: whether anything in the scene emits."""
    row = np.zeros((), MATERIAL.dtype)
    textures: dict[MaterialTexture, Texture | None] = {}
    match material:
        case Phong():
            model = "phong_surface"
            row["colour"], row["specular"], row["exponent"] = material.diffuse, material.specular, material.exponent
            textures = {MaterialTexture.COLOUR: material.colour_map}
        case Ggx():
            model = "metallic_roughness_surface"
            row["colour"], row["metallic"], row["roughness"] = material.base_color, material.metallic, material.roughness
            row["reflectance"], row["emissive"] = material.reflectance, material.emission
            textures = {
                MaterialTexture.COLOUR: material.colour_map, MaterialTexture.PARAMETER: material.metallic_roughness_map,
                MaterialTexture.NORMAL: material.normal_map, MaterialTexture.EMISSIVE: material.emission_map,
            }  # fmt: skip
        case SpecularGlossiness():
            model = "specular_glossiness_surface"
            row["colour"], row["specular"], row["glossiness"] = material.diffuse, material.specular, material.glossiness
            row["emissive"] = material.emission
            textures = {
                MaterialTexture.COLOUR: material.colour_map, MaterialTexture.PARAMETER: material.specular_glossiness_map,
                MaterialTexture.NORMAL: material.normal_map, MaterialTexture.EMISSIVE: material.emission_map,
            }  # fmt: skip
        case Unlit():
            model = "unlit_surface"
            row["colour"] = material.base_color
            textures = {MaterialTexture.COLOUR: material.colour_map}
        case ShadowCatcher():
            model = "phong_surface"  # black
    row["kind"] = material_kind(material)
    alpha_test = alpha_test_of(material)
    if alpha_test:
        row["alpha"], row["alpha_cutoff"] = alpha_test.alpha, HASHED_ALPHA if alpha_test.cutoff is None else alpha_test.cutoff
    found = tuple(textures.get(slot) for slot in MaterialTexture)
    transformed = any(texture is not None and texture.uv_transform is not None for texture in found)
    if transformed:
        for slot, texture in enumerate(found):
            _set_uv_transform(row, slot, texture)
    variant: dict[str, str | int] = {
        "MODEL": model,
        "TEXTURED": int(any(texture is not None for texture in found)),
        "UV_TRANSFORM": int(transformed),
        "NORMAL_MAP": int(found[MaterialTexture.NORMAL] is not None),
        "ALPHA_TEST": int(alpha_test is not None),
        "EMISSION": int(emission),
    }
    return MaterialUniforms(variant, row, found)


def _set_uv_transform(row: np.ndarray, slot: int, texture: Texture | None) -> None:
    """Fills in how a texture's coordinates follow from both sets of texture coordinates."""
    transform = np.eye(3)[:2] if texture is None or texture.uv_transform is None else texture.uv_transform
    first = 2 * texture.uv_set if texture else 0
    row["u_from_uvs"][slot, first : first + 2], row["v_from_uvs"][slot, first : first + 2] = transform[:, :2]
    row["uv_offset"][slot, :2] = transform[:, 2]
