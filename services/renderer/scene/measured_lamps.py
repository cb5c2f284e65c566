"""Near lights that are lamps with a measured light field: the field takes the light's place, as strong as the rig measured the light.

Where a lamp is not located it is dark; where its file sends next to nothing towards the rig, the near light stays.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vemlight.errors import UserError, of_setting
from vemlight.light.far_field import FarField, intensity
from vemlight.light.measured_lamp import MeasuredLamp
from vemlight.light.near_lights import NearLightSet
from vemlight.light.photometry import PHOTOMETRY_SUFFIXES, read_photometry
from vemlight.renderer.luminaire.lightfield import LightField
from vemlight.renderer.luminaire.luminaire_file import read_luminaire
from vemlight.renderer.scene.luminaire_table import Luminaire, LuminaireFiles, LuminaireTable, Vector, world_from_lamp
from vemlight.renderer.scene.scene import Scene
from vemlight.renderer.scene.scene_pose import ScenePose

DARK: Vector = (0.0, 0.0, 0.0)
# Of its brightest, that a lamp must send to the rig to be told by it: less is stray light in most files, and beside a steep beam a degree
# off is many times as much. Any value in .003 .. .03 does.
LEAST_TOWARDS = 0.01


class Recognised(NamedTuple):
    """near: the near lights that are no lamp. colours: of each lamp, which its file's light is multiplied by."""

    near: NearLightSet
    colours: tuple[Vector, ...]


def with_measured_lamps(scene: Scene, lamps: Sequence[MeasuredLamp]) -> Scene:
    """The scene with the lamps as its last luminaires, dark. Raises UserError for a file that cannot be read."""
    files = LuminaireFiles(Path())
    made = []
    for number, lamp in enumerate(lamps, 1):
        with of_setting(f"[renderer] lamp {number}"):
            source = lamp_light(lamp)
        table = LuminaireTable(file=lamp.file, lamp_set=lamp.lamp_set, at=lamp.at, rotate=lamp.rotate)
        made.append(Luminaire(source, world_from_lamp(lamp.at, lamp.rotate), 1.0, table, files.drawn(table, source), DARK))
    return scene._replace(luminaires=(*scene.luminaires, *made))


def lamp_light(lamp: MeasuredLamp) -> LightField | FarField:
    """The light of a lamp's file. Raises UserError for a file that cannot be read."""
    path = Path(lamp.file)
    if path.suffix.lower() in PHOTOMETRY_SUFFIXES:
        return read_photometry(path, lamp.lamp_set)
    if lamp.lamp_set:
        raise UserError(f"{path}: lamp_set chooses among the lamps of a .ldt file; leave it out")
    return read_luminaire(path)


def recognised(lamps: Sequence[Luminaire], reaches_m: Sequence[float], near: NearLightSet, rig: np.ndarray) -> Recognised:
    """Which near lights are lamps, those nearest to each other first, within each lamp's reach, and how bright these are. rig: (3,), where
    they were measured.

    The irradiance that a lamp gives there is the near light's, in each channel; a channel that the file lacks stays dark.
    """
    free, colours = np.ones(len(near.ids), bool), [DARK] * len(lamps)
    places, measured = np.array([lamp.world_from_local[:3, 3] for lamp in lamps]), near.irradiance_at(rig)
    away = np.linalg.norm(near.at.astype(np.float64) - places[:, None], axis=-1)
    pairs = np.argwhere(away <= np.array(reaches_m)[:, None])
    for lamp, light in pairs[np.argsort(away[tuple(pairs.T)], kind="stable")].tolist():
        if free[light] and colours[lamp] == DARK:
            colours[lamp] = _colour(measured[light], lamps[lamp], rig)
            free[light] = colours[lamp] == DARK
    return Recognised(NearLightSet(*(array[free] for array in near.arrays())), tuple(colours))


def _colour(measured: np.ndarray, lamp: Luminaire, rig: np.ndarray) -> Vector:
    """What a lamp's light is multiplied by to give the rig an irradiance (3,); dark where it sends too little there to tell."""
    own = irradiance_towards(lamp, rig)
    if not own.sum() > LEAST_TOWARDS * brightest_towards(lamp, rig).sum():
        return DARK
    red, green, blue = np.divide(measured, own, out=np.zeros(3), where=own > 0).tolist()
    return red, green, blue


def brightest_towards(lamp: Luminaire, place: np.ndarray) -> np.ndarray:
    """What the file's lamp gives at most so far away, (3,) float64; of a light field, along its axis."""
    distance = float(np.linalg.norm(lamp.world_from_local[:3, 3] - place))
    if isinstance(lamp.source, FarField):
        return np.full(3, lamp.source.candela.max() / max(distance, 1e-9) ** 2)
    return irradiance_towards(lamp, lamp.world_from_local[:3] @ np.array([0.0, 0.0, distance, 1.0]))


def irradiance_towards(lamp: Luminaire, place: np.ndarray) -> np.ndarray:
    """What the file's lamp gives to a plane at a place (3,) that faces it, (3,) float64."""
    local = np.linalg.inv(lamp.world_from_local) @ [*place, 1.0]
    distance = float(np.linalg.norm(local[:3]))
    if distance == 0:
        return np.zeros(3)
    direction = local[:3] / distance
    if isinstance(lamp.source, FarField):
        return np.full(3, intensity(lamp.source, direction).item() / distance**2)
    from vemlight.renderer.luminaire.reference import irradiance  # here, since few scenes have lamps

    return irradiance(lamp.source, local[:3], -direction)


def lit_by_lamps(pose: ScenePose, scene: Scene, colours: Sequence[Vector]) -> ScenePose:
    """The pose with these colours of the scene's last luminaires."""
    first = len(scene.luminaires) - len(colours)
    return pose._replace(lamp_colours={first + k: colour for k, colour in enumerate(colours)})
