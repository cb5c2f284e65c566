"""Meshes from files: glTF, USD, OBJ, PLY and STL, with the materials and the motion that the file gives them."""

import codecs
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.errors import UserError
from vemlight.files import one_line, read_file
from vemlight.renderer.scene.animation import ALL_ANIMATIONS, RigidMotion, animation_names, read_motions
from vemlight.renderer.scene.files_beside import MAX_LINES, FilesBeside
from vemlight.renderer.scene.gltf import MODES, TRIANGLES, GltfFile
from vemlight.renderer.scene.gltf_cameras import FileCamera, read_cameras
from vemlight.renderer.scene.gltf_lights import FileLamp, read_lamps
from vemlight.renderer.scene.gltf_materials import GltfMaterials
from vemlight.renderer.scene.gltf_nodes import NodeTree, read_nodes
from vemlight.renderer.scene.materials import Material, Phong
from vemlight.renderer.scene.meshes import MAX_SIZE_M, Geometry, NothingToDraw, VertexAttributes, clean_geometry, is_similarity
from vemlight.renderer.scene.obj_files import read_obj
from vemlight.renderer.scene.ply_files import read_ply
from vemlight.renderer.scene.scene_limits import FREE_CORNERS, MAX_MESHES, SceneLimits
from vemlight.renderer.scene.source_mesh import FileMeshes, SourceMesh, used_vertices
from vemlight.renderer.scene.stl_files import read_stl
from vemlight.renderer.scene.usd_files import USD_SUFFIXES, read_usd

GLTF_SUFFIXES = (".glb", ".gltf")
MAX_BYTES = 2**29  # of an OBJ, PLY or STL: 5 million triangles with normals and texture coordinates in text
NODE_SUFFIXES = (*GLTF_SUFFIXES, *USD_SUFFIXES)  # scenes of nodes, with y up, materials, cameras and animation
MESH_SUFFIXES = (*NODE_SUFFIXES, ".obj", ".ply", ".stl")
FLATTENED = 1e-12  # of a transform's largest scale, so much along another axis is none; any value in 1e-14 .. 1e-9 does
MIN_SCALE = 1e-6  # of an instance, along each axis; any value in 1e-12 .. 1e-3 does


class MeshPart(NamedTuple):
    """A mesh of a file; material: None where the file gives none; motion: how its animation moves it, in the file's axes."""

    name: str
    geometry: Geometry
    material: Material | None
    motion: RigidMotion | None = None


class MeshFile(NamedTuple):
    """What a file holds, in its own axes.

    parts: the meshes, with the transforms of their nodes applied. unsupported: a line for each feature that is not drawn. cameras: of a
    glTF, as are lamps.
    """

    parts: list[MeshPart]
    unsupported: list[str]
    cameras: tuple[FileCamera, ...] = ()
    lamps: tuple[FileLamp, ...] = ()


def read_meshes(path: Path, where: str, animation: str = "", materials: bool = True, limits: SceneLimits | None = None) -> MeshFile:
    """Each mesh in a glTF, USD, OBJ, PLY or STL file.

    animation: which of several, as in animation.py. materials: whether glTF's own are read. limits: of the scene that the file is part of.
    Raises UserError that begins with `where` for a file that cannot be read, requires what is not read here or refers to a file outside
    its folder, and for a mesh that is empty, holds nan or has no area.
    """
    limits, cameras, lamps = limits or SceneLimits(), (), ()
    try:
        with np.errstate(all="ignore"):  # of numbers that are found to be none afterwards
            if path.suffix.lower() in NODE_SUFFIXES:
                usd = read_usd(path) if path.suffix.lower() in USD_SUFFIXES else None
                file = GltfFile(path, content=usd.glb, stored_bytes=usd.stored_bytes) if usd else GltfFile(path)
                file_materials = GltfMaterials(file)
                tree = read_nodes(file)
                cameras = tuple(read_cameras(file, tree))
                meshes, left_out = _gltf_meshes(file, tree, file_materials, limits, animation, materials)
                left_out += _unsupported(file, file_materials, animation)
                left_out += usd.left_out if usd else []
                not_lit: dict[str, None] = {}
                lamps = tuple(read_lamps(file, tree, lambda line: not_lit.setdefault(line)))
                left_out += list(not_lit)[:MAX_LINES]
            else:
                meshes, left_out = _meshes_of_other_files(path, limits)
    except UserError as error:
        raise UserError(f"{where}: {error}") from error
    except Exception as error:  # a hostile file raises whatever the parsers trip over
        raise UserError(f"{where}: {path} is not a readable mesh ({one_line(error)}); export it again") from error
    if not meshes:
        detail = f" that can be drawn ({left_out[0]})" if left_out else ""
        raise UserError(f"{where}: {path} has no triangles{detail}; export it again")
    return MeshFile(_placed(meshes, path, where, limits, left_out), [f"{path.name}: {line}" for line in left_out], cameras, lamps)


