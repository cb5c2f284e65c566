"""A target frame time, met by the number of shadow maps drawn in a frame, by their size, and then by the number of lights."""

from typing import NamedTuple

import numpy as np

from vemlight.light.light_set import LightSet

NEWEST = 0.2  # weight of the newest frame in what a frame costs: half known after 3 frames, one odd frame moves it by a fifth
LEAST_RENEWED = 1 / 24  # share of the maps drawn in each frame whatever the time: at 24 frames a second none is older than a second;
MOST_RENEWED = 1 / 8  # ... and none older than a third of one where that many lights move, before there is time for more lights
WORTH = 3 / 4  # of the maps drawn: a lookup apart takes 4/3 of one in the sum (78 and 59 ms of 72 lights); more are quicker there
LOOKUP = 2 / 3  # of a light's cost where it is looked up, until both are known apart: 59 of 86 ms of 72 lights
# Halved maps have at most half the backlog; doubled ones six times as much, with twice the texels to move by and three times the cost.
MUCH, LITTLE = 2.0, 0.125
FEWEST = 8  # lights: with fewer a sky is a few hard shadows; the target is missed before that
LATE = 1.15  # of the target: what single frames take anyway where the median meets it
TEXELS = 100**2  # of a map whose texels cost as much as its triangles and its setting up: 0.05 ms either (llvmpipe, 1 core)


class CostModel(NamedTuple):
    """What a frame costs on this machine, ms: whatever is lit, for each unit of work in maps, for each light summed and looked up.

    None: not known. weak_ms: for the second set of lights, and weak: whether there is time for it. work: of a light's map, the mean, as
    `map_work` counts. backlog: work in maps off by more than a texel for each unit that is drawn, smoothed; off: such maps for each light.
    """

    fixed_ms: float = 0.0
    map_ms: float | None = None
    light_ms: float | None = None
    lookup_ms: float = 0.0
    weak_ms: float = 0.0
    weak: bool = True
    work: float = 1.0
    backlog: float = 1.0
    off: float = 0.0

    @property
    def always_ms(self) -> float:
        """What a frame takes without its lights."""
        return self.fixed_ms + (self.weak_ms if self.weak else 0.0)

    @property
    def renewed(self) -> float:
        """Share of the maps for which each frame has time before it has time for more lights."""
        return min(max(self.off, LEAST_RENEWED), MOST_RENEWED)


def map_work(sizes: np.ndarray) -> np.ndarray:
    """What drawing maps of `sizes` (n,) texels a side costs, in units of a map without texels."""
    return 1 + sizes.astype(np.float64) ** 2 / TEXELS


class Spent(NamedTuple):
    """What a frame did and how long it took: all of it, the work in its maps, its lookups where apart from its lights, its lights.

    weak_ms: the second set's lights; None where they were left out.
    """

    frame_ms: float
    work: float
    maps_ms: float
    lookups: int | None  # None: in the sum itself
    lookups_ms: float
    lights: int
    lights_ms: float
    weak_ms: float | None = None


def learnt(pace: CostModel, spent: Spent) -> CostModel:
    """The pace after a frame."""

    def mixed(before: float | None, total: float, count: float) -> float | None:
        if count == 0:
            return before
        return total / count if before is None else before + NEWEST * (total / count - before)

    fixed = spent.frame_ms - spent.maps_ms - spent.lookups_ms - spent.lights_ms - (spent.weak_ms or 0.0)
    known = pace.light_ms is not None
    pace = pace._replace(
        fixed_ms=pace.fixed_ms + NEWEST * (fixed - pace.fixed_ms) if known else fixed, map_ms=mixed(pace.map_ms, spent.maps_ms, spent.work)
    )
    if spent.weak_ms is not None:
        pace = pace._replace(weak_ms=mixed(pace.weak_ms or None, spent.weak_ms, 1) or 0.0)
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


def affordable_lights(pace: CostModel, frame_ms: float, moved: bool = False) -> int | None:
    """How many lights with the share `renewed` of their maps fit into frame_ms, but FEWEST at least; None while their cost is not known.

    moved: surfaces have, so that each light is looked up anew.
    """
    if pace.light_ms is None:
        return None
    return max(FEWEST, int((frame_ms - pace.always_ms) / max(_each_ms(pace, moved), 1e-6)))


def least_ms(pace: CostModel, moved: bool = False) -> float:
    """What a frame with the fewest lights takes."""
    return pace.always_ms + FEWEST * _each_ms(pace, moved)


def with_weak(pace: CostModel, frame_ms: float, moved: bool = False) -> CostModel:
    """The pace with the second set of lights where FEWEST of the first leave time for it, and without where they do not."""
    room_ms = LATE * frame_ms if pace.weak else frame_ms
    return pace._replace(weak=least_ms(pace._replace(weak=True), moved) <= room_ms)


def _each_ms(pace: CostModel, moved: bool) -> float:
    """What a light costs with its share of maps."""
    map_ms = pace.work * (pace.map_ms or 0.0)  # not known while the lights stand still, and then not spent either
    return (pace.light_ms or 0.0) + (1.0 if moved else pace.renewed) * pace.lookup_ms + pace.renewed * map_ms


def affordable_maps(pace: CostModel, frame_ms: float, lights: int, moved: bool, work: np.ndarray) -> int:
    """How many maps, each of its work (k,) and in that order, fit into what `lights` leave of frame_ms; the share `renewed` at least."""
    least = int(np.ceil(lights * pace.renewed))
    if pace.light_ms is None or pace.map_ms is None:
        return len(work)
    left, cost_ms = frame_ms - pace.always_ms - lights * pace.light_ms, np.cumsum(work) * pace.map_ms
    most = int(np.searchsorted(cost_ms, left - lights * pace.lookup_ms, "right"))  # every light looked up in the sum
    if not moved and most <= WORTH * lights:
        apart = int(np.searchsorted(cost_ms + pace.lookup_ms * np.arange(1, len(work) + 1), left, "right"))
        most = min(apart, int(WORTH * lights))
    return min(max(most, least), len(work))


def waited(pace: CostModel, work: np.ndarray, off: int, off_work: float, drawn_work: float) -> CostModel:
    """The pace after a frame whose lights have maps of `work` (n,), `off` of them off by more than a texel.

    off_work, drawn_work: the work in those, and how much of it was done.
    """
    backlog, share = off_work / drawn_work if drawn_work else 0.0, off / max(len(work), 1)
    return pace._replace(
        work=float(work.mean()) if len(work) else pace.work,
        backlog=pace.backlog + NEWEST * (backlog - pace.backlog),
        off=pace.off + NEWEST * (share - pace.off),
    )


def halvings(pace: CostModel, before: int, most: int) -> int:
    """By how many steps maps are smaller from now on: one more when maps wait for their turn, one less when they do not."""
    if pace.backlog > MUCH:
        return min(before + 1, most)
    return max(before - 1, 0) if pace.backlog < LITTLE else before


def first_lights(lights: LightSet, count: int) -> LightSet:
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
    return LightSet.of(lights.ids[chosen], lights.directions[chosen], scaled)
