"""The node hierarchy of glTF files: which meshes a scene has, and the transforms from the root down to each (glTF 2.0, section 3.5)."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from vemlight.renderer.scene.gltf import GltfFile, item

MAX_NODES = 100_000  # 30 microseconds each
MAX_DEPTH = 256  # of the hierarchy; rigs have some dozens


class NodeTransform(NamedTuple):
    """Translation (3,), rotation as a quaternion x, y, z, w (4,) of any length above 0, and scale (3,) of a node, float64."""

    translation: np.ndarray
    rotation: np.ndarray
    scale: np.ndarray

    def matrix(self) -> np.ndarray:
        """The transform (4, 4) that scales, rotates and translates, in this order."""
        matrix = np.eye(4)
        matrix[:3, :3] = _rotation(self.rotation) * self.scale
        matrix[:3, 3] = self.translation
        return matrix


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) of a quaternion x, y, z, w of any length above 0."""
    if not quaternion[:3].any():
        return np.eye(3)
    from scipy.spatial.transform import Rotation  # here, since it takes a third of a second to load, and most nodes stand as they are

    return Rotation.from_quat(quaternion).as_matrix()


class MeshNode(NamedTuple):
    """A node with a mesh, or one of its instances. mesh: as the document has it. file_from_mesh: (4, 4), without animation."""

    number: int
    mesh: Mapping[str, Any]
    file_from_mesh: np.ndarray


class NodeTree(NamedTuple):
    """The nodes of a file's scene.

    mesh_nodes: in the order they are drawn. parents: of each node, None for a root. camera_nodes, light_nodes: numbers of those with a
    camera and with a light, and their transforms (4, 4), file_from_node.
    """

    mesh_nodes: list[MeshNode]
    parents: Mapping[int, int | None]
    camera_nodes: list[tuple[int, np.ndarray]]
    light_nodes: list[tuple[int, np.ndarray]]

    def path(self, number: int) -> tuple[int, ...]:
        """The numbers of the nodes from the root down to a node."""
        path: list[int] = []
        above: int | None = number
        while above is not None:
            path.append(above)
            above = self.parents[above]
        return tuple(reversed(path))


def read_nodes(file: GltfFile) -> NodeTree:
    """The nodes of the file's scene; none where it has no scene, and of those that the file hides only cameras.

    Raises ValueError for a node that has two parents.
    """
    document = file.document
    nodes, meshes = document.get("nodes", []), document.get("meshes", [])
    scenes = document.get("scenes", [])
    roots = item(scenes, document.get("scene", 0), "scenes").get("nodes", []) if scenes else []
    found: list[MeshNode] = []
    camera_nodes: list[tuple[int, np.ndarray]] = []
    light_nodes: list[tuple[int, np.ndarray]] = []
    parents: dict[int, int | None] = {}
    stack: list[tuple[int, int | None, int, np.ndarray, bool]] = [(root, None, 1, np.eye(4), True) for root in roots]
    while stack:  # depth first, the last child before the first
        number, parent, depth, file_from_parent, visible = stack.pop()
        if number in parents:
            raise ValueError("has nodes with several parents")
        if len(parents) >= MAX_NODES or depth > MAX_DEPTH:
            raise ValueError(f"has more than {MAX_NODES} nodes, or more than {MAX_DEPTH} inside one another; join them")
        parents[number] = parent
        node = item(nodes, number, "nodes")
        file_from_node = file_from_parent @ rest_matrix(node)
        visible = visible and node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True) is True
        stack += [(child, number, depth + 1, file_from_node, visible) for child in node.get("children", [])]
        if "camera" in node:
            camera_nodes.append((number, file_from_node))
        if not visible:
            continue
        if "KHR_lights_punctual" in node.get("extensions", {}):
            light_nodes.append((number, file_from_node))
        if "mesh" in node:
            mesh = item(meshes, node["mesh"], "meshes")
            found += [MeshNode(number, mesh, file_from_node @ placed) for placed in _instances(file, node)]
            if len(found) > MAX_NODES:
                raise ValueError(f"has more than {MAX_NODES} meshes and instances; join them")
    return NodeTree(found, parents, camera_nodes[::-1], light_nodes[::-1])


def _instances(file: GltfFile, node: Mapping[str, Any]) -> list[np.ndarray]:
    """The transforms (4, 4) of a node's mesh within the node: its instances (EXT_mesh_gpu_instancing), or one that changes nothing."""
    extension = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
    if extension is None:
        return [np.eye(4)]
    rows = {
        key: file.array(extension["attributes"][name]).reshape(-1, width)
        for name, key, width in (("TRANSLATION", "translation", 3), ("ROTATION", "rotation", 4), ("SCALE", "scale", 3))
        if name in extension["attributes"]
    }
    counts = {len(values) for values in rows.values()}
    if len(counts) != 1 or max(counts) > MAX_NODES:
        raise ValueError(f"has instances whose places, rotations and scales are not as many as each other, or more than {MAX_NODES}")
    return [node_transform({key: values[k] for key, values in rows.items()}).matrix() for k in range(max(counts))]


def node_transform(node: Mapping[str, Any]) -> NodeTransform:
    """A node's translation, rotation and scale as the file gives them. Raises ValueError for arrays of another length."""
    translation, rotation, scale = (
        np.array(node.get(key, default), float).reshape(len(default))
        for key, default in (("translation", (0.0, 0.0, 0.0)), ("rotation", (0.0, 0.0, 0.0, 1.0)), ("scale", (1.0, 1.0, 1.0)))
    )
    return NodeTransform(translation, rotation, scale)


def rest_matrix(node: Mapping[str, Any]) -> np.ndarray:
    """A node's transform (4, 4) from its parent's axes as the file places it, without animation."""
    return np.array(node["matrix"], float).reshape(4, 4).T if "matrix" in node else node_transform(node).matrix()
