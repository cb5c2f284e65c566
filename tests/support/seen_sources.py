"""Sources as several cameras would measure them, without maps: directions and fluxes of lights, with the errors that are declared."""

from typing import NamedTuple

import numpy as np

from tests.support.analytic_rooms import turned
from vemlight.fuse.matching import SEES, SOURCE_NUMBERS, SeenSources
from vemlight.fuse.rig_file import CameraRig
from vemlight.fuse.triangulation import FLUX_SIGMA

NOISE_RAD, FIXED_RAD, FLUX_NOISE = 2e-4, 3e-4, 0.01  # of a direction, new each frame and not; of ln flux, new each frame


class Lit(NamedTuple):
    """A light at a place, m, or in a direction, a unit vector, if it is far; ln_power: ln of its intensity, or of its irradiance."""

    at: np.ndarray
    ln_power: float = 0.0
    is_far: bool = False
    chroma: tuple[float, float, float] = (0.34, 0.33, 0.33)


class Eyes(NamedTuple):
    """A rig whose poses are wrong by what it declares. places: (cameras, 3), where they are. turns: (cameras, 3, 3), from the world that
    the rig file has to that in which they are."""

    rig: CameraRig
    places: np.ndarray
    turns: np.ndarray

    @staticmethod
    def of(rig: CameraRig, rng: np.random.Generator, error: float = 1.0) -> "Eyes":
        places = rig.places + error * rig.pose_m * rng.standard_normal(rig.places.shape)
        return Eyes(rig, places, np.array([turned(np.eye(3), rng, error * rig.pose_deg) for _ in rig.camera]))

    def unequal(self, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """What is the same in each frame, of each camera and light: errors of directions (cameras, n, 3) and of ln flux (cameras, n)."""
        shape = len(self.places), count
        return FIXED_RAD * rng.standard_normal((*shape, 3)), FLUX_SIGMA * rng.standard_normal(shape)

    def see(self, lights: list[Lit], fixed: tuple[np.ndarray, np.ndarray], rng: np.random.Generator) -> SeenSources:
        """The sources of a frame, in the order of the lights."""
        cameras, count = len(self.places), len(lights)
        table, chroma = np.zeros((cameras, max(count, 1), SOURCE_NUMBERS)), np.zeros((cameras, max(count, 1), 3))
        for k in range(cameras):
            for n, light in enumerate(lights):
                away = light.at if light.is_far else light.at - self.places[k]
                length = float(np.linalg.norm(away))
                direction = away / length @ self.turns[k] + fixed[0][k, n] + NOISE_RAD * rng.standard_normal(3)
                ln_flux = (
                    light.ln_power - (0.0 if light.is_far else 2 * np.log(length)) + fixed[1][k, n] + FLUX_NOISE * rng.standard_normal()
                )
                table[k, n, :3] = direction / np.linalg.norm(direction)
                table[k, n, 3:] = ln_flux, NOISE_RAD**2, FIXED_RAD**2, FLUX_SIGMA**2, FLUX_NOISE**2
                chroma[k, n] = light.chroma
        pose = np.array([np.radians(self.rig.pose_deg), self.rig.pose_m])
        axes = np.tile([0.0, 0.0, 1.0], (cameras, 1))
        counts = np.full(cameras, count, np.int64)
        return SeenSources(table, counts, chroma, self.rig.centre - self.rig.places, axes, np.full(cameras, SEES), pose)
