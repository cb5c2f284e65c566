"""Lights of glTF files (KHR_lights_punctual): points and spots as lamps of the scene; light from infinitely far away is the map's."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from vemlight.light.far_field import FarField
from vemlight.renderer.scene.gltf import GltfFile, item
from vemlight.renderer.scene.gltf_nodes import NodeTree
from vemlight.renderer.scene.scene_limits import MAX_LUMINAIRES

MAX_CANDELA = 1e9  # a lighthouse has 10^7; products with it stay finite in float32
OUTER_CONE_RAD = np.pi / 4  # where the file names none
MIN_AXIS = 1e-12  # of a node's scale, below which its light has no direction; any value in 1e-30 .. 1e-9 does
EDGE_RINGS = 64  # of the table across the soft edge of a cone; 16 to 256 do


class FileLamp(NamedTuple):
    """A lamp of a file, which shines along its own +z. file_from_lamp: (4, 4), with the scale of its nodes. colour: Rec. 709, times it."""

    name: str
    file_from_lamp: np.ndarray
    far_field: FarField
    colour: tuple[float, float, float]


def read_lamps(file: GltfFile, tree: NodeTree, note: Callable[[str], None]) -> list[FileLamp]:
    """The points and spots of the file's scene, by the names of their nodes, else of the lights. note: takes a line for what is not drawn.

    Intensity is in candela, as the standard has it. Raises ValueError for lights that it does not allow.
    """
    lights = file.document.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    moving = {channel["target"].get("node") for animation in file.document.get("animations", []) for channel in animation["channels"]}
    found: list[FileLamp] = []
    for number, file_from_node in tree.light_nodes:
        node = file.document["nodes"][number]
        light: dict[str, Any] = item(lights, node["extensions"]["KHR_lights_punctual"]["light"], "lights")
        name = str(node.get("name") or light.get("name") or f"lamp {len(found) + 1}")[:56]
        if light["type"] == "directional":
            note(f"its light {name} is left out: it comes from infinitely far away, as that of the map does")
            continue
        if not np.isfinite(file_from_node).all() or np.linalg.norm(file_from_node[:3, :3], axis=0).min() < MIN_AXIS:
            note(f"its light {name} is left out: its scale is 0")
            continue
        if len(found) >= MAX_LUMINAIRES:
            raise ValueError(f"has more than {MAX_LUMINAIRES} lamps; leave some out")
        if "range" in light:
            note(f"the range of its light {name} is left out: it reaches as far as light does")
        if not moving.isdisjoint(tree.path(number)):
            note(f"its light {name} stands still: the animation of lamps is not played")
        colour = np.asarray(light.get("color", (1.0, 1.0, 1.0)), np.float64)
        if colour.shape != (3,) or not ((colour >= 0) & (colour <= 1)).all():
            raise ValueError(f"has a light with the colour {str(light['color'])[:60]}")
        red, green, blue = colour.tolist()
        lamp_along_z = file_from_node @ np.diag([1.0, -1.0, -1.0, 1.0])  # a node's light shines along its -z
        found.append(FileLamp(name, lamp_along_z, _far_field(light, name), (red, green, blue)))
    return found


def _far_field(light: dict[str, Any], name: str) -> FarField:
    """Intensity over the angle from the axis."""
    candela = float(light.get("intensity", 1.0))
    if not 0 <= candela <= MAX_CANDELA:
        raise ValueError(f"has a light of {candela:g} cd")
    if light["type"] == "point":
        gamma = np.array([0.0, 180.0])
        values = np.ones(2)
    elif light["type"] == "spot":
        spot = light.get("spot", {})
        inner, outer = float(spot.get("innerConeAngle", 0.0)), float(spot.get("outerConeAngle", OUTER_CONE_RAD))
        if not 0 <= inner < outer <= np.pi / 2 + 1e-6:
            raise ValueError(f"has a spot with cones of {inner:g} and {outer:g} rad")
        edge = np.linspace(inner, outer, EDGE_RINGS)
        # the falloff that the extension recommends: squared, linear in the cosine
        gamma = np.degrees(np.concatenate([[0.0], edge[edge > 0], [np.pi]]))
        scale = 1 / max(1e-3, np.cos(inner) - np.cos(outer))
        values = np.clip((np.cos(np.radians(gamma)) - np.cos(outer)) * scale, 0, 1) ** 2
    else:
        raise ValueError(f"has a light of type {str(light['type'])[:20]}")
    return FarField(candela * np.stack([values, values]), np.array([0.0, 360.0]), gamma, (0.0, 0.0, 0.0), float("nan"), name)
