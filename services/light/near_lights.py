"""Near lights: sources at places, as several cameras locate them. What is farther away stays a directional light (light_set.py)."""

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

MAX_NEAR_LIGHTS = 256  # of a frame: a room has a dozen lamps, and each may cast shadows to six sides
MAX_METRES = 1e6  # of a place's numbers, a radius, a sigma: as of all places on the wire
MAX_INTENSITY = 1e30  # W/sr: at MIN_DISTANCE_M it is an irradiance of 1e36, which float32 holds
MIN_DISTANCE_M = 1e-3  # of a place from a light: within it, and within its radius, irradiance grows no further


@dataclass(frozen=True)
class NearLightSet:
    """Located lights of one frame, each a sphere that shines alike to all sides.

    ids: (n,) int64, stable while a light lives. at: (n, 3) float32, m, world. intensity: (n, 3) float32, RGB, W/sr (candela times
    wire.MapMessage's luminance scale where it is known). radius: (n,) float32, m, of a sphere of equal second moment. sigma: (n,) float32,
    m, square root of the trace of the place's covariance.
    """

    ids: np.ndarray
    at: np.ndarray
    intensity: np.ndarray
    radius: np.ndarray
    sigma: np.ndarray

    @staticmethod
    def empty() -> "NearLightSet":
        return NearLightSet.of(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))

    @staticmethod
    def of(ids: np.ndarray, at: np.ndarray, intensity: np.ndarray, radius: np.ndarray, sigma: np.ndarray) -> "NearLightSet":
        """The arrays in their fixed types."""
        at, intensity, radius, sigma = (np.ascontiguousarray(array, np.float32) for array in (at, intensity, radius, sigma))
        return NearLightSet(np.ascontiguousarray(ids, np.int64), at, intensity, radius, sigma)

    def arrays(self) -> tuple[np.ndarray, ...]:
        """In the order of the message `points`."""
        return self.ids, self.at, self.intensity, self.radius, self.sigma

    def irradiance_at(self, place: np.ndarray | Sequence[float]) -> np.ndarray:
        """(n, 3) float64, on a plane at `place` (3,) m that faces each light: intensity over squared distance, in the units of a light's
        irradiance. At a place inside a light: as at its surface.
        """
        distance = np.linalg.norm(self.at.astype(np.float64) - np.asarray(place, np.float64), axis=1)
        return self.intensity / np.maximum(distance, np.maximum(self.radius, MIN_DISTANCE_M))[:, None] ** 2

    def fault(self) -> str:
        """Why no such lights can be, as words that go on after their name; empty where all is well."""
        if len(self.ids) > MAX_NEAR_LIGHTS:
            return f"are {len(self.ids)}, and {MAX_NEAR_LIGHTS} is the most"
        if not all(np.isfinite(array).all() for array in self.arrays()[1:]):
            return "have a number that is not finite"
        if any((array < 0).any() for array in (self.intensity, self.radius, self.sigma)):
            return "have a negative intensity, radius or sigma"
        if any((np.abs(array) > MAX_METRES).any() for array in (self.at, self.radius, self.sigma)):
            return f"have a place, radius or sigma beyond {MAX_METRES:g} m"
        if (self.intensity > MAX_INTENSITY).any():
            return f"have an intensity above {MAX_INTENSITY:g} W/sr"
        if len(np.unique(self.ids)) < len(self.ids):
            return "have an id twice"
        return ""


class NearLightRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True, gc=False):
    """A near light as it stands in a file of lights."""

    id: int
    at: tuple[float, float, float]
    intensity: tuple[float, float, float]
    radius: float
    sigma: float


def near_light_rows(near: NearLightSet) -> list[NearLightRow]:
    """float32 values with the digits that bring them back exactly."""
    numbers = (array.tolist() for array in near.arrays())
    return [NearLightRow(i, tuple(at), tuple(intensity), r, s) for i, at, intensity, r, s in zip(*numbers, strict=True)]


def near_lights_from_rows(rows: list[NearLightRow]) -> NearLightSet:
    """The rows as arrays; what is beyond float32 becomes inf, which `fault` names."""
    with np.errstate(over="ignore"):
        return NearLightSet.of(
            np.array([row.id for row in rows], np.int64),
            np.array([row.at for row in rows], np.float32).reshape(-1, 3),
            np.array([row.intensity for row in rows], np.float32).reshape(-1, 3),
            np.array([row.radius for row in rows], np.float32),
            np.array([row.sigma for row in rows], np.float32),
        )
