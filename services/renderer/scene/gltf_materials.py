"""Materials of glTF files: factors, textures, texture coordinates and vertex colours (glTF 2.0, sections 3.7.2, 3.8 and 3.9)."""

from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from vemlight.errors import UserError
from vemlight.renderer.gl.constants import MAX_HALF
from vemlight.renderer.scene.gltf import MODES, READ_EXTENSIONS, TRIANGLES, GltfFile, item
from vemlight.renderer.scene.materials import AlphaTest, Colour, Ggx, Material, SpecularGlossiness, Unlit
from vemlight.renderer.scene.textures import (
    BLED_PIXEL_BYTES,
    FREE_TEXTURE_BYTES,
    HALF_BYTES,
    LINEAR,
    LINEAR_MIPMAP_LINEAR,
    MAX_TEXTURE_SIDE,
    PIXEL_BYTES,
    TEXTURE_RATIO,
    Texture,
    alpha_bled,
    open_picture,
    row_blocks,
    texels_from_image,
)

REPEAT, CLAMP, MIRRORED = 10497, 33071, 33648  # section 5.26
MAGNIFICATION_FILTERS, MINIFICATION_FILTERS = (9728, 9729), (9728, 9729, 9984, 9985, 9986, 9987)
MAX_NOTES = 20  # lines about what is not drawn; who reads more of them?
MAX_NUMBER = 1e6  # of factors and texture transforms; a larger one is taken for damage. Any value in 1e4 .. 1e9 does
FLIP_V = np.array([[1.0, 0, 0], [0, -1, 1], [0, 0, 1]])  # from v upwards to glTF's, which is downwards, and back


class MaterialBinding(NamedTuple):
    """A material of a file on one of its primitives. name: for messages about it."""

    name: str
    document: dict[str, Any]
    primitive: dict[str, Any]

    @property
    def extensions(self) -> dict[str, Any]:
        return self.document.get("extensions", {})


class TextureEncoding(NamedTuple):
    """How an image becomes texels.

    srgb: whether its colours are sRGB-coded. alpha: whether its alpha is read. bleed: whether colours spread into texels of alpha 0.
    channels: which are read, all for None. mirrored: whether its mirror image is appended, across and up (MIRRORED_REPEAT).
    """

    srgb: bool = True
    alpha: bool = False
    bleed: bool = False
    channels: tuple[int, ...] | None = None
    mirrored: tuple[bool, bool] = (False, False)


COLOUR = TextureEncoding()
COLOUR_WITH_ALPHA = TextureEncoding(alpha=True)
ALPHA_TESTED_COLOUR = TextureEncoding(alpha=True, bleed=True)
NORMALS = TextureEncoding(srgb=False)
METALLIC_ROUGHNESS = TextureEncoding(srgb=False, channels=(2, 1))  # metallic is in blue, roughness in green


