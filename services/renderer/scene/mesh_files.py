"""Meshes from files: glTF, OBJ, PLY and STL, with what the file says of their looks and their motion."""

import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh

from vemlight.errors import UserError
from vemlight.renderer.scene.animation import ALL_ANIMATIONS, RigidMotion, animation_names, read_motions
from vemlight.renderer.scene.gltf import GltfFile
from vemlight.renderer.scene.gltf_materials import GltfMaterials
from vemlight.renderer.scene.materials import Material, Phong, colours_from_visual, material_from_visual
from vemlight.renderer.scene.meshes import Geometry, clean_geometry

FAULTS = (ValueError, LookupError, TypeError, AttributeError, OverflowError, OSError, struct.error, SyntaxError)  # the last: PIL's, of PNG


class MeshPart(NamedTuple):
    """A mesh of a file; material: what the file says it is made of; motion: how its animation moves it, in the file's axes."""

    name: str
    geometry: Geometry
    material: Material | None
    motion: RigidMotion | None = None


class MeshFile(NamedTuple):
    """parts: the meshes, in the file's own axes with its scene graph applied. left_out: a line for each thing that is not drawn."""

    parts: list[MeshPart]
    left_out: list[str]


class VertexAttributes(NamedTuple):
    """What a file says of a mesh's vertices, (n, ...) each, as in Geometry; None where it says nothing."""

    positions: np.ndarray
    normals: np.ndarray | None
    uvs: np.ndarray | None
    colours: np.ndarray | None
    second_uvs: np.ndarray | None = None


def read_meshes(path: Path, where: str, animation: str = "", materials: bool = True) -> MeshFile:
    """Each mesh in a glTF, OBJ, PLY or STL file.

    animation: which of several, as animation.py has it. materials: whether the file's own are wanted. Raises UserError that begins with
    `where` when the file cannot be read, needs what is not read here, or a mesh in it is empty, holds nan or has no area.
    """
    file = looks = None
    try:
        if path.suffix.lower() in (".glb", ".gltf"):
            file = GltfFile(path)
            looks = GltfMaterials(file)
        plain: dict[str, Any] = {"skip_materials": True} if file else {}
        loaded = trimesh.load_scene(path, process=False, maintain_order=True, **plain)
        motions = read_motions(file, animation) if file else {}
        placed = [(*loaded.graph[node], _motion_of(node, loaded, motions)) for node in loaded.graph.nodes_geometry]
        nodes = [(matrix, str(key), motion) for matrix, key, motion in placed if isinstance(loaded.geometry[key], trimesh.Trimesh)]
        primitives = file.primitives() if file else {}
    except Exception as error:  # a hostile file raises whatever the parser below trips over
        raise UserError(f"{where}: {path} is not a readable mesh ({_line(error)}); export it again") from error
    found = []
    seen: dict[str, tuple[Material | None, VertexAttributes]] = {}
    for number, (matrix, key, motion) in enumerate(nodes, 1):
        name = path.name if len(nodes) == 1 else f"{path.name} part {number}"
        mesh = loaded.geometry[key]
        try:
            if key not in seen:
                seen[key] = _gltf_seen(file, looks, primitives[key], materials) if file and looks else _plain_seen(mesh)
            material, vertices = seen[key]
            if material is None and vertices.colours is not None:
                material = Phong((1.0, 1.0, 1.0))
            geometry = _in_file_axes(vertices, np.asarray(mesh.faces), np.asarray(matrix, np.float64))
        except FAULTS as error:
            raise UserError(f"{where}: {name} {_line(error)}; export it again") from error
        found.append(MeshPart(name, geometry, material, motion))
    if not found:
        raise UserError(f"{where}: {path} has no triangles; export it again")
    try:
        return MeshFile(found, [f"{path.name}: {line}" for line in _left_out(file, looks, animation)] if file and looks else [])
    except FAULTS as error:
        raise UserError(f"{where}: {path.name} {_line(error)}; export it again") from error


def _left_out(file: GltfFile, looks: GltfMaterials, animation: str) -> list[str]:
    looks.say_what_else()
    names = animation_names(file)
    if len(names) < 2 or animation:
        return looks.left_out
    others = f'animation = "{ALL_ANIMATIONS}" plays all, or name one of {", ".join(names)[:200]}'
    return [*looks.left_out, f"of its {len(names)} animations the first plays: {others}"]


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def _motion_of(node: str, loaded: trimesh.Scene, motions: dict[str, RigidMotion]) -> RigidMotion | None:
    """A node's motion; a mesh of several materials stands in nodes of trimesh's own below the file's."""
    return motions.get(node) or motions.get(loaded.graph.transforms.parents.get(node, ""))


def _plain_seen(mesh: trimesh.Trimesh) -> tuple[Material | None, VertexAttributes]:
    """Of a file without glTF. Its normals are those that the file had; trimesh's property would compute its own."""
    material, uvs = material_from_visual(mesh.visual)
    normals = np.asarray(mesh.vertex_normals) if "vertex_normals" in mesh._cache.cache else None
    return material, VertexAttributes(np.asarray(mesh.vertices), normals, uvs, colours_from_visual(mesh.visual))


def _gltf_seen(
    file: GltfFile, looks: GltfMaterials, primitive: dict[str, Any], materials: bool
) -> tuple[Material | None, VertexAttributes]:
    """Of a primitive, read here: trimesh knows neither sparse nor normalised numbers."""
    attributes = primitive["attributes"]
    normals = file.array(attributes["NORMAL"]) if "NORMAL" in attributes else None
    uvs, second = looks.uvs(primitive)
    vertices = VertexAttributes(file.array(attributes["POSITION"]), normals, uvs, looks.colours(primitive), second)
    if any(values is not None and len(values) != len(vertices.positions) for values in vertices):
        raise ValueError("has more or fewer normals, colours or texture coordinates than vertices")
    return looks.material(primitive) if materials else None, vertices


def _in_file_axes(vertices: VertexAttributes, faces: np.ndarray, matrix: np.ndarray) -> Geometry:
    """Clean geometry of a node's mesh under the node's transform (4, 4)."""
    positions = vertices.positions @ matrix[:3, :3].T + matrix[:3, 3]
    normals = None if vertices.normals is None else vertices.normals @ np.linalg.inv(matrix[:3, :3])
    faces = faces if np.linalg.det(matrix[:3, :3]) > 0 else faces[:, ::-1]
    return clean_geometry(positions, faces, normals, vertices.uvs, vertices.colours, vertices.second_uvs)
