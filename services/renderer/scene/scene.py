"""Scenes: the scene file, its meshes in world axes, and the bundled scene.

A scene file is TOML. Paths are relative to it, angles are in degrees, lengths in metres, +Z is up.
"""

import os
import sys
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import contained_path, read_toml
from vemlight.light.sphere import quaternion_xyz, rotation_xyz
from vemlight.renderer.gl.constants import GLOSSY_KINDS
from vemlight.renderer.scene.animation import RigidMotion
from vemlight.renderer.scene.camera_table import CameraTable, PlacedCamera, ViewCamera, ViewTable, named_views, view_camera
from vemlight.renderer.scene.luminaire_table import (
    BUNDLED_LAMP,
    MAX_COORDINATE_M,
    Luminaire,
    LuminaireFiles,
    LuminaireTable,
    Vector,
    lamp_pose,
    load_luminaire,
    luminaire_of_file,
)
from vemlight.renderer.scene.materials import (
    Material,
    MaterialTable,
    Phong,
    ShadowCatcher,
    alpha_test_of,
    material_from_table,
    material_kind,
)
from vemlight.renderer.scene.mesh_files import MESH_SUFFIXES, NODE_SUFFIXES, USD_SUFFIXES, MeshFile, MeshPart, read_meshes
from vemlight.renderer.scene.meshes import Geometry, Shape, bounds, shape_geometry, swept_bounds
from vemlight.renderer.scene.plate_table import PlateTable, load_plate
from vemlight.renderer.scene.scene_limits import MAX_LUMINAIRES, MAX_VIEWS, SceneLimits
from vemlight.runtime.poses import Pose, View

BUNDLED_SCENE = Path(__file__).parent / "scenes" / "terrace.toml"
MAX_RELATIVE_OFFSET = 1000  # scene sizes from the origin: there float32 is 6e-5 of the size, a tenth of a texel of the largest shadow map
MAX_SCALE = 1e9  # nanometres as metres; its cube is finite in float64, as is its inverse's. Any value in 1e7 .. 1e12 does
FLAT = 1e-3  # by how much normals of a shadow catcher may differ: 0.06 degrees, far above float32 and far below a bend that is meant
Z_UP_FROM_Y_UP = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # (x, y, z) becomes (x, -z, y)


class MeshTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[[mesh]]` of a scene file, either `file` or `shape`: in this order turned z-up, scaled, rotated about x, y, z, and moved."""

    file: str = ""
    shape: Shape | None = None
    name: Annotated[str, Meta(max_length=64)] = ""  # by which poses refer to it; left out: the file's or the shape's
    y_up: bool | None = None  # left out: true for glTF, whose files are y-up by definition
    # One number, or one along each axis. Limits are checked later: msgspec 0.22 crashes in a union of a float and a tuple that have any.
    scale: float | Vector = 1.0
    rotate: Vector = (0.0, 0.0, 0.0)
    at: Vector = (0.0, 0.0, 0.0)
    material: MaterialTable | None = None  # left out: as the file says, gray when it says nothing
    animation: Annotated[str, Meta(max_length=200)] = ""  # one of the file's by name; "*": all together; left out: the first


class SceneTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A scene file as it is written."""

    camera: CameraTable
    mesh: list[MeshTable]
    luminaire: list[LuminaireTable] = []
    plate: PlateTable | None = None
    view: Annotated[list[ViewTable], Meta(max_length=MAX_VIEWS)] = []


class Mesh(NamedTuple):
    """A mesh in world axes, where the scene file places it, with its material.

    object_index: of the object that it is part of; None: it cannot be moved. motion: how its file's animation moves it.
    """

    name: str
    geometry: Geometry
    material: Material
    object_index: int | None = None
    motion: RigidMotion | None = None


class Scene(NamedTuple):
    """What is drawn.

    centre, half: centre and half size of the box around all meshes wherever animations bring them, (3,) float64, metres.
    plate: (h, w, 3) float16, radiance of the background picture, row 0 on top. objects: what can be moved, where the scene file places
    it: one for each [[mesh]], then the lamps. views: other cameras by name.
    """

    camera: ViewCamera
    meshes: tuple[Mesh, ...]
    centre: np.ndarray
    half: np.ndarray
    luminaires: tuple[Luminaire, ...] = ()
    plate: np.ndarray | None = None
    objects: tuple[Pose, ...] = ()
    views: tuple[tuple[str, View], ...] = ()

    @property
    def glossy(self) -> bool:
        """Whether any material has a specular lobe, for which the gloss set of lights is of use."""
        return any(material_kind(mesh.material) in GLOSSY_KINDS for mesh in self.meshes)

    @property
    def blended(self) -> bool:
        """Whether any surface is covered in part by hashed alpha, which takes more samples a pixel."""
        return any(alpha_test.cutoff is None for mesh in self.meshes if (alpha_test := alpha_test_of(mesh.material)))

    def shadow_catcher_normal(self, matrices: np.ndarray, camera: ViewCamera) -> np.ndarray | None:
        """Unit normal (3,) of the shadow catcher on a camera's side; None without one. matrices: (n, 4, 4), world_from_rest."""
        for mesh, matrix in zip(self.meshes, matrices, strict=True):
            if isinstance(mesh.material, ShadowCatcher):
                normal = np.linalg.inv(matrix[:3, :3]).T @ mesh.geometry.normals[0].astype(np.float64)
                normal /= np.linalg.norm(normal)
                point = matrix[:3, :3] @ mesh.geometry.positions[0].astype(np.float64) + matrix[:3, 3]
                return normal if (camera.position - point) @ normal >= 0 else -normal
        return None


def load_scene(path: Path | None) -> Scene:
    """The scene at `path`, or the bundled scene for None.

    Prints a line to standard error for each feature of a file that is not drawn, and for a scene far from the origin. Raises UserError
    that names the scene file, the table and how to correct it: for unknown keys, for files that are missing or cannot be read, and for
    meshes that are empty, hold nan or have no area.
    """
    path = path or BUNDLED_SCENE
    table = read_toml(path, SceneTable)
    if not table.mesh:
        raise UserError(f"{path}: has no [[mesh]]; add one")
    files = _MeshFiles(path.parent)
    if not table.camera.preset:
        view_camera(table.camera, (), path)  # before files are read that take long
    meshes, cameras, file_lamps = [], [], []
    for number, row in enumerate(table.mesh, 1):
        placed = _meshes(row, files, f"{path}: [[mesh]] {number}")
        meshes += [mesh._replace(object_index=number - 1) for mesh in placed.meshes]
        cameras += placed.cameras
        file_lamps += placed.lamps
    camera = view_camera(table.camera, cameras, path)
    _check_shadow_catchers(meshes, path)
    if (count := len(table.luminaire) + len(file_lamps)) > MAX_LUMINAIRES:
        raise UserError(f"{path}: has {count} [[luminaire]] and lamps of files, at most {MAX_LUMINAIRES} are drawn; leave some out")
    sources = LuminaireFiles(path.parent)
    lamps = [load_luminaire(row, sources, f"{path}: [[luminaire]] {number}") for number, row in enumerate(table.luminaire, 1)]
    plate = load_plate(table.plate, path.parent, f"{path}: [plate]") if table.plate else None
    boxes = [swept_bounds(mesh.geometry, mesh.motion) for mesh in meshes] + [bounds([mesh.geometry for mesh in meshes])]
    low, high = np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)
    _warn_if_far(low, high, path)
    objects, views = _objects(table, path, file_lamps), named_views(table.view, cameras, path)
    return Scene(camera, tuple(meshes), (low + high) / 2, (high - low) / 2, (*lamps, *file_lamps), plate, objects, views)


def _warn_if_far(low: np.ndarray, high: np.ndarray, path: Path) -> None:
    size_m, distance_m = np.linalg.norm(high - low), np.linalg.norm(high + low) / 2
    if distance_m > MAX_RELATIVE_OFFSET * size_m:
        line = f"the scene is {size_m:.3g} m large and {distance_m:.3g} m from the origin, too far for exact shadows; move all of it there"
        print(f"vemlight: {path}: {line}", file=sys.stderr, flush=True)


def _objects(table: SceneTable, path: Path, file_lamps: list[Luminaire]) -> tuple[Pose, ...]:
    """The objects and lamps, those of mesh files last. A name left out is the file's or the shape's, with a number where another has it
    already."""
    rows: list[tuple[MeshTable | LuminaireTable, str, float | None]] = [(row, row.shape or Path(row.file).stem, None) for row in table.mesh]
    rows += [(row, Path(row.file or BUNDLED_LAMP).stem, row.power) for row in table.luminaire]
    given = [row.name for row, _, _ in rows if row.name]
    taken = set(given)
    if repeated := [name for name in taken if given.count(name) > 1]:
        raise UserError(f"{path}: {min(repeated)} is the name of several meshes or luminaires; give each its own")
    objects = []
    for row, stem, power in rows:
        stem = stem[:56] or "mesh"  # of the 64 characters of a name, 8 for the number behind it
        name = row.name or _free_name(stem, taken)
        taken.add(name)
        objects.append(Pose(name=name, position=row.at, rotation=quaternion_xyz(row.rotate), power=power))
    for lamp in file_lamps:
        name = _free_name(lamp.source.name, taken)
        taken.add(name)
        objects.append(lamp_pose(lamp, name))
    return tuple(objects)


def _free_name(stem: str, taken: set[str]) -> str:
    """A name that is not taken: the stem, with a number where it is."""
    return next(name for k in range(1, len(taken) + 2) if (name := f"{stem} {k}" if k > 1 else stem) not in taken)


def _check_shadow_catchers(meshes: list[Mesh], path: Path) -> None:
    """Raises UserError for several shadow catchers and for one that is not flat: its unshadowed light must be the same all over."""
    catchers = [mesh for mesh in meshes if isinstance(mesh.material, ShadowCatcher)]
    if len(catchers) > 1:
        raise UserError(f"{path}: has {len(catchers)} meshes with catcher = true; join them in one flat mesh")
    if catchers and np.ptp(catchers[0].geometry.normals, axis=0).max() > FLAT:
        raise UserError(f"{path}: {catchers[0].name} with catcher = true is not flat; use shape = \"plane\"")


class _MeshFiles:
    """The mesh files of a scene, each read once, and what they become in all."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read: dict[tuple[str, str, bool], MeshFile] = {}
        self.limits = SceneLimits()

    def read(self, row: MeshTable, where: str, materials: bool) -> MeshFile:
        """The meshes of a `[[mesh]]` in their own axes. Raises UserError that begins with `where`."""
        key = row.shape or row.file, row.animation, materials
        if key not in self._read:
            if row.shape:
                self._read[key] = MeshFile([MeshPart(row.shape, shape_geometry(row.shape), None)], [])
            else:
                path = contained_path(self._folder, row.file, where)
                if not os.path.exists(path):
                    raise UserError(f"{where}: there is no mesh file {path}; correct the path (it is relative to the scene file)")
                self._read[key] = read_meshes(path, where, row.animation, materials, self.limits)
        return self._read[key]


class PlacedFile(NamedTuple):
    """The meshes, cameras and lamps of a `[[mesh]]`."""

    meshes: list[Mesh]
    cameras: list[PlacedCamera]
    lamps: list[Luminaire]


def _meshes(row: MeshTable, files: _MeshFiles, where: str) -> PlacedFile:
    """What a `[[mesh]]` brings to the world. Raises UserError that begins with `where`."""
    try:
        material = material_from_table(row.material) if row.material else None
    except ValueError as error:
        raise UserError(f"{where}: {error}") from error
    _check_table(row, where)
    file = files.read(row, where, materials=material is None)
    y_up = Path(row.file).suffix.lower() in NODE_SUFFIXES if row.y_up is None else row.y_up
    z_up, rotation = Z_UP_FROM_Y_UP if y_up else np.eye(3), rotation_xyz(row.rotate)
    linear = rotation @ z_up * row.scale if isinstance(row.scale, float) else rotation @ np.diag(row.scale) @ z_up
    world_from_file = np.eye(4)
    world_from_file[:3, :3], world_from_file[:3, 3] = linear, row.at
    for line in file.unsupported:
        print(f"vemlight: {where}: {line}", file=sys.stderr, flush=True)
    meshes = []
    for part in file.parts:
        try:
            files.limits.on_placed(len(part.geometry.positions))
        except ValueError as error:
            raise UserError(f"{where}: the scene {error}") from error
        with np.errstate(all="ignore"):
            geometry = part.geometry.moved(linear, np.array(row.at))
        if not np.isfinite(geometry.positions).all():
            raise UserError(f"{where}: {part.name} reaches farther than any number; correct its scale")
        made_of = part.material if material is None else material
        if material is not None:  # nor do the file's vertex colours change it
            geometry = geometry._replace(colours=None)
        motion = part.motion._replace(world_from_file=world_from_file) if part.motion else None
        meshes.append(Mesh(part.name, geometry, Phong() if made_of is None else made_of, motion=motion))
    lamps = [luminaire_of_file(lamp, world_from_file) for lamp in file.lamps]
    for lamp in lamps:
        if not np.abs(lamp.world_from_local[:3, 3]).max() <= MAX_COORDINATE_M:
            raise UserError(f"{where}: its lamp {lamp.source.name} is farther than {MAX_COORDINATE_M:.0f} m away; correct its place")
    return PlacedFile(meshes, [PlacedCamera(camera, world_from_file) for camera in file.cameras], lamps)


def _check_table(row: MeshTable, where: str) -> None:
    """Raises UserError that begins with `where` for keys of a `[[mesh]]` that cannot be, whatever its file holds."""
    if bool(row.file) == bool(row.shape):
        raise UserError(f'{where}: has not one of file and shape; write either file = "..." or shape = "sphere", "plane" or "box"')
    scales = np.atleast_1d(row.scale)
    if not np.all(np.isfinite([*scales, *row.rotate, *row.at])) or np.abs(row.at).max() > MAX_COORDINATE_M:
        raise UserError(f"{where}: scale, rotate and at must be finite, at within {MAX_COORDINATE_M:.0f} m; correct them")
    for scale in scales.tolist():
        if not 1 / MAX_SCALE <= scale <= MAX_SCALE:
            raise UserError(f"{where}: scale = {scale:g} must be from {1 / MAX_SCALE:g} to {MAX_SCALE:g}; correct it")
    suffix = Path(row.file).suffix.lower()
    if row.animation and suffix not in NODE_SUFFIXES:
        raise UserError(f"{where}: animation = {row.animation}: only {', '.join(NODE_SUFFIXES)} files have animations; leave it out")
    if row.y_up is not None and suffix in USD_SUFFIXES:
        raise UserError(f"{where}: y_up: {row.file} says itself which axis is up; leave it out")
    if row.file and suffix not in MESH_SUFFIXES:
        raise UserError(f"{where}: {row.file} is none of {', '.join(MESH_SUFFIXES)}; convert it")
