"""Scenes: the scene file, its meshes brought to the world, and the bundled demo scene.

A scene file is TOML; paths in it are relative to it, angles are degrees, lengths are metres, +Z is up.
"""

import sys
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import read_toml
from vemlight.light.sphere import quaternion_xyz, rotation_xyz
from vemlight.renderer.scene.animation import RigidMotion
from vemlight.renderer.scene.luminaire_table import BUNDLED_LAMP, Luminaire, LuminaireTable, load_luminaire
from vemlight.renderer.scene.materials import (
    GLOSSY_KINDS,
    Material,
    MaterialTable,
    Phong,
    ShadowCatcher,
    alpha_test_of,
    material_from_table,
    material_kind,
)
from vemlight.renderer.scene.mesh_files import GLTF_SUFFIXES, MESH_SUFFIXES, MeshFile, MeshPart, read_meshes
from vemlight.renderer.scene.meshes import Geometry, Shape, bounds, shape_geometry, swept_bounds
from vemlight.renderer.scene.plate_table import PlateTable, load_plate
from vemlight.runtime import wire

DEMO_SCENE = Path(__file__).parent / "scenes" / "demo.toml"
MAX_DISTANCE_M = 1e6  # as poses on the wire; there float32 is 6 cm coarse
MAX_RELATIVE_OFFSET = 1000  # scene sizes from the origin: there float32 is 6e-5 of the size, a tenth of a texel of the largest shadow map

Vector = tuple[float, float, float]


class ViewCamera(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    position: Vector = msgspec.field(name="from")
    at: Vector
    fov_y: Annotated[float, Meta(gt=0, lt=180)] = 40.0  # degrees, from the lower to the upper edge


class MeshTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One `[[mesh]]`: either `file` or `shape`; in order it is turned y-up, scaled, rotated about x, y, z, and moved."""

    file: str = ""
    shape: Shape | None = None
    name: Annotated[str, Meta(max_length=64)] = ""  # by which it is moved; left out: the file's or the shape's
    y_up: bool | None = None  # left out: true for glTF, whose files are y-up by definition
    scale: Annotated[float, Meta(gt=0)] = 1.0
    rotate: Vector = (0.0, 0.0, 0.0)
    at: Vector = (0.0, 0.0, 0.0)
    material: MaterialTable | None = None  # left out: as the file says, gray when it says nothing
    animation: Annotated[str, Meta(max_length=200)] = ""  # of a file that has several, by name; "*": all together; left out: the first


class SceneTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    camera: ViewCamera
    mesh: list[MeshTable]
    luminaire: list[LuminaireTable] = []
    plate: PlateTable | None = None


class Mesh(NamedTuple):
    """A mesh in the world, where the scene file puts it, with its material.

    thing: the number of what it is part of; None: nothing that can be moved. motion: how its file's animation moves it.
    """

    name: str
    geometry: Geometry
    material: Material
    object_index: int | None = None
    motion: RigidMotion | None = None


class Scene(NamedTuple):
    """What is drawn. centre and half: the box around all meshes and wherever animations bring them, (3,) float64 each, metres.

    objects: what can be moved, where the scene file puts it: an object for each [[mesh]], then the lamps in their order.
    """

    camera: ViewCamera
    meshes: tuple[Mesh, ...]
    centre: np.ndarray
    half: np.ndarray
    luminaires: tuple[Luminaire, ...] = ()
    plate: np.ndarray | None = None  # (h, w, 3) float16, radiance of what lies behind, row 0 on top
    objects: tuple[wire.Pose, ...] = ()

    @property
    def glossy(self) -> bool:
        """Whether any material has a lobe, for which a second set of lights is good."""
        return any(material_kind(mesh.material) in GLOSSY_KINDS for mesh in self.meshes)

    @property
    def blended(self) -> bool:
        """Whether of any surface only a share is there, for which more samples are good."""
        return any(holes.cutoff is None for mesh in self.meshes if (holes := alpha_test_of(mesh.material)))

    def shadow_catcher_normal(self, matrices: np.ndarray) -> np.ndarray | None:
        """Unit normal (3,) of the catcher on the camera's side, with world_from_rest (n, 4, 4) of the meshes; None when there is none."""
        for mesh, matrix in zip(self.meshes, matrices, strict=True):
            if isinstance(mesh.material, ShadowCatcher):
                normal = np.linalg.inv(matrix[:3, :3]).T @ mesh.geometry.normals[0].astype(np.float64)
                normal /= np.linalg.norm(normal)
                place = matrix[:3, :3] @ mesh.geometry.positions[0].astype(np.float64) + matrix[:3, 3]
                return normal if (self.camera.position - place) @ normal >= 0 else -normal
        return None


def load_scene(path: Path | None) -> Scene:
    """The scene at `path`, or the bundled demo scene for None.

    Raises UserError, naming the scene file, the mesh and the mend, for unknown keys, a missing or unreadable mesh file, for meshes
    that are empty, hold nan or have no area, and for luminaires and plates that cannot be read.
    """
    path = path or DEMO_SCENE
    table = read_toml(path, SceneTable)
    if not table.mesh:
        raise UserError(f"{path}: has no [[mesh]]; add one")
    camera = table.camera
    if not np.all(np.isfinite([*camera.position, *camera.at])) or np.allclose(camera.position, camera.at, rtol=0, atol=1e-9):
        raise UserError(f"{path}: [camera] from and at must be two different finite points; mend them")
    meshes = [
        mesh._replace(object_index=number - 1)
        for number, row in enumerate(table.mesh, 1)
        for mesh in _meshes(row, path, f"{path}: [[mesh]] {number}")
    ]
    boxes = [swept_bounds(mesh.geometry, mesh.motion) for mesh in meshes] + [bounds([mesh.geometry for mesh in meshes])]
    low, high = np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)
    lamps = [load_luminaire(row, path.parent, f"{path}: [[luminaire]] {number}") for number, row in enumerate(table.luminaire, 1)]
    _check_catchers(meshes, path)
    size, off = np.linalg.norm(high - low), np.linalg.norm(high + low) / 2
    if off > MAX_RELATIVE_OFFSET * size:
        told = f"the scene is {size:.3g} m large and {off:.3g} m from the origin, too far for exact shadows; move all of it there"
        print(f"vemlight: {path}: {told}", file=sys.stderr, flush=True)
    plate = load_plate(table.plate, path.parent, f"{path}: [plate]") if table.plate else None
    objects = _objects(table, path)
    return Scene(camera, tuple(meshes), (low + high) / 2, (high - low) / 2, tuple(lamps), plate, objects)


