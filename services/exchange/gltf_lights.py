"""One frame's lights as a glTF 2.0 file with KHR_lights_punctual, y up: directional lights in lx, near ones as points in cd."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from vemlight.exchange.punctual import Punctual
from vemlight.files import written_whole
from vemlight.light.light_set import LightSet, NearLights
from vemlight.light.near_lights import NearLightSet, near_light_rows

EXTENSION = "KHR_lights_punctual"
LM_PER_W = 683.0  # of light at 540 THz (SI, 2019): importers divide lx by it to get W/m2
GLB_MAGIC, GLB_VERSION, JSON_CHUNK = 0x46546C67, 2, 0x4E4F534A  # "glTF", "JSON"


def gltf_from_lights(
    lights: LightSet, sequence: int, time_s: float, scale: float | None = None, near: NearLights | None = None
) -> dict[str, Any]:
    """The document. scale: luminance scale in cd/m2 per unit, by which irradiance becomes lx, and W/sr cd; None: LM_PER_W."""
    turned = lights._replace(directions=lights.directions[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32))  # (x, y, z) -> (x, z, -y)
    punctual = Punctual.of(turned)
    factor = LM_PER_W if scale is None else scale
    illuminance = punctual.strength.astype(np.float64) * factor
    document: dict[str, Any] = {"asset": {"version": "2.0", "generator": "vemlight"}, "scene": 0}
    names = [f"light_{number:04d}" for number in lights.ids.tolist()]
    shining = [
        {"name": name, "type": "directional", "color": colour, "intensity": intensity}
        for name, colour, intensity in zip(names, punctual.colour.tolist(), illuminance.tolist(), strict=True)
    ]
    nodes = [
        {"name": name, "rotation": rotation, "extras": {"vemlight": row}}
        for name, rotation, row in zip(names, punctual.rotation.tolist(), _extras(lights, punctual), strict=True)
    ]
    for light, node in _points(near.points, factor) if near else ():
        shining.append(light)
        nodes.append(node)
    if nodes:
        document["extensionsUsed"] = [EXTENSION]
        document["extensions"] = {EXTENSION: {"lights": shining}}
        document["nodes"] = [{**node, "extensions": {EXTENSION: {"light": k}}} for k, node in enumerate(nodes)]
    document["scenes"] = [
        {
            "name": "vemlight",
            **({"nodes": list(range(len(nodes)))} if nodes else {}),
            "extras": {"vemlight": {"sequence": sequence, "time_s": time_s, "luminance_scale": scale}},
        }
    ]
    return document


def _points(near: NearLightSet, factor: float) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Each near light, and its node; radius and sigma, for which the extension has no place, are in its extras."""
    strength = near.intensity.max(axis=1, initial=0).astype(np.float64)
    colours = np.divide(near.intensity, strength[:, None], out=np.ones_like(near.intensity), where=strength[:, None] > 0)
    for row, colour, intensity in zip(near_light_rows(near), colours.tolist(), (strength * factor).tolist(), strict=True):
        name, (x, y, z) = f"point_{row.id:04d}", row.at
        light = {"name": name, "type": "point", "color": colour, "intensity": intensity}
        yield light, {"name": name, "translation": [x, z, -y], "extras": {"vemlight": msgspec.to_builtins(row)}}


def _extras(lights: LightSet, punctual: Punctual) -> list[dict[str, Any]]:
    """What the extension has no place for."""
    return [
        {"id": number, "irradiance": irradiance, "angle_deg": angle}
        for number, irradiance, angle in zip(
            lights.ids.tolist(), lights.irradiance.tolist(), punctual.angle_deg.tolist(), strict=True
        )
    ]


def write_gltf(path: Path, document: dict[str, Any]) -> None:
    """Writes .gltf (JSON) or .glb (the same in one chunk). Raises OSError when the disk refuses."""
    content = msgspec.json.encode(document)
    if path.suffix.lower() == ".glb":
        content += b" " * (-len(content) % 4)
        head = struct.pack("<3I", GLB_MAGIC, GLB_VERSION, 20 + len(content))
        content = head + struct.pack("<2I", len(content), JSON_CHUNK) + content
    with written_whole(path) as part:
        part.write_bytes(content)