def _placed(meshes: list[SourceMesh], path: Path, where: str, limits: SceneLimits, left_out: list[str]) -> list[MeshPart]:
    """Clean meshes in their file's axes. One that several nodes have is cleaned once, if no node stretches it.

    left_out: gets a line for each mesh without area. Raises UserError where none has any.
    """
    nodes = Counter(id(mesh.triangles) for mesh in meshes)
    shared = [nodes[id(mesh.triangles)] > 1 and _keeps_shape(mesh.file_from_mesh[:3, :3]) for mesh in meshes]
    once = {id(mesh.triangles): len(mesh.triangles) for mesh, is_shared in zip(meshes, shared, strict=True) if is_shared}
    each = sum(len(mesh.triangles) for mesh, is_shared in zip(meshes, shared, strict=True) if not is_shared)
    cleaned: dict[int, Geometry] = {}
    parts: list[MeshPart] = []
    empty: list[str] = []
    name = path.name
    try:
        limits.on_cleaned(each + sum(once.values()))
        for number, (mesh, is_shared) in enumerate(zip(meshes, shared, strict=True), 1):
            name = path.name if len(meshes) == 1 else f"{path.name} part {number}"
            try:
                with np.errstate(all="ignore"):
                    geometry = _moved(mesh, cleaned, limits) if is_shared else _in_file_axes(mesh, limits)
            except NothingToDraw as error:
                empty.append(f"{name.removeprefix(path.name).strip()} {error}")
                continue
            coloured = mesh.material is None and mesh.vertices.colours is not None
            parts.append(MeshPart(name, geometry, Phong((1.0, 1.0, 1.0)) if coloured else mesh.material, mesh.motion))
    except Exception as error:  # as above
        raise UserError(f"{where}: {name} {one_line(error)}; export it again") from error
    if not parts:
        raise UserError(f"{where}: {path.name} {empty[0].strip()}; export it again")
    left_out += [f"{line} and is left out" for line in empty[:MAX_LINES]]
    return parts


def _gltf_meshes(
    file: GltfFile, tree: NodeTree, file_materials: GltfMaterials, limits: SceneLimits, animation: str, materials: bool
) -> tuple[list[SourceMesh], list[str]]:
    """The primitives of triangles, strips and fans of each node, and a line for each thing that is left out.

    A primitive that several nodes have is read once.
    """
    read: dict[int, tuple[VertexAttributes, np.ndarray, Material | None]] = {}
    meshes, numbers, left_out = [], 0, dict[str, None]()
    for node, motion in zip(tree.mesh_nodes, read_motions(file, tree, animation), strict=True):
        name = str(file.document["nodes"][node.number].get("name", node.number))[:60]
        if _is_hidden(node.file_from_mesh[:3, :3]) or (motion and motion.begins_flat):
            left_out[f"node {name} is left out: its scale is 0{' where its animation begins' if motion else ''}"] = None
            continue
        for primitive in node.mesh["primitives"]:
            if primitive.get("mode", TRIANGLES) not in MODES:
                continue
            if file.is_empty(primitive):
                left_out[f"a mesh of node {name} is left out: it is empty"] = None
                continue
            if len(meshes) >= MAX_MESHES:
                raise ValueError(f"draws more than {MAX_MESHES} meshes; join them")
            if id(primitive) not in read:
                numbers += _numbers_of(file, primitive)
                if numbers > max(FREE_CORNERS, file.stored_bytes):
                    raise ValueError(f"has {numbers} vertices and corners in {file.stored_bytes} bytes; repeat fewer of them")
                vertices = _gltf_vertices(file, file_materials, primitive)
                triangles = file.triangles(primitive, len(vertices.positions))
                material = file_materials.material(primitive) if materials else None
                read[id(primitive)] = *used_vertices(vertices, triangles), material
            vertices, triangles, material = read[id(primitive)]
            meshes.append(SourceMesh(vertices, triangles, node.file_from_mesh, material, motion))
    limits.on_stored(file.stored_bytes)
    return meshes, list(left_out)[:MAX_LINES]


