"""A target frame time, met by the number of shadow maps drawn in a frame, by their size, and then by the number of lights."""

from typing import NamedTuple

import numpy as np

from services.lights import Lights

NEWEST = 0.2  # weight of the newest frame in what a frame costs: half known after 3 frames, one odd frame moves it by a fifth
LEAST_RENEWED = 1 / 24  # share of the maps drawn in each frame whatever the time: at 24 frames a second none is older than a second;
MOST_RENEWED = 1 / 8  # ... and none older than a third of one where that many lights move, before there is time for more lights
WORTH = 3 / 4  # of the maps drawn: a lookup apart takes 4/3 of one in the sum (78 and 59 ms of 72 lights); more are quicker there
LOOKUP = 2 / 3  # of a light's cost where it is looked up, until both are known apart: 59 of 86 ms of 72 lights
# Halved maps have at most half the backlog; doubled ones six times as much, with twice the texels to move by and three times the cost.
MUCH, LITTLE = 2.0, 0.125
COARSEST = 4  # times as coarse as the settings say


class Pace(NamedTuple):
    """What a frame costs on this machine, ms: whatever is lit, for each map drawn, for each light summed and looked up. None: not known.

    backlog: maps off by more than a texel for each that is drawn, smoothed; off: for each light.
    """

    fixed_ms: float = 0.0
    map_ms: float | None = None
    light_ms: float | None = None
    lookup_ms: float = 0.0
    backlog: float = 1.0
    off: float = 0.0

    @property
    def renewed(self) -> float:
        """Share of the maps for which each frame has time before it has time for more lights."""
        return min(max(self.off, LEAST_RENEWED), MOST_RENEWED)


class Spent(NamedTuple):
    """What a frame did and how long it took: all of it, its maps, its lookups where apart from its lights, its lights."""

    frame_ms: float
    maps: int
    maps_ms: float
    lookups: int | None  # None: in the sum itself
    lookups_ms: float
    lights: int
    lights_ms: float


def learnt(pace: Pace, spent: Spent) -> Pace:
    """The pace after a frame."""

    def mixed(before: float | None, total: float, count: int) -> float | None:
        if count == 0:
            return before
        return total / count if before is None else before + NEWEST * (total / count - before)

    fixed = spent.frame_ms - spent.maps_ms - spent.lookups_ms - spent.lights_ms
    known = pace.light_ms is not None
    pace = pace._replace(
        fixed_ms=pace.fixed_ms + NEWEST * (fixed - pace.fixed_ms) if known else fixed, map_ms=mixed(pace.map_ms, spent.maps_ms, spent.maps)
    )
    if spent.lights == 0:
        return pace
    if spent.lookups is not None:
        lookup_ms = mixed(pace.lookup_ms or None, spent.lookups_ms, spent.lookups) or 0.0
        return pace._replace(light_ms=mixed(pace.light_ms, spent.lights_ms, spent.lights), lookup_ms=lookup_ms)
    # Both at once: what is known of their shares stays.
    whole = spent.lights_ms / spent.lights
    share = pace.lookup_ms / max(pace.lookup_ms + pace.light_ms, 1e-9) if pace.light_ms is not None else LOOKUP
    before = pace.lookup_ms + pace.light_ms if pace.light_ms is not None else whole
    now = before + NEWEST * (whole - before)
    return pace._replace(light_ms=(1 - share) * now, lookup_ms=share * now)


def affordable_lights(pace: Pace, frame_ms: float, moved: bool = False) -> int | None:
    """How many lights with the share `renewed` of their maps fit into frame_ms, at least 1; None while their cost is not known.

    moved: surfaces have, so that each light is looked up anew.
    """
    if pace.light_ms is None:
        return None
    map_ms = pace.map_ms or 0.0  # not known while the lights stand still, and then not spent either
    each = pace.light_ms + (1.0 if moved else pace.renewed) * pace.lookup_ms + pace.renewed * map_ms
    return max(1, int((frame_ms - pace.fixed_ms) / max(each, 1e-6)))


def affordable_maps(pace: Pace, frame_ms: float, lights: int, moved: bool = False) -> int:
    """How many maps fit into what `lights` leave of frame_ms, between the share `renewed` of them and all."""
    least = int(np.ceil(lights * pace.renewed))
    if pace.light_ms is None or pace.map_ms is None:
        return lights
    left = frame_ms - pace.fixed_ms - lights * pace.light_ms
    most = (left - lights * pace.lookup_ms) / max(pace.map_ms, 1e-6)  # every light looked up in the sum
    if not moved and most <= WORTH * lights:
        most = min(left / max(pace.map_ms + pace.lookup_ms, 1e-6), WORTH * lights)
    return int(np.clip(most, least, max(lights, least)))


def waited(pace: Pace, off: int, drawn: int, lights: int) -> Pace:
    """The pace after a frame in which `off` maps of `lights` were off by more than a texel and `drawn` of them were drawn anew."""
    backlog, share = off / max(drawn, 1), off / max(lights, 1)
    return pace._replace(backlog=pace.backlog + NEWEST * (backlog - pace.backlog), off=pace.off + NEWEST * (share - pace.off))


def map_size(pace: Pace, size: int, largest: int) -> int:
    """Texels on a map's side from now on: half as many when maps wait for their turn, as many again when they do not."""
    if pace.backlog > MUCH and size // 2 >= max(largest // COARSEST, 16):
        return size // 2
    return min(2 * size, largest) if pace.backlog < LITTLE else size


def first_lights(lights: Lights, count: int) -> Lights:
    """`count` of the lights, at least one, scaled so that the sum of their irradiance stays what it was in each channel.

    First is who is stronger by a power of two, then the order of the set: lights of like power keep the progressive order, and a sun is
    not left out.
    """
    count = max(count, 1)
    if count >= len(lights.ids):
        return lights
    power = lights.irradiance.max(axis=1)
    octave = np.floor(np.log2(np.maximum(power / max(power.mean(), 1e-30), 1e-6)) + 0.5)
    chosen = np.sort(np.argsort(-octave, kind="stable")[:count])
    total, kept = lights.irradiance.sum(axis=0, dtype=np.float64), lights.irradiance[chosen].astype(np.float64)
    part = kept.sum(axis=0)
    scaled = np.where(part > 0, kept * np.divide(total, part, out=np.zeros(3), where=part > 0), total / count)
    return Lights.of(lights.ids[chosen], lights.directions[chosen], scaled)
