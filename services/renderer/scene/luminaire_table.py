"""Luminaires in a scene: the `[[luminaire]]` table, and a luminaire with its place, its power and how it is to be rendered."""

from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import contained_path
from vemlight.light.eulumdat import MAX_LAMP_SETS
from vemlight.light.far_field import FarField
from vemlight.light.photometry import PHOTOMETRY_SUFFIXES, read_photometry
from vemlight.light.sphere import rotation_xyz
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.luminaire_file import read_luminaire
from vemlight.renderer.luminaire.shift_invariant import DrawnBy
from vemlight.renderer.scene.gltf_lights import FileLamp
from vemlight.runtime.poses import Pose

Vector = tuple[float, float, float]
Method = Literal["auto", "sampled", "shift-invariant"]
Shadows = Literal["maps", "traced", "none"]
BUNDLED_LAMP = Path(__file__).parents[1] / "luminaire" / "lamps" / "torch.exr"
MAX_SAMPLES = 3000  # llvmpipe ends all loops of a pixel after 65,535 rounds, and a sample takes up to 21 (of images of 1024 pixels)
MAX_COORDINATE_M = 1e6  # of a position: float32 then still resolves 6 cm


class LuminaireTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One `[[luminaire]]`: a light field (.exr) or far field (.ldt, .ies). It shines along its own +z, is rotated about x, y, z and moved.

    power: multiplies the measured light; the picture's unit is W sr^-1 m^-2 for radiometric and cd m^-2 for photometric files. file left
    out: the bundled torch.
    """

    file: str = ""
    lamp_set: Annotated[int, Meta(ge=0, le=MAX_LAMP_SETS)] = 0  # of a .ldt with alternatives, from 1; 0: the first
    name: Annotated[str, Meta(max_length=64)] = ""  # left out: the file's
    at: Vector = (0.0, 0.0, 0.0)
    rotate: Vector = (0.0, 0.0, 0.0)
    power: Annotated[float, Meta(ge=0, le=1e12)] = 1.0
    method: Method = "auto"  # auto: shift-invariant where that is no farther from the light field than samples are
    samples: Annotated[int, Meta(ge=1, le=MAX_SAMPLES)] | None = None  # a pixel, of all images together; left out: by their noise
    max_per_image: Annotated[int, Meta(ge=0, le=MAX_SAMPLES)] = 0  # samples of one image; 0: no limit
    interleave: Annotated[int, Meta(ge=1, le=8)] = 4  # side of a tile of pixels that draw different samples; 1: all draw the same
    shadows: Shadows = "maps"  # traced: rays on the CPU, slow, to compare the maps with
    shadow_map: Annotated[int, Meta(ge=16, le=2048)] = 192  # texels on a side, for one cell


class Luminaire(NamedTuple):
    """A luminaire in the world. world_from_local: rigid transform (4, 4) float64. drawn: by which method; far fields have none.
    colour: Rec. 709, times its light.
    """

    source: LightField | FarField
    world_from_local: np.ndarray
    power: float
    table: LuminaireTable
    drawn: DrawnBy = DrawnBy(False, 1)
    colour: Vector = (1.0, 1.0, 1.0)


def world_from_lamp(position: Vector, degrees_xyz: Vector) -> np.ndarray:
    """The rigid transform (4, 4) of a luminaire that is rotated by degrees about x, y, z and moved to a position."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation_xyz(degrees_xyz), position
    return matrix


class LuminaireFiles:
    """The luminaire files of a scene, which name them from its `folder`, each read once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read: dict[tuple[str, int], LightField | FarField] = {}
        self._drawn: dict[tuple[str, Method, int | None], DrawnBy] = {}

    def read(self, file: str, lamp_set: int, where: str) -> LightField | FarField:
        """The light of a file, or of the bundled lamp for "". Raises UserError that begins with `where`."""
        key = file, lamp_set
        if key not in self._read:
            path = contained_path(self._folder, file, where) if file else BUNDLED_LAMP
            try:
                if path.suffix.lower() in PHOTOMETRY_SUFFIXES:
                    self._read[key] = read_photometry(path, lamp_set)
                elif lamp_set:
                    raise UserError(f"{path}: lamp_set chooses among the lamps of a .ldt file; leave it out")
                else:
                    self._read[key] = read_luminaire(path)
            except UserError as error:
                raise UserError(f"{where}: {error}") from error
        return self._read[key]

    def drawn(self, table: LuminaireTable, source: LightField | FarField) -> DrawnBy:
        """How to draw the light of a table's file."""
        if isinstance(source, FarField):
            return DrawnBy(False, 1)
        method: Method = "sampled" if table.shadows == "traced" else table.method
        key = table.file, method, table.samples
        if key not in self._drawn:
            from vemlight.renderer.luminaire.method_choice import chosen_method  # needs numba, and few scenes have lamps

            self._drawn[key] = chosen_method(source, method, table.samples)
        return self._drawn[key]


def load_luminaire(table: LuminaireTable, files: LuminaireFiles, where: str) -> Luminaire:
    """The luminaire of a scene file's table. Raises UserError that begins with `where`."""
    if not np.all(np.isfinite([*table.at, *table.rotate])) or np.abs(table.at).max() > MAX_COORDINATE_M:
        raise UserError(f"{where}: at and rotate must be finite, at within {MAX_COORDINATE_M:.0f} m; correct them")
    source = files.read(table.file, table.lamp_set, where)
    return Luminaire(source, world_from_lamp(table.at, table.rotate), table.power, table, files.drawn(table, source))


def luminaire_of_file(lamp: FileLamp, world_from_file: np.ndarray) -> Luminaire:
    """The luminaire of a lamp in a mesh file that stands at world_from_file (4, 4): neither scale nor mirroring changes its light."""
    matrix = world_from_file @ lamp.file_from_lamp
    world_from_local = np.eye(4)
    axis, across = matrix[:3, 2] / np.linalg.norm(matrix[:3, 2]), matrix[:3, 0]
    across = across - (across @ axis) * axis
    across /= np.linalg.norm(across)
    world_from_local[:3, :3] = np.stack([across, np.cross(axis, across), axis], axis=1)
    world_from_local[:3, 3] = matrix[:3, 3]
    return Luminaire(lamp.far_field, world_from_local, 1.0, LuminaireTable(), colour=lamp.colour)


def lamp_pose(lamp: Luminaire, name: str) -> Pose:
    """Where a luminaire stands, as an object that can be moved."""
    from scipy.spatial.transform import Rotation  # here, since it takes a third of a second to load

    x, y, z = lamp.world_from_local[:3, 3].tolist()
    a, b, c, d = Rotation.from_matrix(lamp.world_from_local[:3, :3]).as_quat().tolist()
    return Pose(name=name, position=(x, y, z), rotation=(a, b, c, d), power=lamp.power)
