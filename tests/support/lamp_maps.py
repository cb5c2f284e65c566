"""Maps of lamps before an even background, quickly made: what cameras of a rig see of spheres at places, and of lights at infinity."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tests.support.analytic_rooms import FINE, directions_in, turned
from vemlight.fuse.rig_file import CameraRig
from vemlight.light.bright_cells import bright_cells_from_light
from vemlight.light.colour import luminance_from_rgb
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.sphere import SPAN, Coverage, cell_directions, cell_solid_angles

FAR_M = 1e6


class Bulb(NamedTuple):
    """A sphere at a place, m, with an intensity, W/sr; at FAR_M times a direction it is at infinity."""

    at: tuple[float, float, float]
    intensity: tuple[float, float, float] = (1.0, 1.0, 1.0)
    radius: float = 0.05


def far(direction: tuple[float, float, float], irradiance: float, radius_rad: float = 0.01) -> Bulb:
    """A light at infinity."""
    x, y, z = FAR_M * np.asarray(direction) / np.linalg.norm(direction)
    power = irradiance * FAR_M**2
    return Bulb((x, y, z), (power, power, power), radius_rad * FAR_M)


def lamp_map(
    bulbs: Sequence[Bulb], place: np.ndarray, turn: np.ndarray, background: float = 0.05, coverage: Coverage = "hemisphere"
) -> EnvironmentMap:
    """What a camera sees; turn: world_from_camera (3, 3)."""
    rows, cols = 90 if coverage == "hemisphere" else 180, 360
    directions = cell_directions(rows, cols, coverage).reshape(-1, 3)
    light = np.repeat((background * (1 + 0.3 * (directions @ turn.T)[:, 2]))[:, None], 3, axis=1)
    cells, centres, flux = [np.zeros(0, np.int64)], [np.zeros((0, 3))], [np.zeros(0)]
    for bulb in bulbs:
        away = (np.asarray(bulb.at) - place) @ turn
        distance = float(np.linalg.norm(away))
        reach = math.asin(min(bulb.radius / distance, 1.0))
        near = np.flatnonzero(directions @ (away / distance) > math.cos(reach + math.radians(1.2)))
        if not len(near):
            continue
        fine = directions_in(near, FINE, cols, SPAN[coverage] / rows, 2 * math.pi / cols)
        inside = np.linalg.norm(fine - away / distance, axis=-1) < 2 * math.sin(reach / 2)
        solid = cell_solid_angles(rows, cols, coverage)[near // cols] / FINE**2
        whole = float((inside.sum(axis=1) * solid).sum())
        if whole == 0:
            continue
        radiance = np.asarray(bulb.intensity) / distance**2 / whole  # the sampled disc sends what the lamp does
        light[near] += inside.mean(axis=1)[:, None] * radiance
        cells.append(np.repeat(near, FINE**2))
        centres.append(fine.reshape(-1, 3))
        flux.append((inside * (luminance_from_rgb(radiance) * solid)[:, None]).ravel())
    strong = np.isin(np.concatenate(cells), np.flatnonzero(luminance_from_rgb(light) > 20 * background))
    own, seen, sent = (np.concatenate(each)[strong] for each in (cells, centres, flux))
    samples = bright_cells_from_light(own, seen, sent, rows, cols, coverage)
    return EnvironmentMap(light.reshape(rows, cols, 3).astype(np.float32), coverage, samples)


def lamp_maps(
    bulbs: Sequence[Bulb], rig: CameraRig, rng: np.random.Generator, error: float = 1.0, background: float = 0.05
) -> list[EnvironmentMap]:
    """What the cameras of a rig see whose poses are wrong by `error` times what it declares."""
    return [
        lamp_map(
            bulbs, np.asarray(camera.at) + error * rig.pose_m * rng.standard_normal(3),
            turned(camera.world_from_camera, rng, error * rig.pose_deg), background,
        )
        for camera in rig.camera
    ]  # fmt: skip
