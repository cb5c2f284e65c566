"""The method "tracked": lights that follow the scene's light, which need neither a filter with a delay nor clusters."""

import numpy as np

from vemlight.light.colour import luminance_from_rgb
from vemlight.light.light_set import LightSet
from vemlight.sampler.error_limit import deciding_estimate, estimate_after, estimate_of, extrapolated, smallest_within
from vemlight.sampler.light_count import count_after
from vemlight.sampler.light_map import light_map
from vemlight.sampler.sampler_input import SamplerInput
from vemlight.sampler.state import SamplerReport, SamplerState
from vemlight.sampler.temporal.flicker import block_powers, flicker_after, without_flicker
from vemlight.sampler.tracking.tiles import Tiles
from vemlight.sampler.tracking.tracked import TrackedReport, TrackedState, lights_of, observe, tracked_step
from vemlight.settings import Sampler

COUNT_TRIALS = 4  # numbers of lights that are tried when the scene has changed; each at most doubles the number


def tracked_method(settings: Sampler, state: SamplerState, frame: SamplerInput) -> tuple[SamplerState, LightSet, SamplerReport]:
    """The step of the method "tracked"."""
    flicker = state.flicker
    if settings.deflicker:
        seen = light_map(frame.radiance, frame.coverage)
        flicker = flicker_after(flicker, frame.time_s, block_powers(seen, True))
        if flicker.depth > 0:
            frame = frame._replace(radiance=without_flicker(seen, flicker))
    smoothing = settings.filter != "none"
    most = settings.max_count
    max_count = min(most, settings.clusters or most, state.light_budget or most)
    if settings.error_limit:
        state, lights, report, count = _within_error(settings, state, frame, max_count)
        tracked = state.tracked
    else:
        tracked, lights, report = tracked_step(max_count, state.tracked, frame, smoothing, settings.is_soft)
        count = max_count
    tracked_gloss, gloss = state.tracked_gloss, None
    if settings.gloss_lights:
        tracked_gloss, gloss, _ = tracked_step(settings.gloss_lights, tracked_gloss, frame, smoothing)
    if not settings.deflicker:
        flicker = flicker_after(flicker, frame.time_s, np.array([float(luminance_from_rgb(report.irradiance))]))
    state = state._replace(time_s=frame.time_s, flicker=flicker, tracked=tracked, tracked_gloss=tracked_gloss)
    published = SamplerReport(
        delay_frames=0.0,
        delay_s=0.0,
        invalid_cells=report.invalid_cells,
        irradiance=report.irradiance,
        count=count,
        required_lights=state.light_count.count if state.light_count and settings.error_limit else 0,
        error=state.error_estimate.error if settings.error_limit else 0.0,
        light_budget=state.light_budget,
        flicker_hz=flicker.beat_hz,
        lamp_hz=flicker.lamp_hz,
        flicker_depth=flicker.depth,
        gloss=gloss,
    )
    return state, lights, published


def _within_error(
    settings: Sampler, state: SamplerState, frame: SamplerInput, max_count: int
) -> tuple[SamplerState, LightSet, TrackedReport, int]:
    """The tracked lights, as few as keep within the error limit, and how many were wanted."""
    error, coverage, in_use = settings.error_limit, frame.coverage, state.light_count
    before, observed = observe(state.tracked, frame, settings.filter != "none")

    def lit(count: int) -> tuple[TrackedState, LightSet, Tiles]:
        return lights_of(count, before, observed, settings.is_soft)

    def error_of(count: int) -> float:
        _, lights, tiles = lit(count)
        return deciding_estimate(tiles, lights, coverage, error).error

    count = min(in_use.count, max_count) if in_use else smallest_within(error, max_count, error_of)
    tracked, lights, tiles = lit(count)
    if in_use:
        estimate = estimate_after(state.error_estimate, tiles, lights, coverage, error)
    else:
        estimate = deciding_estimate(tiles, lights, coverage, error)
    for _ in range(COUNT_TRIALS):
        if count == max_count or estimate.keeps(error):
            break
        estimate = deciding_estimate(tiles, lights, coverage, error)
        if estimate.keeps(error):
            break
        count = extrapolated(count, estimate.error, error, max_count)
        tracked, lights, tiles = lit(count)
        estimate = estimate_of(tiles, lights, coverage)
    report = TrackedReport(observed.invalid_cells, tiles.flux.sum(axis=1))

    # The next number: what was just verified when it rose, what fewer lights promise when they would do; nothing is learnt in the dark.
    if report.irradiance.any():
        rose = in_use is None or count > in_use.count
        required = count if rose else extrapolated(count, estimate.error, error, max_count)
        capped = in_use is not None and count < in_use.count
        in_use = count_after(in_use, in_use.count if in_use and capped else required, frame.time_s)
    return state._replace(tracked=tracked, light_count=in_use, error_estimate=estimate), lights, report, count