def _is_hidden(linear: np.ndarray) -> bool:
    """Whether a transform (3, 3) makes a line or a point of everything, as a scale of 0 does by which tools hide a node."""
    if not np.isfinite(linear).all():
        return False
    sizes = np.linalg.svd(linear, compute_uv=False)
    return bool(sizes[1] <= FLATTENED * sizes[0])


def _numbers_of(file: GltfFile, primitive: dict[str, Any]) -> int:
    """How many vertices and corners of triangles a primitive has, of which copies are made."""
    return len(file.array(primitive["attributes"]["POSITION"])) + (len(file.array(primitive["indices"])) if "indices" in primitive else 0)


def _gltf_vertices(file: GltfFile, file_materials: GltfMaterials, primitive: dict[str, Any]) -> VertexAttributes:
    attributes = primitive["attributes"]
    normals = file.array(attributes["NORMAL"]) if "NORMAL" in attributes else None
    uvs, second_uvs = file_materials.uvs(primitive)
    vertices = VertexAttributes(file.array(attributes["POSITION"]), normals, uvs, file_materials.colours(primitive), second_uvs)
    if any(values is not None and len(values) != len(vertices.positions) for values in vertices):
        raise ValueError("has more or fewer normals, colours or texture coordinates than vertices")
    return vertices


def _meshes_of_other_files(path: Path, limits: SceneLimits) -> FileMeshes:
    """The meshes of an OBJ, PLY or STL file, and a line for each thing that is left out."""
    content, kind = read_file(path, MAX_BYTES).removeprefix(codecs.BOM_UTF8), path.suffix.lower()
    limits.on_stored(len(content))
    if kind == ".stl":
        return read_stl(content)
    beside = FilesBeside(path.parent, str(path))
    return read_obj(content, beside) if kind == ".obj" else read_ply(content, beside)


def _unsupported(file: GltfFile, file_materials: GltfMaterials, animation: str) -> list[str]:
    file_materials.note_unsupported()
    names = animation_names(file)
    if len(names) < 2 or animation:
        return file_materials.unsupported
    others = f'animation = "{ALL_ANIMATIONS}" plays all, or name one of {", ".join(names)[:200]}'
    return [*file_materials.unsupported, f"of its {len(names)} animations the first plays: {others}"]


def _in_file_axes(mesh: SourceMesh, limits: SceneLimits) -> Geometry:
    """Clean geometry of a mesh in its file's axes."""
    linear, offset = mesh.file_from_mesh[:3, :3], mesh.file_from_mesh[:3, 3]
    vertices = mesh.vertices
    positions = vertices.positions @ linear.T + offset
    flat = abs(np.linalg.det(linear)) <= FLATTENED * np.linalg.norm(linear) ** 3  # its normals have no direction left
    normals = None if vertices.normals is None or flat else vertices.normals @ np.linalg.inv(linear)
    triangles = mesh.triangles if np.linalg.det(linear) > 0 else mesh.triangles[:, ::-1]
    geometry = clean_geometry(vertices._replace(positions=positions, normals=normals), triangles)
    limits.on_placed(len(geometry.positions))
    return geometry


def _moved(mesh: SourceMesh, cleaned: dict[int, Geometry], limits: SceneLimits) -> Geometry:
    """The same of a mesh that other nodes have, too. cleaned: geometry in the meshes' own axes, by their triangles."""
    if id(mesh.triangles) not in cleaned:
        cleaned[id(mesh.triangles)] = clean_geometry(mesh.vertices, mesh.triangles)
    geometry = cleaned[id(mesh.triangles)]
    limits.on_placed(len(geometry.positions))
    geometry = geometry.moved(mesh.file_from_mesh[:3, :3], mesh.file_from_mesh[:3, 3])
    if not np.abs(geometry.positions).max() < MAX_SIZE_M:
        raise ValueError(f"lies farther than {MAX_SIZE_M:.0e} m from its file's origin")
    return geometry


def _keeps_shape(linear: np.ndarray) -> bool:
    """Whether a transform (3, 3) is a rotation with uniform scale, not too small."""
    return is_similarity(linear) and float(np.cbrt(np.linalg.det(linear))) > MIN_SCALE
