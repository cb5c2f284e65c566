"""Cameras of glTF files (glTF 2.0, section 3.10): where they are placed, and what they see."""

import math
from typing import Any, NamedTuple

import numpy as np

from vemlight.renderer.scene.gltf import GltfFile, item
from vemlight.renderer.scene.gltf_nodes import NodeTree


class FileCamera(NamedTuple):
    """A camera of a file. It looks along its -z, +y is on top.

    fov_y_deg: from the lower to the upper edge; None for one without perspective. moves: whether an animation of the file moves it.
    """

    name: str
    file_from_camera: np.ndarray
    fov_y_deg: float | None
    moves: bool


def read_cameras(file: GltfFile, tree: NodeTree) -> list[FileCamera]:
    """The cameras of the file's scene by the names of their nodes, else of the cameras, else their numbers from 1."""
    cameras = file.document.get("cameras", [])
    moving = {channel["target"].get("node") for animation in file.document.get("animations", []) for channel in animation["channels"]}
    found: list[FileCamera] = []
    for number, file_from_node in tree.camera_nodes:
        node = file.document["nodes"][number]
        camera: dict[str, Any] = item(cameras, node["camera"], "cameras")
        fov_y = float(camera["perspective"]["yfov"]) if camera["type"] == "perspective" else None
        if fov_y is not None and not 0 < fov_y < math.pi:
            raise ValueError(f"has a camera with a field of view of {fov_y:g} rad")
        name = str(node.get("name") or camera.get("name") or len(found) + 1)
        moves = not moving.isdisjoint(tree.path(number))
        found.append(FileCamera(name, file_from_node, None if fov_y is None else math.degrees(fov_y), moves))
    return found
