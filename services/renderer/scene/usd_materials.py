"""UsdPreviewSurface as materials of glTF (OpenUSD, "UsdPreviewSurface Specification" 2.6).

Metallic and roughness, and colour and opacity, may come from four images in USD and share two in glTF: those are put together here.
"""
# pyright: reportAttributeAccessIssue=false

import io
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from pxr import UsdShade  # pyright: ignore[reportMissingImports]

from vemlight.errors import UserError
from vemlight.light.colour import linear_from_srgb
from vemlight.renderer.scene.glb_writer import GlbWriter
from vemlight.renderer.scene.textures import MAX_TEXTURE_SIDE, open_picture
from vemlight.renderer.scene.usd_layers import CheckedLayers

WRAPS = {"clamp": 33071, "black": 33071, "mirror": 33648, "repeat": 10497}  # glTF's numbers; black borders are not drawn
CHANNELS = {"r": 0, "g": 1, "b": 2, "a": 3}
NOT_DRAWN = {"clearcoat": 0.0, "displacement": 0.0}  # inputs, with the values that change nothing


class MadeMaterial(NamedTuple):
    """A material of the glTF. uv_name: the primvar of its textures, "" without any. uv_transform: (2, 3), of its values, v upwards."""

    number: int
    uv_name: str
    uv_transform: np.ndarray


class _Image(NamedTuple):
    """An input's texture. content: an image file. channel: rgb or one of CHANNELS. scale: (4,), of its values. uv_*: as MadeMaterial."""

    content: bytes
    channel: str
    scale: np.ndarray
    wraps: tuple[int, int]
    uv_name: str
    uv_transform: np.ndarray


