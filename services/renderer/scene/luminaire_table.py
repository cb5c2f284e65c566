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
from vemlight.renderer.luminaire.shift_invariant import is_shift_invariant

Vector = tuple[float, float, float]
Method = Literal["auto", "sampled", "shift-invariant"]
Shadows = Literal["maps", "traced", "none"]
BUNDLED_LAMP = Path(__file__).parents[1] / "luminaire" / "lamps" / "torch.exr"
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
    method: Method = "auto"  # auto: shift-invariant where its error bound is at most 8 %
    samples: Annotated[int, Meta(ge=1, le=16_000)] = 64  # a pixel, of all images together
    max_per_image: Annotated[int, Meta(ge=0, le=16_000)] = 0  # samples of one image; 0: no limit
    interleave: Annotated[int, Meta(ge=1, le=8)] = 4  # side of a tile of pixels that draw different samples; 1: all draw the same
    shadows: Shadows = "maps"  # traced: rays on the CPU, slow, to compare the maps with
    shadow_map: Annotated[int, Meta(ge=16, le=2048)] = 192  # texels on a side, for one cell


class Luminaire(NamedTuple):
    """A luminaire in the world. world_from_local: rigid transform (4, 4) float64."""

    source: LightField | FarField
    world_from_local: np.ndarray
    power: float
    table: LuminaireTable

    @property
    def shift_invariant(self) -> bool:
        """Whether the 2003 approximation renders it."""
        if isinstance(self.source, FarField) or self.table.method == "sampled":
            return False
        return self.table.method == "shift-invariant" or is_shift_invariant(self.source)


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


def load_luminaire(table: LuminaireTable, files: LuminaireFiles, where: str) -> Luminaire:
    """The luminaire of a scene file's table. Raises UserError that begins with `where`."""
    if not np.all(np.isfinite([*table.at, *table.rotate])) or np.abs(table.at).max() > MAX_COORDINATE_M:
        raise UserError(f"{where}: at and rotate must be finite, at within {MAX_COORDINATE_M:.0f} m; correct them")
    source = files.read(table.file, table.lamp_set, where)
    return Luminaire(source, world_from_lamp(table.at, table.rotate), table.power, table)
