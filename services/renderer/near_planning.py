"""Near lights in a frame's plan: which of them there is time for beside the directional ones, and which are traced, or mapped, anew."""

from functools import partial
from typing import NamedTuple

import numpy as np

from vemlight.light.light_set import LightSet
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer import pass_table
from vemlight.renderer.frame import FrameInput, FrameSetup, FrameState
from vemlight.renderer.frame_budget import MIN_LIGHTS, Budget, affordable_lights, affordable_maps, affordable_traces, map_work
from vemlight.renderer.gl.constants import NEAR_BATCH
from vemlight.renderer.pass_table import Pass
from vemlight.renderer.passes.near_lights.near_light_plan import (
    NearBatch,
    NearInTime,
    may_be_coarse,
    near_batches,
    near_in_time,
    near_within,
    slots_for,
    strongest_first,
)
from vemlight.renderer.passes.near_lights.near_light_views import FACES, map_resolution

NEAR_TOGETHER = 16  # near lights whose maps are drawn together in files: of 512 texels a side


class LightsInTime(NamedTuple):
    """How many directional lights, and which near ones, a frame has time for."""

    directional: int
    near: NearLightSet


def lights_in_time(state: FrameState, shown: FrameInput, lights: LightSet, budget: Budget, most_layers: int) -> LightsInTime:
    """The strongest of all lights that a frame has time for; near ones count as directional ones do, `most_layers` at most."""
    affordable, placed = affordable_lights(budget), state.placed
    if not len(shown.near.ids):
        return LightsInTime(affordable or len(lights.ids), shown.near)
    near, most = strongest_first(shown.near, placed), affordable or len(lights.ids) + len(shown.near.ids)
    near = near_within(near, placed, lights, most, min(most_layers, NEAR_BATCH))
    return LightsInTime(max(most - len(near.ids), MIN_LIGHTS), near)


def all_near(setup: FrameSetup, state: FrameState, shown: FrameInput, most_layers: int) -> tuple[NearBatch, ...]:
    """All near lights, all traced or mapped anew."""
    return near_batches(strongest_first(shown.near, state.placed), most_layers if setup.traced else NEAR_TOGETHER)


def near_traced(
    setup: FrameSetup, state: FrameState, shown: FrameInput, lights: LightSet, budget: Budget, others: float, most_layers: int
) -> NearInTime:
    """The near lights, of which as many that moved are traced anew as there is time for beside the sum over `others`."""
    if not len(shown.near.ids):
        return NearInTime.none()
    kept = None if budget.surfaces_moved else state.near_layers
    paced = partial(affordable_traces, budget, others + len(shown.near.ids))
    return near_in_time(kept, shown.near, may_be_coarse(shown.near, state.placed, lights) & setup.coarse, state.placed, most_layers, paced)


def near_mapped(setup: FrameSetup, state: FrameState, shown: FrameInput, budget: Budget, others: int) -> NearInTime:
    """The near lights, of which as many that moved have their maps drawn anew as there is time for beside the sum over `others`."""
    count = len(shown.near.ids)
    if not count:
        return NearInTime.none()
    kept = None if budget.surfaces_moved else state.near_layers
    work = map_works(setup, slots_for(count, NEAR_BATCH))
    return near_in_time(
        kept, shown.near, np.zeros(count, bool), state.placed, NEAR_BATCH,
        lambda stale: affordable_maps(budget, others + count, np.full(stale, work)),
    )  # fmt: skip


def map_works(setup: FrameSetup, slots: int) -> float:
    """What drawing the maps of a near light costs where so many have maps, as `map_work` counts."""
    resolutions = setup.shadows.resolutions
    side = map_resolution(slots, None if resolutions.by_power else resolutions.largest)
    return FACES * float(map_work(np.array(side)))


def near_passes(setup: FrameSetup) -> tuple[Pass, ...]:
    """The passes of a batch."""
    return (pass_table.NEAR_RAYS if setup.traced else pass_table.NEAR_MAPS, pass_table.NEAR_LIGHTS)
