"""Meshes from files: glTF, OBJ, PLY and STL, with the materials and the motion that the file gives them."""

import codecs
import io
import re
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vemlight.errors import UserError
from vemlight.files import one_line, read_file
from vemlight.light.quiet import silent
from vemlight.renderer.scene.animation import ALL_ANIMATIONS, RigidMotion, animation_names, read_motions
from vemlight.renderer.scene.gltf import TRIANGLE_STRIP, TRIANGLES, GltfFile
from vemlight.renderer.scene.gltf_materials import GltfMaterials
from vemlight.renderer.scene.gltf_nodes import read_nodes
from vemlight.renderer.scene.materials import Material, Phong
from vemlight.renderer.scene.meshes import MAX_SIZE_M, Geometry, VertexAttributes, clean_geometry
from vemlight.renderer.scene.scene_limits import FREE_CORNERS, MAX_MESHES, SceneLimits
from vemlight.renderer.scene.trimesh_files import MAX_BYTES, FilesBeside, check_obj, check_stl
from vemlight.renderer.scene.trimesh_materials import colours_from_visual, material_from_visual

GLTF_SUFFIXES = (".glb", ".gltf")
# Read here, so that the bundled scene does not wait for trimesh.
PLAIN_OBJ = re.compile(rb"(?:(?:#[^\r\n]*|v(?: +-?\d{1,9}(?:\.\d{1,17})?){3} *|f(?: +\d{1,9}){3} *)?\r?\n)*")
MAX_PLAIN_BYTES = 2**20  # trimesh reads larger ones sooner, and takes longer than its loading
MESH_SUFFIXES = (*GLTF_SUFFIXES, ".obj", ".ply", ".stl")
MIN_SCALE = 1e-6  # of an instance, along each axis; any value in 1e-12 .. 1e-3 does
SIMILARITY = 1e-5  # by which normals may be off in length: matrices of a file have float32's 1e-7; any value in 1e-6 .. 1e-3 does


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


def read_meshes(path: Path, where: str, animation: str = "", materials: bool = True, limits: SceneLimits | None = None) -> MeshFile:
    """Each mesh in a glTF, OBJ, PLY or STL file.

    animation: which of several, as in animation.py. materials: whether glTF's own are read. limits: of the scene that the file is part of.
    Raises UserError that begins with `where` for a file that cannot be read, requires what is not read here or refers to a file outside
    its folder, and for a mesh that is empty, holds nan or has no area.
    """
    limits = limits or SceneLimits()
    try:
        with np.errstate(all="ignore"):  # of numbers that are found to be none afterwards
            if path.suffix.lower() in GLTF_SUFFIXES:
                file = GltfFile(path)
                file_materials = GltfMaterials(file)
                meshes = _gltf_meshes(file, file_materials, limits, animation, materials)
                unsupported = _unsupported(file, file_materials, animation)
            else:
                meshes, unsupported = _trimesh_meshes(path, limits)
    except UserError as error:
        raise UserError(f"{where}: {error}") from error
    except Exception as error:  # a hostile file raises whatever the parsers trip over
        raise UserError(f"{where}: {path} is not a readable mesh ({one_line(error)}); export it again") from error
    if not meshes:
        raise UserError(f"{where}: {path} has no triangles; export it again")
    return MeshFile(_placed(meshes, path, where, limits), [f"{path.name}: {line}" for line in unsupported])


def _placed(meshes: list[SourceMesh], path: Path, where: str, limits: SceneLimits) -> list[MeshPart]:
    """Clean meshes in their file's axes. One that several nodes have is cleaned once, if no node stretches it."""
    nodes = Counter(id(mesh.triangles) for mesh in meshes)
    shared = [nodes[id(mesh.triangles)] > 1 and _is_similarity(mesh.file_from_mesh[:3, :3]) for mesh in meshes]
    once = {id(mesh.triangles): len(mesh.triangles) for mesh, is_shared in zip(meshes, shared, strict=True) if is_shared}
    each = sum(len(mesh.triangles) for mesh, is_shared in zip(meshes, shared, strict=True) if not is_shared)
    cleaned: dict[int, Geometry] = {}
    parts: list[MeshPart] = []
    name = path.name
    try:
        limits.on_cleaned(each + sum(once.values()))
        for number, (mesh, is_shared) in enumerate(zip(meshes, shared, strict=True), 1):
            name = path.name if len(meshes) == 1 else f"{path.name} part {number}"
            with np.errstate(all="ignore"):
                geometry = _moved(mesh, cleaned, limits) if is_shared else _in_file_axes(mesh, limits)
            coloured = mesh.material is None and mesh.vertices.colours is not None
            parts.append(MeshPart(name, geometry, Phong((1.0, 1.0, 1.0)) if coloured else mesh.material, mesh.motion))
    except Exception as error:  # as above
        raise UserError(f"{where}: {name} {one_line(error)}; export it again") from error
    return parts