class GltfMaterials:
    """The materials of a file's primitives. unsupported: a line for each feature of the file that is not drawn.

    A file that is not as the standard has it raises as gltf.py says.
    """

    def __init__(self, file: GltfFile) -> None:
        self._file = file
        self._texels: dict[tuple[int | None, TextureEncoding], np.ndarray | None] = {}
        self._scaled: dict[tuple[int, float], np.ndarray] = {}  # by the texels, which `_texels` keeps, and their scale
        self._lowest: dict[int, float] = {}
        self._stored_images: dict[int, int] = {}
        self._texture_bytes = 0
        self.unsupported: list[str] = []

    def material(self, primitive: dict[str, Any]) -> Material | None:
        """A primitive's material; None where the file gives it none."""
        if "material" not in primitive:
            return None
        found = item(self._file.document.get("materials", []), primitive["material"], "materials")
        binding = MaterialBinding(f"material {found.get('name', primitive['material'])}", found, primitive)
        if "KHR_materials_pbrSpecularGlossiness" in binding.extensions:
            model, colour, colour_texture = binding.extensions["KHR_materials_pbrSpecularGlossiness"], "diffuseFactor", "diffuseTexture"
        else:
            model, colour, colour_texture = found.get("pbrMetallicRoughness", {}), "baseColorFactor", "baseColorTexture"
        factor = _numbers(model.get(colour, (1.0,) * 4), 4, 1.0)
        colour_map, alpha_test = self._colour_map(binding, model, colour_texture, float(factor[3]))
        if "KHR_materials_unlit" in binding.extensions:
            return Unlit(_colour(factor), colour_map, alpha_test)
        emission, emission_map = self._emission(binding)
        normal_map = self._normal_map(binding)
        if "KHR_materials_pbrSpecularGlossiness" in binding.extensions:
            return SpecularGlossiness(
                diffuse=_colour(factor),
                specular=_colour(_numbers(model.get("specularFactor", (1.0,) * 3), 3, 1.0)),
                glossiness=_fraction(model, "glossinessFactor"),
                colour_map=colour_map,
                specular_glossiness_map=self._texture(model, "specularGlossinessTexture", binding, COLOUR_WITH_ALPHA),
                normal_map=normal_map,
                emission=emission,
                emission_map=emission_map,
                alpha_test=alpha_test,
            )
        return Ggx(
            base_color=_colour(factor),
            metallic=_fraction(model, "metallicFactor"),
            roughness=_fraction(model, "roughnessFactor"),
            colour_map=colour_map,
            metallic_roughness_map=self._texture(model, "metallicRoughnessTexture", binding, METALLIC_ROUGHNESS),
            normal_map=normal_map,
            reflectance=_reflectance(binding.extensions.get("KHR_materials_ior", {}).get("ior", 1.5)),
            emission=emission,
            emission_map=emission_map,
            alpha_test=alpha_test,
        )

    def _colour_map(
        self, binding: MaterialBinding, model: dict[str, Any], key: str, alpha: float
    ) -> tuple[Texture | None, AlphaTest | None]:
        """The texture of a material's colour, and its alpha test; none where factor, image and vertex colours are opaque all over."""
        mode = binding.document.get("alphaMode", "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise ValueError(f"has {binding.name} of alphaMode {str(mode)[:20]}")
        if mode == "OPAQUE":
            return self._texture(model, key, binding), None
        cutoff = float(_numbers([binding.document.get("alphaCutoff", 0.5)], 1, MAX_NUMBER)[0]) if mode == "MASK" else None
        texture, colours = self._texture(model, key, binding, ALPHA_TESTED_COLOUR), self.colours(binding.primitive)
        lowest = alpha * (1.0 if texture is None else self._lowest_alpha(texture.texels))
        lowest *= 1.0 if colours is None else float(colours[:, 3].min())
        opaque = lowest >= (1.0 if cutoff is None else cutoff)
        return texture, None if opaque else AlphaTest(alpha, cutoff, texture)

    def _lowest_alpha(self, texels: np.ndarray) -> float:
        if id(texels) not in self._lowest:
            self._lowest[id(texels)] = float(texels[..., 3].min())
        return self._lowest[id(texels)]

    def _emission(self, binding: MaterialBinding) -> tuple[Colour, Texture | None]:
        strength = binding.extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
        factor = _numbers(binding.document.get("emissiveFactor", (0.0,) * 3), 3, 1.0)
        emission = _colour(factor * _numbers([strength], 1, MAX_HALF))
        return emission, self._texture(binding.document, "emissiveTexture", binding) if any(emission) else None

    def _normal_map(self, binding: MaterialBinding) -> Texture | None:
        texture = self._texture(binding.document, "normalTexture", binding, NORMALS)
        if texture is None or (scale := binding.document["normalTexture"].get("scale", 1.0)) == 1.0:
            return texture
        key = id(texture.texels), float(_finite([scale], 1)[0])
        if key not in self._scaled:
            try:
                self._count_texels(texture.texels.size // 3, 3)
            except UserError as error:
                self._note(f"{binding.name}: the scale of its normalTexture is left out: {error}")
                return texture
            scaled = self._scaled[key] = np.empty(texture.texels.shape, np.float16)
            for rows in row_blocks(scaled):
                normals = 2 * texture.texels[rows].astype(np.float32) - 1
                normals[..., :2] *= key[1]
                scaled[rows] = ((normals + 1) / 2).astype(np.float16)
        return texture._replace(texels=self._scaled[key])

    def _texture(self, where: dict[str, Any], key: str, binding: MaterialBinding, encoding: TextureEncoding = COLOUR) -> Texture | None:
        """The texture that `where` names by `key`; None, with a line in `unsupported`, where it cannot be drawn."""
        if key not in where:
            return None
        info, document = where[key], self._file.document
        texture = item(document.get("textures", []), info["index"], "textures")
        sampler = item(document.get("samplers", []), texture["sampler"], "samplers") if "sampler" in texture else {}
        transform = info.get("extensions", {}).get("KHR_texture_transform", {})
        uv_set = transform.get("texCoord", info.get("texCoord", 0))
        if uv_set not in (0, 1) or f"TEXCOORD_{uv_set}" not in binding.primitive["attributes"]:
            reason = "the mesh does not have" if uv_set in (0, 1) else "of which only 0 and 1 are drawn"
            self._note(f"{binding.name}: its {key} is left out: it lies by TEXCOORD_{uv_set}, {reason}")
            return None
        wraps = (sampler.get("wrapS", REPEAT), sampler.get("wrapT", REPEAT))
        filters = (sampler.get("minFilter", LINEAR_MIPMAP_LINEAR), sampler.get("magFilter", LINEAR))
        if not {*wraps} <= {REPEAT, CLAMP, MIRRORED} or filters[0] not in MINIFICATION_FILTERS or filters[1] not in MAGNIFICATION_FILTERS:
            raise ValueError(f"has {binding.name} with a sampler that glTF does not know")
        mirrored = (wraps[0] == MIRRORED, wraps[1] == MIRRORED)
        source = texture.get("extensions", {}).get("EXT_texture_webp", {}).get("source", texture.get("source"))
        texels = self._texels_of(source, encoding._replace(mirrored=mirrored), f"{binding.name}: its {key}")
        if texels is None:
            return None
        halves = np.diag([0.5 if mirrored[0] else 1.0, 0.5 if mirrored[1] else 1.0, 1.0])
        matrix = halves @ FLIP_V @ _uv_transform(transform) @ FLIP_V
        identity = uv_set == 0 and np.array_equal(matrix, np.eye(3))
        return Texture(texels, (wraps[0] != CLAMP, wraps[1] != CLAMP), filters, uv_set, None if identity else matrix[:2])

    def _texels_of(self, number: int | None, encoding: TextureEncoding, what: str) -> np.ndarray | None:
        """An image's texels, made once for all materials; None, with a line in `unsupported` about `what`, where it cannot be read."""
        if (number, encoding) not in self._texels:
            texels = self._read_image(number, encoding, what)
            if texels is not None:
                texels = texels if encoding.channels is None else texels[..., list(encoding.channels)]
                texels = alpha_bled(texels) if encoding.bleed else texels
                for axis, mirrored in zip((1, 0), encoding.mirrored, strict=True):
                    texels = np.concatenate([texels, np.flip(texels, axis)], axis=axis) if mirrored else texels
                texels = np.ascontiguousarray(texels)
            self._texels[number, encoding] = texels
        return self._texels[number, encoding]

    def _read_image(self, number: int | None, encoding: TextureEncoding, what: str) -> np.ndarray | None:
        if number is None:
            self._note(f"{what} is left out: it has no image of a kind that is read here")
            return None
        try:
            content = self._file.image(number)
        except FileNotFoundError as error:
            self._note(f"{what} is left out: there is no {error.filename}")
            return None
        try:
            with open_picture(content, f"image {number}", BLED_PIXEL_BYTES if encoding.bleed else PIXEL_BYTES) as image:
                self._stored_images[number] = len(content)
                width, height = (min(side, MAX_TEXTURE_SIDE) for side in image.size)
                self._count_texels(width * height << sum(encoding.mirrored), 4 if encoding.alpha else 3)
                return texels_from_image(image, encoding.srgb, encoding.alpha)
        except Image.UnidentifiedImageError:
            self._note(f"{what} is left out: it is no image of a kind that is read here")
        except (UserError, Image.DecompressionBombError) as error:
            self._note(f"{what} is left out: {error}")
        return None

    def _count_texels(self, count: int, channels: int) -> None:
        """Raises UserError before textures are made that take too much memory, all in all, for the images that they are made of."""
        self._texture_bytes += count * channels * HALF_BYTES
        stored_bytes = sum(self._stored_images.values())
        if self._texture_bytes > max(FREE_TEXTURE_BYTES, TEXTURE_RATIO * stored_bytes):
            self._texture_bytes -= count * channels * HALF_BYTES
            raise UserError(f"with the other textures it takes far more memory than the {stored_bytes} bytes stored; make it smaller")

    def uvs(self, primitive: dict[str, Any]) -> list[np.ndarray | None]:
        """Both sets of texture coordinates, (n, 2) float32 each, v upwards; None where the primitive has none that are finite."""
        found = []
        for name in ("TEXCOORD_0", "TEXCOORD_1"):
            uv = self._file.array(primitive["attributes"][name])[:, :2] if name in primitive["attributes"] else None
            if uv is not None and not np.all(np.isfinite(uv)):
                self._note(f"a mesh's {name} is left out: some are nan or inf")
                uv = None
            found.append(None if uv is None else (uv * [1, -1] + [0, 1]).astype(np.float32))
        return found

    def colours(self, primitive: dict[str, Any]) -> np.ndarray | None:
        """The vertices' colours with their alpha, (n, 4) float32, linear, 0 .. 1; None where there are none that are finite."""
        if "COLOR_0" not in primitive["attributes"]:
            return None
        found = self._file.array(primitive["attributes"]["COLOR_0"])
        if found.shape[1] not in (3, 4) or not np.all(np.isfinite(found)):
            self._note("a mesh's COLOR_0 is left out: some are nan or inf, or not 3 or 4 numbers")
            return None
        colours = np.ones((len(found), 4), np.float32)
        colours[:, : found.shape[1]] = np.clip(found, 0, 1)
        return colours

    def note_unsupported(self) -> None:
        """Adds to `unsupported` what the file has beyond textures: extensions, morph targets, skins, points and lines."""
        document = self._file.document
        for extension in sorted(set(document.get("extensionsUsed", [])) - READ_EXTENSIONS)[:MAX_NOTES]:
            users = [m.get("name", k) for k, m in enumerate(document.get("materials", [])) if extension in m.get("extensions", {})]
            more = f" and {len(users) - 1} more" if users[1:] else ""
            self._note(f"{extension} is not drawn" + (f", of material {users[0]}{more}" if users else ""))
        for number, mesh in enumerate(document.get("meshes", [])):
            name = f"mesh {mesh.get('name', number)}"
            if any("targets" in primitive for primitive in mesh["primitives"]):
                self._note(f"{name}: its morph targets are left out; it keeps its first form")
            if any(primitive.get("mode", TRIANGLES) not in MODES for primitive in mesh["primitives"]):
                self._note(f"{name}: its points or lines are left out; triangles are drawn")
        for number, node in enumerate(document.get("nodes", [])):
            if "skin" in node:
                self._note(f"node {node.get('name', number)}: its skin is left out; it keeps its first form")

    def _note(self, line: str) -> None:
        line = " ".join(line.split())[:300]
        if len(self.unsupported) < MAX_NOTES and line not in self.unsupported:
            self.unsupported.append(line if len(self.unsupported) < MAX_NOTES - 1 else "has more that is not drawn")


def _uv_transform(transform: dict[str, Any]) -> np.ndarray:
    """KHR_texture_transform as a matrix (3, 3), for v downwards: scaled, rotated counter-clockwise in the image, moved."""
    (angle,) = _finite([transform.get("rotation", 0.0)], 1)
    cosine, sine = np.cos(angle), np.sin(angle)
    matrix = np.eye(3)
    matrix[:2, :2] = np.array([[cosine, sine], [-sine, cosine]]) * _finite(transform.get("scale", (1.0, 1.0)), 2)
    matrix[:2, 2] = _finite(transform.get("offset", (0.0, 0.0)), 2)
    return matrix


def _reflectance(index: Any) -> float:
    """Reflectance at normal incidence of a refractive index in air (Fresnel; KHR_materials_ior)."""
    (n,) = _numbers([index], 1, MAX_NUMBER)
    return float((n - 1) / (n + 1)) ** 2


def _finite(values: Any, count: int) -> np.ndarray:
    """Numbers (count,) float64. Raises ValueError for another count, nan, or numbers beyond MAX_NUMBER."""
    found = np.asarray(values, np.float64)
    if found.shape != (count,) or not np.all(np.abs(found) <= MAX_NUMBER):
        raise ValueError(f"has a material with {str(values)[:60]} where {count} finite numbers must be")
    return found


def _numbers(values: Any, count: int, highest: float) -> np.ndarray:
    """As `_finite`, clipped to `highest`. Raises ValueError for numbers below 0."""
    found = _finite(values, count)
    if np.any(found < 0):
        raise ValueError(f"has a material with {str(values)[:60]} where nothing may be below 0")
    return np.minimum(found, highest)


def _fraction(where: dict[str, Any], key: str) -> float:
    return float(_numbers([where.get(key, 1.0)], 1, 1.0)[0])


def _colour(values: np.ndarray) -> Colour:
    red, green, blue = values[:3].tolist()
    return (red, green, blue)
