"""A target frame time, met by the number of shadow maps drawn in a frame, by their resolution, and then by the number of lights.

What a frame costs on this machine is measured (CostModel); what its shadow maps need follows from the frames planned (MapDemand). All
functions are pure: costs and demand of one frame in, those of the next one out.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from vemlight.light.light_set import LightSet
from vemlight.renderer.pass_table import BOUNCE, EDGES, LIGHTS, RAYS, SHADOW_MAPS, VISIBILITY_CACHE

WARM_UP_FRAMES = 2  # not measured: GL drivers compile on the first and tune on the second
NEWEST_WEIGHT = 0.2  # of the newest frame in a moving average: half of a change after 3 frames, and one odd frame counts for a fifth
MIN_REFRESH = 1 / 24  # of the maps are redrawn in each frame whatever the time: at 24 frames a second none is older than a second;
MAX_REFRESH = 1 / 8  # ... and none older than a third of one where that many lights move, before there is time for more lights
MAX_REDRAWN = 3 / 4  # of the maps, for the visibility cache to pay: a lookup for it takes 4/3 of one in the sum (78 and 59 ms, 72 lights)
LOOKUP_FRACTION = 2 / 3  # of a light's cost where it is looked up, until both are measured apart: 59 of 86 ms of 72 lights
# Halved maps have at most half the backlog; doubled ones six times as much, with twice the texels to move by and three times the cost.
COARSEN_ABOVE, REFINE_BELOW = 2.0, 0.125  # of the backlog
MIN_LIGHTS = 8  # with fewer a sky is a few hard shadows; the target is missed before that
LATE = 1.15  # times the target: what single frames take anyway where the median meets it
COARSE_WEIGHT = 1 / 4  # of a light on coarse pixels, of which there are so many
TEXELS_PER_UNIT = 100**2  # of a map whose texels cost as much as its triangles and its setting up: 0.05 ms either (llvmpipe, 1 core)


class CostModel(NamedTuple):
    """What a frame costs on this machine, ms: whatever is lit, a unit of `map_work`, a light summed, and a light looked up or traced.

    None: not measured yet. bounce_ms: for the bounce. frames: how many were measured.
    """

    frames: int = 0
    fixed_ms: float = 0.0
    map_ms: float | None = None
    light_ms: float | None = None
    lookup_ms: float = 0.0
    bounce_ms: float = 0.0


class MapDemand(NamedTuple):
    """What shadow maps the lights need. mean_work: of a light's map, as `map_work` counts.

    backlog: work in stale maps for each unit that is drawn, a moving average. stale_fraction: stale maps for each light, likewise.
    """

    mean_work: float = 1.0
    backlog: float = 1.0
    stale_fraction: float = 0.0

    @property
    def refresh_fraction(self) -> float:
        """Fraction of the maps for which each frame has time before it has time for more lights."""
        return min(max(self.stale_fraction, MIN_REFRESH), MAX_REFRESH)


class Budget(NamedTuple):
    """A target frame time and what is known about meeting it.

    bounce: whether the bounce is drawn. surfaces_moved: whether surfaces have, so that every light is looked up anew. light_weight: what a
    light costs on average, over one on all pixels.
    """

    target_ms: float
    costs: CostModel
    demand: MapDemand
    surfaces_moved: bool = False
    bounce: bool = False
    light_weight: float = 1.0

    @property
    def fixed_ms(self) -> float:
        """What a frame takes without its lights."""
        return self.costs.fixed_ms + (self.costs.bounce_ms if self.bounce else 0.0)

    @property
    def light_ms(self) -> float:
        """What a light takes with its part of the shadow maps."""
        refresh = self.demand.refresh_fraction
        map_ms = self.demand.mean_work * (self.costs.map_ms or 0.0)  # not measured while the lights stand still, and then not spent either
        on_all = (self.costs.light_ms or 0.0) + (1.0 if self.surfaces_moved else refresh) * self.costs.lookup_ms + refresh * map_ms
        return self.light_weight * on_all


class FrameWork(NamedTuple):
    """What a frame planned to do, in the units in which its costs are measured.

    maps: as `map_work` counts. lookups: into the visibility cache, or lights traced; None where lights are looked up in the sum itself. Of
    lights and lookups on coarse pixels COARSE_WEIGHT counts.
    """

    maps: float
    lookups: float | None
    lights: float
    bounce: bool = False


class FrameTimings(NamedTuple):
    """How long a frame took by the clock, and each of its timers."""

    frame_ms: float
    timers_ms: Mapping[str, float]


def map_work(resolutions: np.ndarray) -> np.ndarray:
    """What drawing maps of `resolutions` (n,) texels a side costs, in units of a map without texels."""
    return 1 + resolutions.astype(np.float64) ** 2 / TEXELS_PER_UNIT


def updated_costs(costs: CostModel, work: FrameWork, timings: FrameTimings) -> CostModel:
    """The costs after a frame of this work took these times."""
    costs = costs._replace(frames=costs.frames + 1)
    if costs.frames <= WARM_UP_FRAMES:
        return costs
    spent_ms = {each.timer: timings.timers_ms.get(each.timer, 0.0) for each in (SHADOW_MAPS, VISIBILITY_CACHE, RAYS, LIGHTS, BOUNCE)}
    maps_ms, lookups_ms, rays_ms, lights_ms, bounce_ms = spent_ms.values()
    lookups_ms += rays_ms  # a frame has one or the other
    fixed_ms = timings.frame_ms - maps_ms - lookups_ms - lights_ms - bounce_ms
    fixed_ms -= timings.timers_ms.get(EDGES.timer, 0.0)  # over after a few frames
    measured = costs.light_ms is not None
    costs = costs._replace(
        fixed_ms=costs.fixed_ms + NEWEST_WEIGHT * (fixed_ms - costs.fixed_ms) if measured else fixed_ms,
        map_ms=_averaged(costs.map_ms, maps_ms, work.maps),
    )
    if work.bounce:
        costs = costs._replace(bounce_ms=_averaged(costs.bounce_ms or None, bounce_ms, 1) or 0.0)
    if work.lights == 0:
        return costs
    if work.lookups is not None:
        lookup_ms = _averaged(costs.lookup_ms or None, lookups_ms, work.lookups) or 0.0
        return costs._replace(light_ms=_averaged(costs.light_ms, lights_ms, work.lights), lookup_ms=lookup_ms)
    # Both were measured together: the fraction of each stays as it was.
    both_ms = lights_ms / work.lights
    previous_ms, fraction = both_ms, LOOKUP_FRACTION
    if costs.light_ms is not None:
        previous_ms = costs.lookup_ms + costs.light_ms
        fraction = costs.lookup_ms / max(previous_ms, 1e-9)
    average_ms = previous_ms + NEWEST_WEIGHT * (both_ms - previous_ms)
    return costs._replace(light_ms=(1 - fraction) * average_ms, lookup_ms=fraction * average_ms)


def _averaged(previous: float | None, total: float, count: float) -> float | None:
    """The moving average of a cost after `count` of it took `total`."""
    if count == 0:
        return previous
    return total / count if previous is None else previous + NEWEST_WEIGHT * (total / count - previous)


def updated_demand(demand: MapDemand, work: np.ndarray, stale_work: np.ndarray, drawn_work: float) -> MapDemand:
    """The demand after a frame whose lights have maps of `work` (n,), those of `stale_work` (k,) stale, and drew `drawn_work` of them."""
    backlog = float(stale_work.sum()) / drawn_work if drawn_work else 0.0
    stale_fraction = len(stale_work) / max(len(work), 1)
    return MapDemand(
        mean_work=float(work.mean()) if len(work) else demand.mean_work,
        backlog=demand.backlog + NEWEST_WEIGHT * (backlog - demand.backlog),
        stale_fraction=demand.stale_fraction + NEWEST_WEIGHT * (stale_fraction - demand.stale_fraction),
    )


def affordable_lights(budget: Budget) -> int | None:
    """How many lights fit into the target time, MIN_LIGHTS at least; None while their cost is not measured."""
    if budget.costs.light_ms is None:
        return None
    return max(MIN_LIGHTS, int((budget.target_ms - budget.fixed_ms) / max(budget.light_ms, 1e-6)))


def least_ms(budget: Budget) -> float:
    """What a frame with the fewest lights takes."""
    return budget.fixed_ms + MIN_LIGHTS * budget.light_ms


def bounce_affordable(budget: Budget) -> bool:
    """Whether the fewest lights leave time for the bounce; where it was drawn before, a frame may be a little late for it."""
    return least_ms(budget._replace(bounce=True)) <= budget.target_ms * (LATE if budget.bounce else 1.0)


def affordable_maps(budget: Budget, lights: int, work: np.ndarray) -> int:
    """How many maps, each of its work (k,) and in that order, fit into the time that `lights` leave; `refresh_fraction` at least."""
    costs = budget.costs
    least = int(np.ceil(lights * budget.demand.refresh_fraction))
    if costs.light_ms is None or costs.map_ms is None:
        return len(work)
    left_ms, maps_ms = budget.target_ms - budget.fixed_ms - lights * costs.light_ms, np.cumsum(work) * costs.map_ms
    most = int(np.searchsorted(maps_ms, left_ms - lights * costs.lookup_ms, "right"))  # every light looked up in the sum
    if not budget.surfaces_moved and most <= MAX_REDRAWN * lights:
        cached = int(np.searchsorted(maps_ms + costs.lookup_ms * np.arange(1, len(work) + 1), left_ms, "right"))
        most = min(cached, int(MAX_REDRAWN * lights))
    return min(max(most, least), len(work))


def affordable_traces(budget: Budget, lights: float, stale: int) -> int:
    """How many of the stale lights are traced in the time that the sum over `lights` leaves; `refresh_fraction` at least.

    All of them where surfaces moved: what arrived at another place is no substitute.
    """
    if budget.costs.light_ms is None or budget.surfaces_moved:
        return stale
    left_ms = budget.target_ms - budget.fixed_ms - lights * budget.costs.light_ms
    least = int(np.ceil(lights * budget.demand.refresh_fraction))
    return min(max(int(left_ms / max(budget.costs.lookup_ms, 1e-6)), least), stale)


def coarsening(demand: MapDemand, previous: int, most: int) -> int:
    """By how many halvings maps are coarser from now on: one more when stale maps pile up, one less when there are hardly any."""
    if demand.backlog > COARSEN_ABOVE:
        return min(previous + 1, most)
    return max(previous - 1, 0) if demand.backlog < REFINE_BELOW else previous


def strongest_lights(lights: LightSet, count: int) -> LightSet:
    """`count` of the lights, at least one, scaled so that the sum of their irradiance stays what it was in each channel.

    Those stronger by a power of two come first, then the order of the set decides: lights of like power keep the progressive order, and
    a sun is not left out.
    """
    count = max(count, 1)
    if count >= len(lights.ids):
        return lights
    chosen = np.sort(np.argsort(-octaves(lights.irradiance.max(axis=1)), kind="stable")[:count])
    total, irradiance = lights.irradiance.sum(axis=0, dtype=np.float64), lights.irradiance[chosen].astype(np.float64)
    part = irradiance.sum(axis=0)
    scaled = np.where(part > 0, irradiance * np.divide(total, part, out=np.zeros(3), where=part > 0), total / count)
    covariances = None if lights.covariances is None else lights.covariances[chosen]
    return LightSet.of(lights.ids[chosen], lights.directions[chosen], scaled, covariances)


def octaves(power: np.ndarray) -> np.ndarray:
    """How strong lights of a power (n,) are beside their mean, in whole powers of two: lights that are alike but for noise are equal."""
    return np.floor(np.log2(np.maximum(power / max(power.mean(), 1e-30), 1e-6)) + 0.5)
