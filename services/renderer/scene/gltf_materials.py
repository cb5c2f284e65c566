"""What glTF files say of how meshes look: materials, images, texture coordinates, vertex colours (glTF 2.0, sections 3.7.2, 3.8, 3.9)."""

import io
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from vemlight.renderer.scene.gltf import DRAWN_MODES, READ_EXTENSIONS, GltfFile, at
from vemlight.renderer.scene.materials import (
    LINEAR,
    LINEAR_MIPMAP_LINEAR,
    AlphaTest,
    Colour,
    Ggx,
    Material,
    SpecularGlossiness,
    Texture,
    Unlit,
    alpha_bled,
    texels,
)  # fmt: skip

REPEAT, CLAMP, MIRRORED = 10497, 33071, 33648  # section 5.26
MAGNIFYING, MINIFYING = (9728, 9729), (9728, 9729, 9984, 9985, 9986, 9987)
MAX_RADIANCE = 65504.0  # the largest half float
FLIP = np.array([[1.0, 0, 0], [0, -1, 1], [0, 0, 1]])  # from v upwards to glTF's, which is downwards, and back


class MaterialBinding(NamedTuple):
    """A material of a file on one of its primitives. name: for what is said of it."""

    name: str
    primitive: dict[str, Any]


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


SRGB_COLOUR = TextureEncoding()