def _gltf_meshes(
    file: GltfFile, file_materials: GltfMaterials, limits: SceneLimits, animation: str, materials: bool
) -> list[SourceMesh]:
    """The primitives of triangles and strips of each node. One that several nodes have is read once."""
    tree = read_nodes(file)
    read: dict[int, tuple[VertexAttributes, np.ndarray, Material | None]] = {}
    meshes, numbers = [], 0
    for node, motion in zip(tree.mesh_nodes, read_motions(file, tree, animation), strict=True):
        for primitive in node.mesh["primitives"]:
            if primitive.get("mode", TRIANGLES) in (TRIANGLES, TRIANGLE_STRIP):
                if len(meshes) >= MAX_MESHES:
                    raise ValueError(f"draws more than {MAX_MESHES} meshes; join them")
                if id(primitive) not in read:
                    numbers += _numbers_of(file, primitive)
                    if numbers > max(FREE_CORNERS, file.stored_bytes):
                        raise ValueError(f"has {numbers} vertices and corners in {file.stored_bytes} bytes; repeat fewer of them")
                    vertices = _gltf_vertices(file, file_materials, primitive)
                    triangles = file.triangles(primitive, len(vertices.positions))
                    material = file_materials.material(primitive) if materials else None
                    read[id(primitive)] = *_used(vertices, triangles), material
                vertices, triangles, material = read[id(primitive)]
                meshes.append(SourceMesh(vertices, triangles, node.file_from_mesh, material, motion))
    limits.on_stored(file.stored_bytes)
    return meshes


def _numbers_of(file: GltfFile, primitive: dict[str, Any]) -> int:
    """How many vertices and corners of triangles a primitive has, of which copies are made."""
    return len(file.array(primitive["attributes"]["POSITION"])) + (len(file.array(primitive["indices"])) if "indices" in primitive else 0)


def _used(vertices: VertexAttributes, triangles: np.ndarray) -> tuple[VertexAttributes, np.ndarray]:
    """The vertices that triangles use, where many others are in the same arrays: exporters share them among primitives."""
    count = len(vertices.positions)
    if count <= triangles.size or triangles.size == 0 or triangles.min() < 0 or triangles.max() >= count:
        return vertices, triangles
    used, numbers = np.unique(triangles, return_inverse=True)
    others = (None if rows is None else rows[used] for rows in vertices[1:])
    return VertexAttributes(vertices.positions[used], *others), numbers.reshape(triangles.shape)


def _gltf_vertices(file: GltfFile, file_materials: GltfMaterials, primitive: dict[str, Any]) -> VertexAttributes:
    attributes = primitive["attributes"]
    normals = file.array(attributes["NORMAL"]) if "NORMAL" in attributes else None
    uvs, second_uvs = file_materials.uvs(primitive)
    vertices = VertexAttributes(file.array(attributes["POSITION"]), normals, uvs, file_materials.colours(primitive), second_uvs)
    if any(values is not None and len(values) != len(vertices.positions) for values in vertices):
        raise ValueError("has more or fewer normals, colours or texture coordinates than vertices")
    return vertices


def _plain_obj(content: bytes) -> SourceMesh | None:
    """The mesh of a small OBJ of nothing but positions and triangles; None for any other."""
    if len(content) > MAX_PLAIN_BYTES or not PLAIN_OBJ.fullmatch(content):
        return None
    rows = [line.split() for line in content.splitlines()]
    positions = np.array([row[1:] for row in rows if row[:1] == [b"v"]], np.float64)
    triangles = np.array([row[1:] for row in rows if row[:1] == [b"f"]], np.int64) - 1
    return SourceMesh(VertexAttributes(positions), triangles, np.eye(4), None) if len(positions) and len(triangles) else None


def _trimesh_meshes(path: Path, limits: SceneLimits) -> tuple[list[SourceMesh], list[str]]:
    """The meshes of an OBJ, PLY or STL file, and a line for each thing that is left out."""
    content, kind = read_file(path, MAX_BYTES).removeprefix(codecs.BOM_UTF8), path.suffix.lower().removeprefix(".")
    limits.on_stored(len(content))
    if kind in ("obj", "stl"):
        (check_obj if kind == "obj" else check_stl)(content)
    if kind == "obj" and (plain := _plain_obj(content)):
        return [plain], []
    import trimesh  # here, since it takes half a second to load

    beside = FilesBeside(path.parent, str(path))
    with silent():  # trimesh logs, and numpy warns of what it computes with nan
        stream = io.BytesIO(content)
        scene = trimesh.load_scene(stream, file_type=kind, resolver=beside, process=False, maintain_order=True)  # type: ignore[arg-type]
    if beside.refused:
        raise beside.refused
    meshes, left_out = [], beside.left_out
    texels: dict[str, np.ndarray] = {}
    for node in scene.graph.nodes_geometry:
        matrix, key = scene.graph[node]
        mesh = scene.geometry[key]
        if isinstance(mesh, trimesh.Trimesh):
            material, uvs = material_from_visual(mesh.visual, texels)
            # Those that the file has: trimesh's property would compute its own.
            normals = np.asarray(mesh.vertex_normals) if "vertex_normals" in mesh._cache.cache else None
            vertices = VertexAttributes(np.asarray(mesh.vertices), normals, uvs, colours_from_visual(mesh.visual))
            meshes.append(SourceMesh(vertices, np.asarray(mesh.faces), np.asarray(matrix, np.float64), material))
            if uvs is None and (stored := getattr(mesh.visual, "uv", None)) is not None and not np.isfinite(stored).all():
                left_out.append("its texture coordinates are left out: some are nan or inf")
    return meshes, list(dict.fromkeys(left_out))


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
    normals = None if vertices.normals is None else vertices.normals @ np.linalg.inv(linear)
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


def _is_similarity(linear: np.ndarray) -> bool:
    """Whether a transform (3, 3) is a rotation with uniform scale, as `Geometry.moved` takes it."""
    scale = np.cbrt(np.linalg.det(linear))
    return bool(scale > MIN_SCALE and np.allclose(linear @ linear.T, scale**2 * np.eye(3), rtol=0, atol=SIMILARITY * scale**2))
