"""One frame's lights as a glTF 2.0 file with KHR_lights_punctual: directional lights in lx, y up, a node for each."""

import struct
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from vemlight.exchange.punctual import Punctual
from vemlight.files import written_whole
from vemlight.light.light_set import LightSet

EXTENSION = "KHR_lights_punctual"
LM_PER_W = 683.0  # of light at 540 THz (SI, 2019): importers divide lx by it to get W/m2
GLB_MAGIC, GLB_VERSION, JSON_CHUNK = 0x46546C67, 2, 0x4E4F534A  # "glTF", "JSON"


def gltf_from_lights(lights: LightSet, sequence: int, time_s: float, scale: float | None = None) -> dict[str, Any]:
    """The document. scale: luminance scale in cd/m2 per unit, by which irradiance becomes lx; None: LM_PER_W."""
    turned = lights._replace(directions=lights.directions[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32))  # (x, y, z) -> (x, z, -y)
    punctual = Punctual.of(turned)
    illuminance = punctual.strength.astype(np.float64) * (LM_PER_W if scale is None else scale)
    document: dict[str, Any] = {"asset": {"version": "2.0", "generator": "vemlight"}, "scene": 0}
    names = [f"light_{number:04d}" for number in lights.ids.tolist()]
    if names:
        document["extensionsUsed"] = [EXTENSION]
        document["extensions"] = {
            EXTENSION: {
                "lights": [
                    {"name": name, "type": "directional", "color": colour, "intensity": intensity}
                    for name, colour, intensity in zip(names, punctual.colour.tolist(), illuminance.tolist(), strict=True)
                ]
            }
        }
        document["nodes"] = [
            {"name": name, "rotation": rotation, "extensions": {EXTENSION: {"light": k}}, "extras": {"vemlight": row}}
            for k, (name, rotation, row) in enumerate(zip(names, punctual.rotation.tolist(), _extras(lights, punctual), strict=True))
        ]
    document["scenes"] = [
        {
            "name": "vemlight",
            **({"nodes": list(range(len(names)))} if names else {}),
            "extras": {"vemlight": {"sequence": sequence, "time_s": time_s, "luminance_scale": scale}},
        }
    ]
    return document


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
