"""Near lights that are lamps with a measured light field: the field takes the light's place, as strong as the rig measured the light.

Where a lamp is not located it is dark; where its file sends nothing towards the rig, the near light stays.
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
    """Which near lights are lamps, the nearest within each one's reach, and how bright these are. rig: (3,), where they were measured.

    The irradiance that a lamp gives there is the near light's, in each channel; a channel that the file lacks stays dark.
    """
    free, colours = np.ones(len(near.ids), bool), []
    measured = near.irradiance_at(rig)
    for lamp, reach_m in zip(lamps, reaches_m, strict=True):
        away = np.where(free, np.linalg.norm(near.at - lamp.world_from_local[:3, 3], axis=1), np.inf)
        colour = DARK
        if len(away) and away.min() <= reach_m:
            light, own = int(away.argmin()), irradiance_towards(lamp, rig)
            if own.sum() > 0:
                free[light] = False
                by_channel = np.divide(measured[light], own, out=np.full(3, measured[light].sum() / own.sum()), where=own > 0)
                red, green, blue = by_channel.tolist()
                colour = (red, green, blue)
        colours.append(colour)
    return Recognised(NearLightSet(*(array[free] for array in near.arrays())), tuple(colours))


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