class GltfMaterials:
    """What the primitives of a file look like. left_out: a line for each thing that the file has and that is not drawn.

    All that is not as the standard has it is raised as gltf.py says.
    """

    def __init__(self, file: GltfFile) -> None:
        self._file = file
        self._texels: dict[tuple[int | None, TextureEncoding], np.ndarray | None] = {}
        self.left_out: list[str] = []

    def material(self, primitive: dict[str, Any]) -> Material | None:
        """A primitive's material; None where the file gives it none."""
        if "material" not in primitive:
            return None
        found = at(self._file.document.get("materials", []), primitive["material"], "materials")
        binding = MaterialBinding(f"material {found.get('name', primitive['material'])}", primitive)
        extensions = found.get("extensions", {})
        base, old = found.get("pbrMetallicRoughness", {}), extensions.get("KHR_materials_pbrSpecularGlossiness")
        factor = _numbers((base if old is None else old).get("baseColorFactor" if old is None else "diffuseFactor", (1.0,) * 4), 4, 1.0)
        if old is None:
            colour_map, alpha_test = self._coloured(found, base, "baseColorTexture", float(factor[3]), binding)
        else:
            colour_map, alpha_test = self._coloured(found, old, "diffuseTexture", float(factor[3]), binding)
        if "KHR_materials_unlit" in extensions:
            return Unlit(_colour(factor), colour_map, alpha_test)
        strength = _numbers([extensions.get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)], 1, MAX_RADIANCE)
        emission = _colour(_numbers(found.get("emissiveFactor", (0.0,) * 3), 3, 1.0) * strength)
        emission_map = self._texture(found, "emissiveTexture", binding) if any(emission) else None
        shared: dict[str, Any] = {
            "colour_map": colour_map, "normal_map": self._normal_map(found, binding),
            "emission": emission, "emission_map": emission_map, "alpha_test": alpha_test,
        }  # fmt: skip
        if old is not None:
            both = self._texture(old, "specularGlossinessTexture", binding, TextureEncoding(alpha=True))
            specular = _colour(_numbers(old.get("specularFactor", (1.0,) * 3), 3, 1.0))
            return SpecularGlossiness(_colour(factor), specular, _number(old, "glossinessFactor"), specular_glossiness_map=both, **shared)
        rough = self._texture(base, "metallicRoughnessTexture", binding, TextureEncoding(srgb=False, channels=(2, 1)))  # blue, green
        (index,) = _numbers([extensions.get("KHR_materials_ior", {}).get("ior", 1.5)], 1, 1e6)
        reflectance = float((index - 1) / (index + 1)) ** 2
        metallic, roughness = _number(base, "metallicFactor"), _number(base, "roughnessFactor")
        return Ggx(_colour(factor), metallic, roughness, metallic_roughness_map=rough, reflectance=reflectance, **shared)

    def _coloured(
        self, found: dict[str, Any], model: dict[str, Any], key: str, alpha: float, binding: MaterialBinding
    ) -> tuple[Texture | None, AlphaTest | None]:
        """The image of a material's colour, and its holes; none where nothing of it can be seen through."""
        mode = found.get("alphaMode", "OPAQUE")
        if mode not in ("OPAQUE", "MASK", "BLEND"):
            raise ValueError(f"has {binding.name} of alphaMode {str(mode)[:20]}")
        if mode == "OPAQUE":
            return self._texture(model, key, binding), None
        cutoff = float(_numbers([found.get("alphaCutoff", 0.5)], 1, 1e6)[0]) if mode == "MASK" else None
        image, colours = self._texture(model, key, binding, TextureEncoding(alpha=True, bleed=True)), self.colours(binding.primitive)
        least = alpha * (1.0 if image is None else float(image.texels[..., 3].min()))
        least *= 1.0 if colours is None else float(colours[:, 3].min())
        return image, None if least >= (1.0 if cutoff is None else cutoff) else AlphaTest(alpha, cutoff, image)

    def _normal_map(self, found: dict[str, Any], binding: MaterialBinding) -> Texture | None:
        texture = self._texture(found, "normalTexture", binding, TextureEncoding(srgb=False))
        if texture is None or (scale := found["normalTexture"].get("scale", 1.0)) == 1.0:
            return texture
        normal_map = 2 * texture.texels.astype(np.float32) - 1
        normal_map[..., :2] *= _finite([scale], 1)
        return texture._replace(texels=((normal_map + 1) / 2).astype(np.float16))

    def _texture(
        self, where: dict[str, Any], key: str, binding: MaterialBinding, encoding: TextureEncoding = SRGB_COLOUR
    ) -> Texture | None:
        """The image that a material speaks of; None, and a line in `left_out`, where it cannot be drawn."""
        if key not in where:
            return None
        info, document = where[key], self._file.document
        texture = at(document.get("textures", []), info["index"], "textures")
        sampler = at(document.get("samplers", []), texture["sampler"], "samplers") if "sampler" in texture else {}
        uv_transform = info.get("extensions", {}).get("KHR_texture_transform", {})
        uv_set = uv_transform.get("texCoord", info.get("texCoord", 0))
        if uv_set not in (0, 1) or f"TEXCOORD_{uv_set}" not in binding.primitive["attributes"]:
            reason = "the mesh does not have" if uv_set in (0, 1) else "of which only 0 and 1 are drawn"
            self._say(f"{binding.name}: its {key} is left out: it lies by TEXCOORD_{uv_set}, {reason}")
            return None
        wraps = (sampler.get("wrapS", REPEAT), sampler.get("wrapT", REPEAT))
        filters = (sampler.get("minFilter", LINEAR_MIPMAP_LINEAR), sampler.get("magFilter", LINEAR))
        if not {*wraps} <= {REPEAT, CLAMP, MIRRORED} or filters[0] not in MINIFYING or filters[1] not in MAGNIFYING:
            raise ValueError(f"has {binding.name} with a sampler that glTF does not know")
        mirrored = (wraps[0] == MIRRORED, wraps[1] == MIRRORED)
        source = texture.get("extensions", {}).get("EXT_texture_webp", {}).get("source", texture.get("source"))
        found = self._image(source, encoding._replace(mirrored=mirrored), f"{binding.name}: its {key}")
        if found is None:
            return None
        halves = np.diag([0.5 if mirrored[0] else 1.0, 0.5 if mirrored[1] else 1.0, 1.0])
        matrix = halves @ FLIP @ _transform(uv_transform) @ FLIP
        same = uv_set == 0 and np.array_equal(matrix, np.eye(3))
        return Texture(found, (wraps[0] != CLAMP, wraps[1] != CLAMP), filters, uv_set, None if same else matrix[:2])

    def _image(self, number: int | None, encoding: TextureEncoding, what: str) -> np.ndarray | None:
        """An image's texels, made once for all materials; where it is mirrored it has its mirror image beside it."""
        if (number, encoding) in self._texels:
            return self._texels[number, encoding]
        found = None
        if number is None:
            self._say(f"{what} is left out: it has no image of a kind that is read here")
        else:
            try:
                with Image.open(io.BytesIO(self._file.image(number))) as image:
                    found = texels(image, encoding.srgb, encoding.alpha)
            except FileNotFoundError as error:
                self._say(f"{what} is left out: there is no {error.filename}")
            except Image.UnidentifiedImageError:
                self._say(f"{what} is left out: it is no image of a kind that is read here")
            except Image.DecompressionBombError:
                self._say(f"{what} is left out: it is larger than {2 * (Image.MAX_IMAGE_PIXELS or 0)} pixels")
        if found is not None:
            found = found if encoding.channels is None else found[..., list(encoding.channels)]
            found = alpha_bled(found) if encoding.bleed else found
            for axis, twice in zip((1, 0), encoding.mirrored, strict=True):
                found = np.concatenate([found, np.flip(found, axis)], axis=axis) if twice else found
            found = np.ascontiguousarray(found)
        self._texels[number, encoding] = found
        return found

    def uvs(self, primitive: dict[str, Any]) -> list[np.ndarray | None]:
        """Both sets of texture coordinates, (n, 2) float32 each, v upwards; None where the primitive has none that are finite."""
        found = []
        for name in ("TEXCOORD_0", "TEXCOORD_1"):
            uv = self._file.array(primitive["attributes"][name])[:, :2] if name in primitive["attributes"] else None
            found.append(None if uv is None or not np.all(np.isfinite(uv)) else (uv * [1, -1] + [0, 1]).astype(np.float32))
        return found

    def colours(self, primitive: dict[str, Any]) -> np.ndarray | None:
        """The vertices' colours with their alpha, (n, 4) float32, linear, 0 .. 1; None where there are none that are finite."""
        if "COLOR_0" not in primitive["attributes"]:
            return None
        found = self._file.array(primitive["attributes"]["COLOR_0"])
        if found.shape[1] not in (3, 4) or not np.all(np.isfinite(found)):
            return None
        colours = np.ones((len(found), 4), np.float32)
        colours[:, : found.shape[1]] = np.clip(found, 0, 1)
        return colours

    def say_what_else(self) -> None:
        """Adds to `left_out` what the file has beyond images."""
        document = self._file.document
        for extension in sorted(set(document.get("extensionsUsed", [])) - READ_EXTENSIONS):
            users = [m.get("name", k) for k, m in enumerate(document.get("materials", [])) if extension in m.get("extensions", {})]
            more = f" and {len(users) - 1} more" if users[1:] else ""
            self._say(f"{extension} is not drawn" + (f", of material {users[0]}{more}" if users else ""))
        for number, mesh in enumerate(document.get("meshes", [])):
            name = f"mesh {mesh.get('name', number)}"
            if any("targets" in primitive for primitive in mesh["primitives"]):
                self._say(f"{name}: its morph targets are left out; it keeps its first form")
            if any(primitive.get("mode", 4) not in DRAWN_MODES for primitive in mesh["primitives"]):
                self._say(f"{name}: its points, lines or fans are left out; triangles and strips are drawn")
        for number, node in enumerate(document.get("nodes", [])):
            if "skin" in node:
                self._say(f"node {node.get('name', number)}: its skin is left out; it keeps its first form")

    def _say(self, line: str) -> None:
        line = " ".join(line.split())[:300]
        if line not in self.left_out:
            self.left_out.append(line)