def _objects(table: SceneTable, path: Path) -> tuple[wire.Pose, ...]:
    """The objects and lamps by name. A name left out is the file's or the shape's, with a number where another has it already."""
    rows: list[tuple[MeshTable | LuminaireTable, str, float | None]] = [(row, row.shape or Path(row.file).stem, None) for row in table.mesh]
    rows += [(row, Path(row.file or BUNDLED_LAMP).stem, row.power) for row in table.luminaire]
    given = [row.name for row, _, _ in rows if row.name]
    taken = set(given)
    if twice := [name for name in taken if given.count(name) > 1]:
        raise UserError(f"{path}: {min(twice)} is the name of several meshes or luminaires; give each its own")
    objects = []
    for row, plain, power in rows:
        plain = plain[:56] or "mesh"  # a number fits behind it
        free = (f"{plain} {k}" if k > 1 else plain for k in range(1, len(rows) + 2))
        name = row.name or next(name for name in free if name not in taken)
        taken.add(name)
        objects.append(wire.Pose(name=name, position=row.at, rotation=quaternion_xyz(row.rotate), power=power))
    return tuple(objects)


def _check_catchers(meshes: list[Mesh], path: Path) -> None:
    """Raises UserError when there is more than one catcher or it is not flat: the light that it would have then varies over it."""
    catchers = [mesh for mesh in meshes if isinstance(mesh.material, ShadowCatcher)]
    if len(catchers) > 1:
        raise UserError(f"{path}: has {len(catchers)} meshes with catcher = true; join them in one flat mesh")
    if catchers and np.ptp(catchers[0].geometry.normals, axis=0).max() > 1e-3:
        raise UserError(f"{path}: {catchers[0].name} with catcher = true is not flat; use shape = \"plane\"")


def _meshes(row: MeshTable, scene: Path, where: str) -> list[Mesh]:
    """The meshes that one [[mesh]] of the file `scene` stands for, in the world. Raises UserError that begins with `where`."""
    if bool(row.file) == bool(row.shape):
        raise UserError(f"{where}: needs either file = \"...\" or shape = \"sphere\", \"plane\" or \"box\"")
    try:
        wanted = material_from_table(row.material) if row.material else None
    except ValueError as error:
        raise UserError(f"{where}: {error}") from error
    if not np.all(np.isfinite([row.scale, *row.rotate, *row.at])) or np.abs(row.at).max() > MAX_DISTANCE_M:
        raise UserError(f"{where}: scale, rotate and at must be finite, at within {MAX_DISTANCE_M:.0f} m; mend them")
    if row.animation and Path(row.file).suffix.lower() not in GLTF_SUFFIXES:
        raise UserError(f"{where}: animation = {row.animation}: only .glb and .gltf files have animations; leave it out")
    y_up = row.y_up
    if row.shape:
        found = MeshFile([MeshPart(row.shape, shape_geometry(row.shape), None)], [])
    else:
        file = scene.parent / row.file
        if file.suffix.lower() not in MESH_SUFFIXES:
            raise UserError(f"{where}: {file} is none of {', '.join(MESH_SUFFIXES)}; convert it")
        if not file.is_file():
            raise UserError(f"{where}: there is no mesh file {file}; mend the path (it is relative to the scene file)")
        found = read_meshes(file, where, row.animation, materials=wanted is None)
        y_up = file.suffix.lower() in GLTF_SUFFIXES if y_up is None else y_up
    rotation = rotation_xyz(row.rotate)
    if y_up:
        rotation = rotation @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # (x, y, z) becomes (x, -z, y)
    world_from_file = np.eye(4)
    world_from_file[:3, :3], world_from_file[:3, 3] = rotation * row.scale, row.at
    for line in found.unsupported:
        print(f"vemlight: {where}: {line}", file=sys.stderr, flush=True)
    placed = [part.geometry.moved(rotation * row.scale, np.array(row.at)) for part in found.parts]
    if wanted is not None:
        placed = [geometry._replace(colours=None) for geometry in placed]
    made = [part.material if wanted is None else wanted for part in found.parts]
    motions = [part.motion and part.motion._replace(world_from_file=world_from_file) for part in found.parts]
    return [
        Mesh(part.name, geometry, Phong() if material is None else material, None, motion)
        for part, geometry, material, motion in zip(found.parts, placed, made, motions, strict=True)
    ]
