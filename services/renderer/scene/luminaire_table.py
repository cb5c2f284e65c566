"""Luminaires in a scene: the `[[luminaire]]` table, and a lamp with its place, its power and how it is to be rendered."""

from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.light.sphere import rotation_xyz
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.luminaire_file import read_luminaire
from vemlight.renderer.luminaire.photometry import FarField, read_photometry
from vemlight.renderer.luminaire.shift_invariant import good_enough

Vector = tuple[float, float, float]
Method = Literal["auto", "sampled", "shift-invariant"]
Shadows = Literal["maps", "traced", "none"]
BUNDLED_LAMP = Path(__file__).parents[1] / "luminaire" / "lamps" / "torch.exr"


class LuminaireTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One `[[luminaire]]`: a light field (.exr) or a far field (.ldt, .ies). It shines along its own +z, is rotated
    about x, y, z and moved.

    power: times the measured one; the picture's unit is W sr^-1 m^-2 for radiometric and cd m^-2 for photometric files. file left out: the
    bundled torch.
    """

    file: str = ""
    name: Annotated[str, Meta(max_length=64)] = ""  # left out: the file's
    at: Vector = (0.0, 0.0, 0.0)
    rotate: Vector = (0.0, 0.0, 0.0)
    power: Annotated[float, Meta(ge=0, le=1e12)] = 1.0
    method: Method = "auto"  # auto: shift-invariant where its error bound is below 8 %
    samples: Annotated[int, Meta(ge=1, le=16_000)] = 64  # a pixel, of all images together
    most: Annotated[int, Meta(ge=0, le=16_000)] = 0  # samples of one image; 0: no limit
    interleave: Annotated[int, Meta(ge=1, le=8)] = 4  # pixels of a tile's side that draw differently; 1: all draw the same
    shadows: Shadows = "maps"  # traced: rays on the CPU, slow, to judge the maps by
    shadow_map: Annotated[int, Meta(ge=16, le=2048)] = 192  # texels on a side, for one cell


class Luminaire(NamedTuple):
    """A lamp in the world. world_from_local: rigid transform (4, 4) float64."""

    source: LightField | FarField
    world_from_local: np.ndarray
    power: float
    table: LuminaireTable

    @property
    def shift_invariant(self) -> bool:
        """Whether the 2003 approximation renders it."""
        if isinstance(self.source, FarField) or self.table.method == "sampled":
            return False
        return self.table.method == "shift-invariant" or good_enough(self.source)


def world_from_lamp(at: Vector, rotate: Vector) -> np.ndarray:
    """world_from_local (4, 4) of a lamp rotated by degrees about x, y, z and moved."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation_xyz(rotate), at
    return matrix


def load_luminaire(table: LuminaireTable, folder: Path, where: str) -> Luminaire:
    """The lamp of a scene file's table, whose paths are relative to `folder`. Raises UserError that begins with `where`."""
    if not np.all(np.isfinite([*table.at, *table.rotate])) or np.abs(table.at).max() > 1e6:
        raise UserError(f"{where}: at and rotate must be finite, at within 1000000 m; mend them")
    path = folder / table.file if table.file else BUNDLED_LAMP
    try:
        source = read_photometry(path) if path.suffix.lower() in (".ldt", ".ies") else read_luminaire(path)
    except UserError as error:
        raise UserError(f"{where}: {error}") from error
    return Luminaire(source, world_from_lamp(table.at, table.rotate), table.power, table)