def _transform(uv_transform: dict[str, Any]) -> np.ndarray:
    """KHR_texture_transform as a matrix (3, 3), for v downwards: scaled, turned counter-clockwise in the image, moved."""
    (turn,) = _finite([uv_transform.get("rotation", 0.0)], 1)
    cosine, sine = np.cos(turn), np.sin(turn)
    matrix = np.eye(3)
    matrix[:2, :2] = np.array([[cosine, sine], [-sine, cosine]]) * _finite(uv_transform.get("scale", (1.0, 1.0)), 2)
    matrix[:2, 2] = _finite(uv_transform.get("offset", (0.0, 0.0)), 2)
    return matrix


def _finite(values: Any, count: int) -> np.ndarray:
    """Numbers (count,) float64 within a million of 0."""
    found = np.asarray(values, np.float64)
    if found.shape != (count,) or not np.all(np.abs(found) <= 1e6):
        raise ValueError(f"has a material with {str(values)[:60]} where {count} finite numbers must be")
    return found


def _numbers(values: Any, count: int, most: float) -> np.ndarray:
    """As `_finite`, from 0; those above `most` as that."""
    found = _finite(values, count)
    if np.any(found < 0):
        raise ValueError(f"has a material with {str(values)[:60]} where nothing may be below 0")
    return np.minimum(found, most)


def _number(where: dict[str, Any], key: str) -> float:
    return float(_numbers([where.get(key, 1.0)], 1, 1.0)[0])


def _colour(values: np.ndarray) -> Colour:
    red, green, blue = values[:3].tolist()
    return (red, green, blue)
