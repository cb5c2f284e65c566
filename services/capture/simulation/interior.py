"""A procedural room: pale walls, a window on one side, and fluorescent tubes under the ceiling that flicker with the mains.

The constants are the look of the scene; other values make another sequence.
"""

import math

import numpy as np

from vemlight.capture.simulation.environment import Environment
from vemlight.light.sphere import angles_from_direction, latlong_directions

HEIGHT, WIDTH = 512, 1024  # of the lat-long image
FLICKER_HZ = 100.0  # twice the mains' 50 Hz
FLICKER_DEPTH = 0.45  # of the mean: typical of tubes on magnetic ballasts
WALL = np.array([0.060, 0.054, 0.046])
FLOOR = np.array([0.030, 0.024, 0.019])
WINDOW = np.array([7.0, 8.2, 9.6])
WINDOW_AZIMUTH_DEG, WINDOW_ELEVATION_DEG = (20.0, 64.0), (4.0, 46.0)
BARS_AZIMUTH_DEG, BAR_DEG = (42.0,), 1.5  # of the window's frame
TUBE = np.array([21.0, 20.0, 16.0])
TUBES_Y = (-0.9, -0.3, 0.3, 0.9)  # lines in the plane of the ceiling, one unit above the camera
TUBE_X, TUBE_HALF_WIDTH = (-0.75, 0.75), 0.030
PHASES = (0.0, 2.1, 4.2, 0.7)  # rad; the tubes are connected to different phases of the mains
DAYLIGHT_SWING, DAYLIGHT_RAD_PER_S = 0.25, 1.3  # clouds outside dim the window by up to this much


def smooth_box(value: np.ndarray, low: float, high: float, soft: float) -> np.ndarray:
    """1 between `low` and `high`, 0 beyond, with linear edges `soft` wide."""
    return np.clip((value - low) / soft + 0.5, 0, 1) * np.clip((high - value) / soft + 0.5, 0, 1)


class Interior:
    """The room as a LightScene; `seed` shifts the tubes' phases."""

    name = "interior"

    def __init__(self, seed: int):
        self._phase = seed * 2.399963  # the golden angle
        direction = latlong_directions(HEIGHT, WIDTH)
        theta, phi = angles_from_direction(direction)
        pixel = math.pi / HEIGHT
        left, right = np.radians(WINDOW_AZIMUTH_DEG)
        low, high = np.radians(WINDOW_ELEVATION_DEG)
        self._window = smooth_box(phi, left, right, pixel) * smooth_box(math.pi / 2 - theta, low, high, pixel)
        for bar in np.radians(BARS_AZIMUTH_DEG):
            self._window *= 1 - smooth_box(phi, bar - math.radians(BAR_DEG) / 2, bar + math.radians(BAR_DEG) / 2, pixel)
        up = direction[..., 2] > 0.2
        x, y = np.where(up, direction[..., :2].transpose(2, 0, 1) / np.where(up, direction[..., 2], 1.0), np.inf)
        self._tubes = [
            smooth_box(x, *TUBE_X, pixel) * smooth_box(y, line - TUBE_HALF_WIDTH, line + TUBE_HALF_WIDTH, pixel) for line in TUBES_Y
        ]
        height = direction[..., 2:]
        self._walls = np.where(height > 0, WALL * (1 + 0.5 * height), FLOOR)

    def environment(self, k: int, time_s: float, exposure_s: float) -> Environment:
        """See LightScene; the flicker is averaged over the exposure in closed form."""
        daylight = 1 - DAYLIGHT_SWING * (0.5 + 0.5 * math.sin(DAYLIGHT_RAD_PER_S * time_s))
        image = self._walls * (0.6 + 0.4 * daylight) + self._window[..., None] * (WINDOW * daylight)
        for tube, phase in zip(self._tubes, PHASES, strict=True):
            image += tube[..., None] * (TUBE * (1 + FLICKER_DEPTH * mean_cosine(FLICKER_HZ, phase + self._phase, time_s, exposure_s)))
        return Environment(image, [])


def mean_cosine(frequency_hz: float, phase: float, time_s: float, exposure_s: float) -> float:
    """Mean of cos(2 pi f t + phase) from `time_s` on over `exposure_s`; its value there when that is 0."""
    middle, half = 2 * math.pi * frequency_hz * (time_s + exposure_s / 2) + phase, math.pi * frequency_hz * exposure_s
    return math.cos(middle) * (math.sin(half) / half if half > 0 else 1.0)
