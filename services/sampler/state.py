"""What the sampler remembers between frames, and what it reports beside the lights."""

from typing import NamedTuple

import numpy as np

from vemlight.light.light_set import LightSet
from vemlight.light.sphere import Coverage
from vemlight.sampler.cluster import NO_CLUSTERS, Clusters
from vemlight.sampler.error_limit import NO_ESTIMATE, ErrorEstimate
from vemlight.sampler.light_count import LightCount
from vemlight.sampler.temporal.filter import EMPTY_MEMORY, FilterMemory
from vemlight.sampler.temporal.flicker import NO_FLICKER, Flicker
from vemlight.sampler.tracking.tracked import TrackedState, initial_tracked
from vemlight.sampler.warps.warp import Anchor


class SamplerState(NamedTuple):
    """The memory of all methods.

    time_s: of the last frame, None before the first. light_count: under an error limit. light_budget: lights that the renderer can draw,
    0 where that is no limit. For the warp methods: anchor, which steadies the warp's offset, filter, fade_weights (n,), how far each
    light has come, and clusters. For the method "tracked": tracked, tracked_gloss for the gloss set, and error_estimate under a limit.
    """

    coverage: Coverage
    time_s: float | None
    light_count: LightCount | None
    error_estimate: ErrorEstimate
    light_budget: int
    flicker: Flicker
    anchor: Anchor | None
    filter: FilterMemory
    fade_weights: np.ndarray
    clusters: Clusters
    tracked: TrackedState
    tracked_gloss: TrackedState


class SamplerReport(NamedTuple):
    """What is published beside the lights.

    delay_frames, delay_s: by how much the filter delays the lights. invalid_cells: in which a nan, infinite or negative value was set to
    0. irradiance: (3,) float64, the map's integral over solid angle. count: lights wanted before clustering. required_lights,
    light_budget: what the scene needs and what the renderer can draw, 0 where not asked. error: of these lights, relative, at hard edges,
    estimated where there is an error limit, else 0. flicker_hz: beat of lamps with the frame rate, lamp_hz: their own frequency,
    flicker_depth: amplitude over mean; all 0 when there is none. gloss: the gloss set, None when not asked for; with the warp methods the
    first set is, before clustering, its beginning with more power.
    """

    delay_frames: float
    delay_s: float
    invalid_cells: int
    irradiance: np.ndarray
    count: int
    required_lights: int
    light_budget: int
    error: float
    flicker_hz: float
    lamp_hz: float
    flicker_depth: float
    gloss: LightSet | None


def initial_state() -> SamplerState:
    """The state before the first frame."""
    tracked = initial_tracked()
    unknown = "hemisphere", None, None, NO_ESTIMATE, 0
    return SamplerState(*unknown, NO_FLICKER, None, EMPTY_MEMORY, np.zeros(0), NO_CLUSTERS, tracked, tracked)


def state_after_jump(before: SamplerState, coverage: Coverage) -> SamplerState:
    """The state where nothing that was seen says anything about the next frame. No new light has the id of an old one."""
    tracked, gloss = (initial_tracked(state.sites.next_id) for state in (before.tracked, before.tracked_gloss))
    return initial_state()._replace(coverage=coverage, light_budget=before.light_budget, tracked=tracked, tracked_gloss=gloss)
