"""A target frame time, met by the number of shadow maps drawn in a frame and then by the number of lights."""

from typing import NamedTuple

import numpy as np

from services.lights import Lights

NEWEST = 0.2  # weight of the newest frame in what a frame costs: half known after 3 frames, one odd frame moves it by a fifth
LEAST_RENEWED = 1 / 24  # share of the maps drawn in each frame whatever the time: at 24 frames a second none is older than a second


class Pace(NamedTuple):
    """What a frame costs on this machine, ms: whatever is lit, for each map drawn, for each light summed. None: not yet known."""

    fixed_ms: float = 0.0
    map_ms: float | None = None
    light_ms: float | None = None


def learnt(pace: Pace, fixed_ms: float, maps: int, maps_ms: float, lights: int, lights_ms: float) -> Pace:
    """The pace after a frame that drew `maps` in maps_ms and summed `lights` in lights_ms, with fixed_ms beside them."""

    def mixed(before: float | None, total: float, count: int) -> float | None:
        if count == 0:
            return before
        return total / count if before is None else before + NEWEST * (total / count - before)

    known = pace.light_ms is not None
    fixed = pace.fixed_ms + NEWEST * (fixed_ms - pace.fixed_ms) if known else fixed_ms
    return Pace(fixed, mixed(pace.map_ms, maps_ms, maps), mixed(pace.light_ms, lights_ms, lights))


def affordable_lights(pace: Pace, frame_ms: float) -> int | None:
    """How many lights with LEAST_RENEWED of their maps fit into frame_ms, at least 1; None while their cost is not known."""
    if pace.light_ms is None:
        return None
    map_ms = pace.map_ms or 0.0  # not known while the lights stand still, and then not spent either
    return max(1, int((frame_ms - pace.fixed_ms) / max(pace.light_ms + LEAST_RENEWED * map_ms, 1e-6)))


def affordable_maps(pace: Pace, frame_ms: float, lights: int) -> int:
    """How many maps fit into what `lights` leave of frame_ms, between LEAST_RENEWED of them and all."""
    least = int(np.ceil(lights * LEAST_RENEWED))
    if pace.light_ms is None or pace.map_ms is None:
        return lights
    return int(np.clip((frame_ms - pace.fixed_ms - lights * pace.light_ms) / max(pace.map_ms, 1e-6), least, max(lights, least)))


def first_lights(lights: Lights, count: int) -> Lights:
    """The first `count` lights, at least one, scaled so that the sum of their irradiance stays what it was in each channel."""
    count = max(count, 1)
    if count >= len(lights.ids):
        return lights
    total, kept = lights.irradiance.sum(axis=0, dtype=np.float64), lights.irradiance[:count].astype(np.float64)
    part = kept.sum(axis=0)
    scaled = np.where(part > 0, kept * np.divide(total, part, out=np.zeros(3), where=part > 0), total / count)
    return Lights.of(lights.ids[:count], lights.directions[:count], scaled)