class UsdMaterials:
    """Makes the materials of a stage at one time, each once. note: takes lines about what is not drawn."""

    def __init__(self, glb: GlbWriter, layers: CheckedLayers, time: Any, note: Callable[[str], None]) -> None:
        self._glb, self._layers, self._time, self._note = glb, layers, time, note
        self._made: dict[str, MadeMaterial | None] = {}
        self._textures: dict[tuple[int, tuple[int, int]], int] = {}
        self._images: dict[bytes, int] = {}
        self._plain: int | None = None

    @property
    def plain(self) -> int:
        """The number of a white, rough material, for meshes that have colours alone."""
        if self._plain is None:
            pbr = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
            self._plain = self._glb.add("materials", {"name": "displayColor", "pbrMetallicRoughness": pbr})
        return self._plain

    def made(self, material: Any) -> MadeMaterial | None:
        """The glTF's material for one of the stage; None where there is none that can be drawn."""
        if not material:
            return None
        path = str(material.GetPath())
        if path not in self._made:
            shader = material.ComputeSurfaceSource()[0]
            if not shader or shader.GetIdAttr().Get() != "UsdPreviewSurface":
                self._note(f"material {material.GetPrim().GetName()} has no UsdPreviewSurface; its meshes are drawn gray")
                self._made[path] = None
            else:
                self._made[path] = self._preview(material.GetPrim().GetName(), shader)
        return self._made[path]

    def _preview(self, name: str, shader: Any) -> MadeMaterial:
        images = {key: image for key in INPUTS if (image := self._image(name, shader, key)) is not None}
        row: dict[str, Any] = {"name": name}
        if self._value(shader, "useSpecularWorkflow", 0) == 1:
            model = self._specular(name, shader, images)
            row["extensions"] = {"KHR_materials_pbrSpecularGlossiness": model}
            self._glb.document.setdefault("extensionsUsed", [])
            if "KHR_materials_pbrSpecularGlossiness" not in self._glb.document["extensionsUsed"]:
                self._glb.document["extensionsUsed"].append("KHR_materials_pbrSpecularGlossiness")
            colour_key, texture_key = "diffuseFactor", "diffuseTexture"
        else:
            model = row["pbrMetallicRoughness"] = self._metallic(name, shader, images)
            row["extensions"] = {"KHR_materials_ior": {"ior": float(np.clip(self._value(shader, "ior", 1.5), 0, 1e6))}}
            colour_key, texture_key = "baseColorFactor", "baseColorTexture"
        self._colour(name, shader, images, model, (colour_key, texture_key), row)
        if "normal" in images:
            row["normalTexture"] = {"index": self._texture(images["normal"])}
        emission = self._value(shader, "emissiveColor", (0.0, 0.0, 0.0))
        if "emissiveColor" in images:
            emission = images["emissiveColor"].scale[:3]
            row["emissiveTexture"] = {"index": self._texture(images["emissiveColor"])}
        strength = float(max(1.0, np.max(emission)))
        row["emissiveFactor"] = np.clip(np.divide(emission, strength), 0, 1).tolist()
        if strength > 1:
            row["extensions"]["KHR_materials_emissive_strength"] = {"emissiveStrength": strength}
        for key, neutral in NOT_DRAWN.items():
            if key in images or self._value(shader, key, neutral) != neutral:
                self._note(f"material {name}: its {key} is not drawn")
        number = self._glb.add("materials", row)
        uvs = {(image.uv_name, image.uv_transform.tobytes()) for image in images.values()}
        if len(uvs) > 1:
            self._note(f"material {name}: its textures lie by several texture coordinates, and all are drawn by those of the first")
        first = next(iter(images.values()), None)
        return MadeMaterial(number, first.uv_name if first else "", first.uv_transform if first else np.eye(3)[:2])

    def _colour(
        self, name: str, shader: Any, images: dict[str, _Image], model: dict[str, Any], keys: tuple[str, str], row: dict[str, Any]
    ) -> None:
        """Fills in the colour and the alpha."""
        colour, opacity = images.get("diffuseColor"), images.get("opacity")
        factor = np.asarray(self._value(shader, "diffuseColor", (0.18, 0.18, 0.18)), np.float64) if colour is None else colour.scale[:3]
        alpha = float(self._value(shader, "opacity", 1.0)) if opacity is None else 1.0
        threshold = float(self._value(shader, "opacityThreshold", 0.0))
        model[keys[0]] = [*np.clip(factor, 0, 1).tolist(), float(np.clip(alpha, 0, 1))]
        shared = colour and opacity and colour.content == opacity.content and opacity.channel == "a"
        if opacity is not None and not shared:
            content = self._joined([(colour, "rgb", 255), (opacity, opacity.channel, 255)], name)
            if content is not None:
                colour = (colour or opacity)._replace(content=content)
        if colour is not None and colour.content:
            model[keys[1]] = {"index": self._texture(colour)}
        if opacity is not None or alpha < 1:
            row["alphaMode"] = "MASK" if threshold > 0 else "BLEND"
            row |= {"alphaCutoff": threshold} if threshold > 0 else {}

    def _metallic(self, name: str, shader: Any, images: dict[str, _Image]) -> dict[str, Any]:
        model: dict[str, Any] = {}
        metallic, roughness = images.get("metallic"), images.get("roughness")
        for key, image, neutral in (("metallic", metallic, 0.0), ("roughness", roughness, 0.5)):
            value = self._value(shader, key, neutral) if image is None else image.scale[CHANNELS.get(image.channel, 0)]
            model[f"{key}Factor"] = float(np.clip(value, 0, 1))
        image = metallic or roughness
        if image is not None:
            of = {key: (found, found.channel if found else "r", 255) for key, found in (("g", roughness), ("b", metallic))}
            content = self._joined([(None, "r", 255), of["g"], of["b"]], name)
            if content is not None:
                model["metallicRoughnessTexture"] = {"index": self._texture(image._replace(content=content))}
        return model

    def _specular(self, name: str, shader: Any, images: dict[str, _Image]) -> dict[str, Any]:
        specular, roughness = images.get("specularColor"), images.get("roughness")
        if specular is not None or roughness is not None:
            self._note(f"material {name}: textures of specularColor and roughness are left out in the specular workflow")
        rough = float(self._value(shader, "roughness", 0.5)) if roughness is None else 0.5
        colour = (0.04, 0.04, 0.04) if specular is not None else self._value(shader, "specularColor", (0.0, 0.0, 0.0))
        specular_factor = np.clip(np.asarray(colour, np.float64), 0, 1).tolist()
        return {"specularFactor": specular_factor, "glossinessFactor": float(np.clip(1 - rough, 0, 1))}

    def _value(self, shader: Any, key: str, default: Any) -> Any:
        """An input's own value, of the attribute that it is connected to."""
        found = shader.GetInput(key)
        if not found:
            return default
        attributes = UsdShade.Utils.GetValueProducingAttributes(found)
        value = attributes[0].Get(self._time) if attributes else None
        if value is None or not np.isfinite(np.asarray(value, np.float64)).all():
            return default
        return value

    def _image(self, name: str, shader: Any, key: str) -> _Image | None:
        """The texture of an input, with its file's content; None where it has none that can be drawn."""
        found = shader.GetInput(key)
        attributes = UsdShade.Utils.GetValueProducingAttributes(found) if found else []
        if not attributes or not attributes[0].GetName().startswith("outputs:"):
            return None
        source, what = UsdShade.Shader(attributes[0].GetPrim()), f"material {name}: the texture of its {key}"
        if source.GetIdAttr().Get() != "UsdUVTexture":
            self._note(f"{what} is left out: it is made by {str(source.GetIdAttr().Get())[:60]}")
            return None
        asset = self._value_of_asset(source)
        try:
            content = self._layers.read(asset) if asset is not None else None
            if content is None:
                self._note(f"{what} is left out: there is no {'file' if asset is None else asset.path[:100]}")
                return None
            with open_picture(content, f"{key} of material {name}") as picture:
                content = content if picture.format in ("PNG", "JPEG") else _as_png(picture.convert("RGBA"))
        except UserError:
            raise
        except Exception:  # a hostile image raises whatever Pillow trips over
            self._note(f"{what} is left out: it is no image of a kind that is read here")
            return None
        uv_name, uv_transform = self._uv(source)
        wraps = tuple(WRAPS.get(self._value_text(source, way, "repeat"), WRAPS["repeat"]) for way in ("wrapS", "wrapT"))
        scale = np.asarray(self._value(source, "scale", (1.0,) * 4), np.float64)
        bias = np.asarray(self._value(source, "bias", (0.0,) * 4), np.float64)
        if key != "normal" and bias.any():
            self._note(f"{what} is drawn without its bias")
        if key == "normal" and not (np.allclose(scale[:3], 2) and np.allclose(bias[:3], -1)) and (scale != 1).any():
            self._note(f"{what} is drawn as usual normal maps, without its own scale and bias")
        if key in COLOURS and self._value_text(source, "sourceColorSpace", "auto") == "raw":
            content = _srgb_coded(content)
        return _Image(content, attributes[0].GetBaseName(), np.resize(scale, 4), (wraps[0], wraps[1]), uv_name, uv_transform)

    def _value_of_asset(self, source: Any) -> Any:
        found = source.GetInput("file")
        attributes = UsdShade.Utils.GetValueProducingAttributes(found) if found else []
        return attributes[0].Get(self._time) if attributes else None

    def _value_text(self, source: Any, key: str, default: str) -> str:
        found = source.GetInput(key)
        value = found.Get(self._time) if found else None
        return default if value is None else str(value)

    def _uv(self, source: Any) -> tuple[str, np.ndarray]:
        """The primvar by which a texture lies, and the transform (2, 3) of its coordinates."""
        transform, found = np.eye(3), source.GetInput("st")
        for _ in range(8):
            connected = found.GetConnectedSources()[0] if found else []
            if not connected:
                break
            reader = UsdShade.Shader(connected[0].source.GetPrim())
            if reader.GetIdAttr().Get() == "UsdTransform2d":
                transform = transform @ self._transform_2d(reader)
                found = reader.GetInput("in")
                continue
            return self._varname(reader), transform[:2]
        return "st", transform[:2]

    def _varname(self, reader: Any) -> str:
        found = reader.GetInput("varname")
        attributes = UsdShade.Utils.GetValueProducingAttributes(found) if found else []
        return str((attributes[0].Get(self._time) if attributes else None) or "st")

    def _transform_2d(self, shader: Any) -> np.ndarray:
        """Scales, turns counter-clockwise and moves, in this order, (3, 3)."""
        angle = np.radians(float(self._value(shader, "rotation", 0.0)))
        matrix = np.eye(3)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        matrix[:2, :2] = turn * np.asarray(self._value(shader, "scale", (1.0, 1.0)))
        matrix[:2, 2] = self._value(shader, "translation", (0.0, 0.0))
        return matrix

    def _texture(self, image: _Image) -> int:
        if image.content not in self._images:
            self._images[image.content] = self._glb.image(image.content)
        key = self._images[image.content], image.wraps
        if key not in self._textures:
            sampler = self._glb.add("samplers", {"wrapS": image.wraps[0], "wrapT": image.wraps[1]})
            self._textures[key] = self._glb.add("textures", {"source": key[0], "sampler": sampler})
        return self._textures[key]

    def _joined(self, parts: list[tuple[_Image | None, str, int]], name: str) -> bytes | None:
        """A PNG whose channels are those of several images; of None a constant code."""
        try:
            opened = [None if image is None else open_picture(image.content, f"an image of {name}").convert("RGBA") for image, *_ in parts]
        except Exception as error:  # as above
            self._note(f"material {name}: its textures cannot be put together ({' '.join(str(error).split())[:100]})")
            return None
        sizes = [picture.size for picture in opened if picture]
        size = min(max(w for w, _ in sizes), MAX_TEXTURE_SIDE), min(max(h for _, h in sizes), MAX_TEXTURE_SIDE)
        bands: list[Image.Image] = []
        for picture, (_, channel, constant) in zip(opened, parts, strict=True):
            if picture is None:
                bands += [Image.new("L", size, constant)] * (3 if channel == "rgb" else 1)
                continue
            sized = picture if picture.size == size else picture.resize(size)
            bands += list(sized.split()[:3]) if channel == "rgb" else [sized.split()[CHANNELS.get(channel, 0)]]
        return _as_png(Image.merge("RGBA" if len(bands) == 4 else "RGB", bands))


INPUTS = ("diffuseColor", "opacity", "metallic", "roughness", "specularColor", "normal", "emissiveColor", "clearcoat", "displacement")
COLOURS = ("diffuseColor", "emissiveColor")


def _as_png(picture: Image.Image) -> bytes:
    out = io.BytesIO()
    picture.save(out, "PNG", compress_level=1)
    return out.getvalue()


def _srgb_coded(content: bytes) -> bytes:
    """A PNG whose sRGB codes stand for what are linear codes in an image, to half a code."""
    codes = np.searchsorted(linear_from_srgb((np.arange(255) + 0.5) / 255), np.arange(256) / 255).astype(np.uint8)
    with open_picture(content, "an image") as picture:
        rgba = picture.convert("RGBA").split()
    return _as_png(Image.merge("RGBA", [band.point(codes.tolist()) for band in rgba[:3]] + [rgba[3]]))
