"""Scenes: the scene file, its meshes brought to the world, and the bundled demo scene.

A scene file is TOML; paths in it are relative to it, angles are degrees, lengths are metres, +Z is up.
"""

from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from services.files import BadInput, read_toml
from services.renderer.luminaire.placement import Luminaire, LuminaireTable, load_luminaire
from services.renderer.materials import Catcher, Material, MaterialTable, Phong, material_from_table
from services.renderer.meshes import Geometry, Part, Shape, bounds, read_parts, shape_geometry
from services.renderer.plate import PlateTable, load_plate
from services.sphere import rotation_xyz

DEMO_SCENE = Path(__file__).parent / "scenes" / "demo.toml"
MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl")

Vector = tuple[float, float, float]


class Camera(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    position: Vector = msgspec.field(name="from")
    at: Vector
    fov_y: Annotated[float, Meta(gt=0, lt=180)] = 40.0  # degrees, from the lower to the upper edge


class MeshTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One `[[mesh]]`: either `file` or `shape`; in order it is turned y-up, scaled, rotated about x, y, z, and moved."""

    file: str = ""
    shape: Shape | None = None
    y_up: bool | None = None  # left out: true for glTF, whose files are y-up by definition
    scale: Annotated[float, Meta(gt=0)] = 1.0
    rotate: Vector = (0.0, 0.0, 0.0)
    at: Vector = (0.0, 0.0, 0.0)
    material: MaterialTable | None = None  # left out: as the file says, gray when it says nothing


class SceneTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    camera: Camera
    mesh: list[MeshTable]
    luminaire: list[LuminaireTable] = []
    plate: PlateTable | None = None


class Mesh(NamedTuple):
    """A mesh in the world with its material."""

    name: str
    geometry: Geometry
    material: Material


class Scene(NamedTuple):
    """What is drawn. centre and half: the box around all meshes, (3,) float64 each, metres."""

    camera: Camera
    meshes: tuple[Mesh, ...]
    centre: np.ndarray
    half: np.ndarray
    luminaires: tuple[Luminaire, ...] = ()
    plate: np.ndarray | None = None  # (h, w, 3) float16, radiance of what lies behind, row 0 on top

    @property
    def catcher_normal(self) -> np.ndarray | None:
        """Unit normal (3,) of the catcher on the camera's side; None when there is none."""
        for mesh in self.meshes:
            if isinstance(mesh.material, Catcher):
                normal = mesh.geometry.normals[0].astype(np.float64)
                return normal if (self.camera.position - mesh.geometry.positions[0].astype(np.float64)) @ normal >= 0 else -normal
        return None


def load_scene(path: Path | None) -> Scene:
    """The scene at `path`, or the bundled demo scene for None.

    Raises BadInput, naming the scene file, the mesh and the mend, for unknown keys, a missing or unreadable mesh file, for meshes
    that are empty, hold nan or have no area, and for luminaires and plates that cannot be read.
    """
    path = path or DEMO_SCENE
    table = read_toml(path, SceneTable)
    if not table.mesh:
        raise BadInput(f"{path}: has no [[mesh]]; add one")
    camera = table.camera
    if not np.all(np.isfinite([*camera.position, *camera.at])) or np.allclose(camera.position, camera.at, rtol=0, atol=1e-9):
        raise BadInput(f"{path}: [camera] from and at must be two different finite points; mend them")
    meshes = [mesh for number, row in enumerate(table.mesh, 1) for mesh in _meshes(row, path, f"{path}: [[mesh]] {number}")]
    low, high = bounds([mesh.geometry for mesh in meshes])
    lamps = [load_luminaire(row, path.parent, f"{path}: [[luminaire]] {number}") for number, row in enumerate(table.luminaire, 1)]
    _check_catchers(meshes, path)
    plate = load_plate(table.plate, path.parent, f"{path}: [plate]") if table.plate else None
    return Scene(camera, tuple(meshes), (low + high) / 2, (high - low) / 2, tuple(lamps), plate)


def _check_catchers(meshes: list[Mesh], path: Path) -> None:
    """Raises BadInput when there is more than one catcher or it is not flat: the light that it would have then varies over it."""
    catchers = [mesh for mesh in meshes if isinstance(mesh.material, Catcher)]
    if len(catchers) > 1:
        raise BadInput(f"{path}: has {len(catchers)} meshes with catcher = true; join them in one flat mesh")
    if catchers and np.ptp(catchers[0].geometry.normals, axis=0).max() > 1e-3:
        raise BadInput(f"{path}: {catchers[0].name} with catcher = true is not flat; use shape = \"plane\"")


def _meshes(row: MeshTable, scene: Path, where: str) -> list[Mesh]:
    """The meshes that one [[mesh]] of the file `scene` stands for, in the world. Raises BadInput that begins with `where`."""
    if bool(row.file) == bool(row.shape):
        raise BadInput(f"{where}: needs either file = \"...\" or shape = \"sphere\", \"plane\" or \"box\"")
    try:
        wanted = material_from_table(row.material) if row.material else None
    except ValueError as error:
        raise BadInput(f"{where}: {error}") from error
    if not np.all(np.isfinite([row.scale, *row.rotate, *row.at])):
        raise BadInput(f"{where}: scale, rotate and at must be finite; mend them")
    y_up = row.y_up
    if row.shape:
        found = [Part(row.shape, shape_geometry(row.shape), None)]
    else:
        file = scene.parent / row.file
        if file.suffix.lower() not in MESH_SUFFIXES:
            raise BadInput(f"{where}: {file} is none of {', '.join(MESH_SUFFIXES)}; convert it")
        if not file.is_file():
            raise BadInput(f"{where}: there is no mesh file {file}; mend the path (it is relative to the scene file)")
        found = read_parts(file, where)
        y_up = file.suffix.lower() in (".glb", ".gltf") if y_up is None else y_up
    rotation = rotation_xyz(row.rotate)
    if y_up:
        rotation = rotation @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # (x, y, z) becomes (x, -z, y)
    placed = [part.geometry.moved(rotation * row.scale, np.array(row.at)) for part in found]
    made = [part.material if wanted is None else wanted for part in found]
    return [
        Mesh(part.name, geometry, Phong() if material is None else material)
        for part, geometry, material in zip(found, placed, made, strict=True)
    ]
