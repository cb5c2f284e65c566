"""Meshes from files: glTF, OBJ, PLY and STL, with the materials and the motion that the file gives them."""

import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh

from vemlight.errors import UserError
from vemlight.files import one_line
from vemlight.renderer.scene.animation import ALL_ANIMATIONS, RigidMotion, animation_names, read_motions
from vemlight.renderer.scene.gltf import TRIANGLE_STRIP, TRIANGLES, GltfFile
from vemlight.renderer.scene.gltf_materials import GltfMaterials
from vemlight.renderer.scene.gltf_nodes import read_nodes
from vemlight.renderer.scene.materials import Material, Phong
from vemlight.renderer.scene.meshes import Geometry, VertexAttributes, clean_geometry
from vemlight.renderer.scene.trimesh_materials import colours_from_visual, material_from_visual

GLTF_SUFFIXES = (".glb", ".gltf")
MESH_SUFFIXES = (*GLTF_SUFFIXES, ".obj", ".ply", ".stl")
FAULTS = (ValueError, LookupError, TypeError, AttributeError, OverflowError, OSError, struct.error, SyntaxError)  # the last: PIL's, of PNG


class MeshPart(NamedTuple):
    """A mesh of a file; material: None where the file gives none; motion: how its animation moves it, in the file's axes."""

    name: str
    geometry: Geometry
    material: Material | None
    motion: RigidMotion | None = None


class MeshFile(NamedTuple):
    """parts: the meshes, in the file's axes with its node transforms applied. unsupported: a line for each feature that is not drawn."""

    parts: list[MeshPart]
    unsupported: list[str]


class SourceMesh(NamedTuple):
    """A mesh as its file has it. triangles: (m, 3). file_from_mesh: (4, 4)."""

    vertices: VertexAttributes
    triangles: np.ndarray
    file_from_mesh: np.ndarray
    material: Material | None
    motion: RigidMotion | None = None


def read_meshes(path: Path, where: str, animation: str = "", materials: bool = True) -> MeshFile:
    """Each mesh in a glTF, OBJ, PLY or STL file.

    animation: which of several, as in animation.py. materials: whether glTF's own are read. Raises UserError that begins with `where` for a
    file that cannot be read or requires what is not read here, and for a mesh that is empty, holds nan or has no area.
    """
    is_gltf = path.suffix.lower() in GLTF_SUFFIXES
    try:
        file = GltfFile(path) if is_gltf else None
        file_materials = GltfMaterials(file) if file else None
        meshes = _gltf_meshes(file, file_materials, animation, materials) if file and file_materials else _trimesh_meshes(path)
        unsupported = _unsupported(file, file_materials, animation) if file and file_materials else []
    except Exception as error:  # a hostile file raises whatever the parsers trip over
        raise UserError(f"{where}: {path} is not a readable mesh ({one_line(error)}); export it again") from error
    if not meshes:
        raise UserError(f"{where}: {path} has no triangles; export it again")
    parts = []
    for number, mesh in enumerate(meshes, 1):
        name = path.name if len(meshes) == 1 else f"{path.name} part {number}"
        try:
            geometry = _in_file_axes(mesh)
        except FAULTS as error:
            raise UserError(f"{where}: {name} {one_line(error)}; export it again") from error
        coloured = mesh.material is None and mesh.vertices.colours is not None
        parts.append(MeshPart(name, geometry, Phong((1.0, 1.0, 1.0)) if coloured else mesh.material, mesh.motion))
    return MeshFile(parts, [f"{path.name}: {line}" for line in unsupported])


def _gltf_meshes(file: GltfFile, file_materials: GltfMaterials, animation: str, materials: bool) -> list[SourceMesh]:
    """The primitives of triangles and strips of each node. One that several nodes have is read once."""
    tree = read_nodes(file)
    read: dict[int, tuple[VertexAttributes, np.ndarray, Material | None]] = {}
    meshes = []
    for node, motion in zip(tree.mesh_nodes, read_motions(file, tree, animation), strict=True):
        for primitive in node.mesh["primitives"]:
            if primitive.get("mode", TRIANGLES) in (TRIANGLES, TRIANGLE_STRIP):
                if id(primitive) not in read:
                    vertices = _gltf_vertices(file, file_materials, primitive)
                    triangles = file.triangles(primitive, len(vertices.positions))
                    read[id(primitive)] = vertices, triangles, file_materials.material(primitive) if materials else None
                vertices, triangles, material = read[id(primitive)]
                meshes.append(SourceMesh(vertices, triangles, node.file_from_mesh, material, motion))
    return meshes


def _gltf_vertices(file: GltfFile, file_materials: GltfMaterials, primitive: dict[str, Any]) -> VertexAttributes:
    attributes = primitive["attributes"]
    normals = file.array(attributes["NORMAL"]) if "NORMAL" in attributes else None
    uvs, second_uvs = file_materials.uvs(primitive)
    vertices = VertexAttributes(file.array(attributes["POSITION"]), normals, uvs, file_materials.colours(primitive), second_uvs)
    if any(values is not None and len(values) != len(vertices.positions) for values in vertices):
        raise ValueError("has more or fewer normals, colours or texture coordinates than vertices")
    return vertices


def _trimesh_meshes(path: Path) -> list[SourceMesh]:
    """The meshes of an OBJ, PLY or STL file."""
    scene = trimesh.load_scene(path, process=False, maintain_order=True)
    meshes = []
    for node in scene.graph.nodes_geometry:
        matrix, key = scene.graph[node]
        mesh = scene.geometry[key]
        if isinstance(mesh, trimesh.Trimesh):
            material, uvs = material_from_visual(mesh.visual)
            # Those that the file has: trimesh's property would compute its own.
            normals = np.asarray(mesh.vertex_normals) if "vertex_normals" in mesh._cache.cache else None
            vertices = VertexAttributes(np.asarray(mesh.vertices), normals, uvs, colours_from_visual(mesh.visual))
            meshes.append(SourceMesh(vertices, np.asarray(mesh.faces), np.asarray(matrix, np.float64), material))
    return meshes


def _unsupported(file: GltfFile, file_materials: GltfMaterials, animation: str) -> list[str]:
    file_materials.note_unsupported()
    names = animation_names(file)
    if len(names) < 2 or animation:
        return file_materials.unsupported
    others = f'animation = "{ALL_ANIMATIONS}" plays all, or name one of {", ".join(names)[:200]}'
    return [*file_materials.unsupported, f"of its {len(names)} animations the first plays: {others}"]


def _in_file_axes(mesh: SourceMesh) -> Geometry:
    """Clean geometry of a mesh in its file's axes."""
    linear, offset = mesh.file_from_mesh[:3, :3], mesh.file_from_mesh[:3, 3]
    vertices = mesh.vertices
    positions = vertices.positions @ linear.T + offset
    normals = None if vertices.normals is None else vertices.normals @ np.linalg.inv(linear)
    triangles = mesh.triangles if np.linalg.det(linear) > 0 else mesh.triangles[:, ::-1]
    return clean_geometry(vertices._replace(positions=positions, normals=normals), triangles)
